"""Pack the detections of a frame, placed in the plan frame, into the array that the kernels read."""

from __future__ import annotations

import math

import numpy as np

from service.tracking.boxes import PECHO, PG, POINT_COLUMNS, PV, PVAR_AZ, PVAR_R, PWEIGHT, PX, PY
from service.tracking.geometry import DECIBELS_PER_DECADE
from service.tracking.kernel import kernel
from service.tracking.model import F64, Frame
from service.tracking.parameters import SensorModel

ECHO_RANGE_M = 100.0  # echoes are compared as if they came from here


def point_array(frame: Frame, sensor: SensorModel) -> F64:
    """Return the points (N, POINT_COLUMNS) of a frame: place, range rate, variances, weight, echo.

    The formulas are those of `geometry.plan_points`, in one pass.
    """
    s = sensor
    columns = (frame.range_m, frame.azimuth_rad, frame.radial_velocity_mps, frame.snr_db)
    return _point_array(
        np.array(columns, dtype=np.float64),
        (s.mount_height_m - s.scatter_height_m, s.range_resolution_m, s.azimuth_offset_rad, s.range_std_m,
         s.azimuth_std_rad, s.azimuth_floor_rad, s.noise_snr_db),
    )  # fmt: skip


@kernel
def _point_array(columns: F64, q: tuple[float, ...]) -> F64:
    height, resolution, offset, range_std, azimuth_std, azimuth_floor, noise_snr = q
    n = columns.shape[1]
    out = np.empty((n, POINT_COLUMNS))
    reference = 10.0 ** (noise_snr / DECIBELS_PER_DECADE)
    for k in range(n):
        slant, snr = columns[0, k], columns[3, k]
        ground = math.sqrt(max(slant * slant - height * height, resolution * resolution))
        azimuth = math.pi - (math.pi - (columns[1, k] + offset)) % (2.0 * math.pi)
        stretch = slant / ground
        relative = 1.0 if math.isnan(snr) else 10.0 ** ((snr - noise_snr) / DECIBELS_PER_DECADE)
        std_range = range_std / relative * stretch
        weight = relative * reference
        out[k, PX], out[k, PY], out[k, PG] = ground * math.sin(azimuth), ground * math.cos(azimuth), ground
        out[k, PV] = columns[2, k] * slant / ground
        out[k, PVAR_R] = std_range * std_range
        out[k, PVAR_AZ] = azimuth_floor * azimuth_floor + (azimuth_std / relative) ** 2
        out[k, PWEIGHT] = weight
        # the radar equation's R^-4 taken out: the weight is an amplitude
        out[k, PECHO] = 20.0 * math.log10(max(weight, 1e-6)) + 40.0 * math.log10(ground / ECHO_RANGE_M)
    return out
