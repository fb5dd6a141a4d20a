"""Turn what the radar measures (slant range, its own azimuth) into the plan frame of the road, and back.

The radar hangs `mount_height_m` above the road and most echoes come from `scatter_height_m` above it, so a
slant range r is a ground range g = sqrt(r^2 - (mount - scatter)^2), and a slant range rate v is v r / g on
the ground. All functions work on arrays of any shape and return float64.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from service.tracking.model import F64, Frame

if TYPE_CHECKING:
    from service.tracking.parameters import SensorModel

DECIBELS_PER_DECADE = 20.0  # of an amplitude; SNR is a power, so amplitude = 10^(snr/20)


@dataclass(frozen=True, slots=True)
class PlanPoints:
    """The N detections of a frame in the plan frame, each with its own noise.

    Range and radial velocity are those on the ground plane; unknown radial velocity is NaN.
    """

    x_m: F64  # (N,)
    y_m: F64
    range_m: F64
    azimuth_rad: F64
    radial_velocity_mps: F64
    range_std_m: F64
    azimuth_std_rad: F64
    velocity_std_mps: F64
    weight: F64  # amplitude of the echo; unknown SNR counts as the reference SNR

    def __len__(self) -> int:
        return len(self.x_m)


def plan_points(frame: Frame, sensor: SensorModel) -> PlanPoints:
    """Return the detections of a frame in the plan frame with their standard deviations and weights."""
    slant_m = _f64(frame.range_m)
    ground_m = ground_range(slant_m, sensor)
    azimuth_rad = plan_azimuth(frame.azimuth_rad, sensor)
    x_m, y_m = polar_to_plan(ground_m, azimuth_rad)
    range_std_m, azimuth_std_rad, velocity_std_mps = noise_std(frame.snr_db, sensor)
    stretch = slant_m / ground_m
    return PlanPoints(
        x_m=x_m,
        y_m=y_m,
        range_m=ground_m,
        azimuth_rad=azimuth_rad,
        radial_velocity_mps=ground_velocity(frame.radial_velocity_mps, slant_m, ground_m),
        range_std_m=range_std_m * stretch,
        azimuth_std_rad=azimuth_std_rad,
        velocity_std_mps=velocity_std_mps * stretch,
        weight=amplitude(frame.snr_db, sensor),
    )


def wrap_angle(angle_rad: ArrayLike) -> F64:
    """Return the angle in (-pi, pi]."""
    return np.asarray(np.pi - np.remainder(np.pi - _f64(angle_rad), 2.0 * np.pi))


def ground_range(slant_m: ArrayLike, sensor: SensorModel) -> F64:
    """Return the ground range of each slant range.

    A slant range shorter than the height of the radar above the scatterers has no place on the road: noise,
    or an echo from the mounting itself. It is put at one range cell, near enough to lie outside every
    region of interest and far enough to keep slant / ground finite.
    """
    height_m = sensor.mount_height_m - sensor.scatter_height_m
    slant = _f64(slant_m)
    return np.sqrt(np.maximum(slant * slant - height_m * height_m, sensor.range_resolution_m**2))


def slant_range(ground_m: ArrayLike, sensor: SensorModel) -> F64:
    """Return the slant range of each ground range; the inverse of `ground_range` outside its clamp."""
    height_m = sensor.mount_height_m - sensor.scatter_height_m
    ground = _f64(ground_m)
    return np.sqrt(ground * ground + height_m * height_m)


def plan_azimuth(measured_rad: ArrayLike, sensor: SensorModel) -> F64:
    """Return the azimuth in the plan frame: the measured one plus the offset of the mount, wrapped."""
    return wrap_angle(_f64(measured_rad) + sensor.azimuth_offset_rad)


def measured_azimuth(plan_rad: ArrayLike, sensor: SensorModel) -> F64:
    """Return the azimuth that the radar reports for one in the plan frame; the inverse of `plan_azimuth`."""
    return wrap_angle(_f64(plan_rad) - sensor.azimuth_offset_rad)


def ground_velocity(slant_mps: ArrayLike, slant_m: ArrayLike, ground_m: ArrayLike) -> F64:
    """Return the ground-plane range rate of a slant range rate: g dg/dt = r dr/dt at constant height."""
    return _f64(slant_mps) * _f64(slant_m) / _f64(ground_m)


def slant_velocity(ground_mps: ArrayLike, slant_m: ArrayLike, ground_m: ArrayLike) -> F64:
    """Return the slant range rate of a range rate on the ground plane; the inverse of `ground_velocity`."""
    return _f64(ground_mps) * _f64(ground_m) / _f64(slant_m)


def polar_to_plan(range_m: ArrayLike, azimuth_rad: ArrayLike) -> tuple[F64, F64]:
    """Return x and y of ground ranges and azimuths (clockwise from +y)."""
    r, az = _f64(range_m), _f64(azimuth_rad)
    return np.asarray(r * np.sin(az)), np.asarray(r * np.cos(az))


def plan_to_polar(x_m: ArrayLike, y_m: ArrayLike) -> tuple[F64, F64]:
    """Return ground range and azimuth of points; the inverse of `polar_to_plan`."""
    x, y = _f64(x_m), _f64(y_m)
    return np.hypot(x, y), np.arctan2(x, y)


def plan_covariance(range_m: ArrayLike, azimuth_rad: ArrayLike, polar_cov: ArrayLike) -> F64:
    """Return the (..., 2, 2) covariance in x, y of points with (..., 2, 2) covariance in range and azimuth.

    First order: J C J' with J = d(x, y) / d(range, azimuth).
    """
    r, az = _f64(range_m), _f64(azimuth_rad)
    s, c = np.sin(az), np.cos(az)
    J = np.stack([np.stack([s, r * c], -1), np.stack([c, -r * s], -1)], -2)
    return np.asarray(J @ _f64(polar_cov) @ J.swapaxes(-1, -2))


def noise_std(snr_db: ArrayLike, sensor: SensorModel) -> tuple[F64, F64, F64]:
    """Return the standard deviations of slant range [m], azimuth [rad], slant range rate [m/s] at each SNR.

    All three grow as the amplitude falls, 10^((reference - snr)/20); the azimuth never gets better than the
    floor of the antenna. Unknown (NaN) SNR counts as the reference SNR.
    """
    growth = 1.0 / _relative_amplitude(snr_db, sensor)
    azimuth = np.hypot(sensor.azimuth_floor_rad, sensor.azimuth_std_rad * growth)
    return sensor.range_std_m * growth, azimuth, sensor.velocity_std_mps * growth


def amplitude(snr_db: ArrayLike, sensor: SensorModel) -> F64:
    """Return the weight 10^(snr/20) of each echo; unknown (NaN) SNR counts as the reference SNR."""
    return np.asarray(
        _relative_amplitude(snr_db, sensor) * 10.0 ** (sensor.noise_snr_db / DECIBELS_PER_DECADE)
    )


def _relative_amplitude(snr_db: ArrayLike, sensor: SensorModel) -> F64:
    snr = _f64(snr_db)
    excess_db = np.where(np.isnan(snr), 0.0, snr - sensor.noise_snr_db)
    return np.asarray(10.0 ** (excess_db / DECIBELS_PER_DECADE))


def _f64(values: ArrayLike) -> F64:
    return np.asarray(values, dtype=np.float64)
