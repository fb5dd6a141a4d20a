"""Pack the detections of a frame, placed in the plan frame, into the array that the kernels read."""

from __future__ import annotations

import numpy as np

from service.tracking.boxes import PECHO, PG, POINT_COLUMNS, PV, PVAR_AZ, PVAR_R, PWEIGHT, PX, PY
from service.tracking.geometry import plan_points
from service.tracking.model import F64, Frame
from service.tracking.parameters import SensorModel

ECHO_RANGE_M = 100.0  # echoes are compared as if they came from here


def point_array(frame: Frame, sensor: SensorModel) -> F64:
    """Return the points (N, POINT_COLUMNS) of a frame: place, range rate, variances, weight, echo."""
    plan = plan_points(frame, sensor)
    out = np.empty((len(plan), POINT_COLUMNS))
    out[:, PX], out[:, PY], out[:, PG] = plan.x_m, plan.y_m, plan.range_m
    out[:, PV] = plan.radial_velocity_mps
    out[:, PVAR_R], out[:, PVAR_AZ] = plan.range_std_m**2, plan.azimuth_std_rad**2
    out[:, PWEIGHT] = plan.weight
    # the radar equation's R^-4 taken out: the weight is an amplitude
    out[:, PECHO] = 20.0 * np.log10(np.maximum(plan.weight, 1e-6)) + 40.0 * np.log10(
        plan.range_m / ECHO_RANGE_M
    )
    return out
