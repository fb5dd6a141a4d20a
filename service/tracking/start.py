"""Turn the first one or two measurements of a vehicle into the mean and covariance of a new track.

The position is the measured one; the velocity fuses a prior (any direction, or along a road) with the
Doppler, which sees its part along the line of sight, and with an earlier position if there is one. The
covariance follows from the geometry. Shapes (..., n): any leading dimensions, the usual one is the track.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from service.tracking.geometry import plan_covariance, polar_to_plan
from service.tracking.measurement import AZIMUTH, RANGE, RANGE_RATE, jacobian, predict_measurement
from service.tracking.model import F64
from service.tracking.motion import ACCELERATION, POSITION, STATES, VELOCITY

SPEED_STD_MPS = 20.0  # of a vehicle of which nothing is known: urban road to motorway
ACCELERATION_STD_MPS2 = 3.0  # comfortable braking and accelerating stay within it


@dataclass(frozen=True, slots=True)
class VelocityPrior:
    """What is known of (vx, vy) before it is measured."""

    mean_mps: F64  # (..., 2)
    cov: F64  # (..., 2, 2)


def directed_prior(
    heading_rad: ArrayLike, along_std_mps: ArrayLike, across_std_mps: ArrayLike, speed_mps: ArrayLike = 0.0
) -> VelocityPrior:
    """Return a prior with its own spread along and across a heading (clockwise from +y).

    With the heading of a lane it says that vehicles follow it; with the azimuth of the measurement the
    across part is the spread of the tangential velocity, which Doppler does not see.
    """
    heading = np.asarray(heading_rad, dtype=np.float64)
    h = np.stack([np.sin(heading), np.cos(heading)], axis=-1)
    n = np.stack([h[..., 1], -h[..., 0]], axis=-1)
    along = np.asarray(along_std_mps, dtype=np.float64)[..., None, None] ** 2
    across = np.asarray(across_std_mps, dtype=np.float64)[..., None, None] ** 2
    cov = along * h[..., :, None] * h[..., None, :] + across * n[..., :, None] * n[..., None, :]
    return VelocityPrior(np.asarray(speed_mps, dtype=np.float64)[..., None] * h, cov)


def undirected_prior(std_mps: float = SPEED_STD_MPS) -> VelocityPrior:
    """Return a prior of zero mean and the same spread in all directions."""
    return VelocityPrior(np.zeros(2), std_mps**2 * np.eye(2))


def initial_state(
    z: F64, R: F64, prior: VelocityPrior, accel_std_mps2: float = ACCELERATION_STD_MPS2
) -> tuple[F64, F64]:
    """Return mean (..., 6) and covariance (..., 6, 6) of a track from one measurement.

    z: (..., 3) range, azimuth, range rate (NaN: not measured).  R: (..., 3, 3).
    """
    return _use_range_rate(*_from_position(z, R, prior, accel_std_mps2), z, R)


def two_point_state(  # noqa: PLR0913 - two measurements and the time between them
    z_first: F64,
    R_first: F64,
    z: F64,
    R: F64,
    *,
    dt_s: float,
    prior: VelocityPrior,
    accel_std_mps2: float = ACCELERATION_STD_MPS2,
) -> tuple[F64, F64]:
    """Return mean (..., 6), cov (..., 6, 6) of a track at the second measurement, `dt_s` after the first.

    The first gives its position only, p1 = p - v dt + a dt^2/2, as one more measurement of the state.
    """
    mean, cov = _from_position(z, R, prior, accel_std_mps2)
    H = np.zeros((2, STATES))
    for row in range(2):
        H[row, POSITION[row]] = 1.0
        H[row, VELOCITY[row]] = -dt_s
        H[row, ACCELERATION[row]] = dt_s * dt_s / 2.0
    first = np.stack(polar_to_plan(z_first[..., RANGE], z_first[..., AZIMUTH]), axis=-1)
    first_cov = plan_covariance(z_first[..., RANGE], z_first[..., AZIMUTH], R_first[..., :2, :2])
    H = np.broadcast_to(H, (*mean.shape[:-1], 2, STATES))
    mean, cov = _condition(mean, cov, first - (H @ mean[..., None])[..., 0], H, first_cov)
    return _use_range_rate(mean, cov, z, R)


def _from_position(z: F64, R: F64, prior: VelocityPrior, accel_std_mps2: float) -> tuple[F64, F64]:
    mean = np.zeros((*z.shape[:-1], STATES))
    cov = np.zeros((*z.shape[:-1], STATES, STATES))
    p, v, a = list(POSITION), list(VELOCITY), list(ACCELERATION)
    mean[..., p] = np.stack(polar_to_plan(z[..., RANGE], z[..., AZIMUTH]), axis=-1)
    mean[..., v] = prior.mean_mps
    cov[..., np.ix_(p, p)[0], np.ix_(p, p)[1]] = plan_covariance(
        z[..., RANGE], z[..., AZIMUTH], R[..., :2, :2]
    )
    cov[..., np.ix_(v, v)[0], np.ix_(v, v)[1]] = prior.cov
    cov[..., a, a] = accel_std_mps2**2
    return mean, cov


def _use_range_rate(mean: F64, cov: F64, z: F64, R: F64) -> tuple[F64, F64]:
    """Return the state after the range rate; states whose range rate is NaN stay as they are."""
    H = jacobian(mean)[..., RANGE_RATE : RANGE_RATE + 1, :]
    e = z[..., RANGE_RATE] - predict_measurement(mean)[..., RANGE_RATE]
    known = np.isfinite(e)
    variance = np.where(known, R[..., RANGE_RATE, RANGE_RATE], 1.0)
    H = np.where(known[..., None, None], H, 0.0)
    return _condition(mean, cov, np.where(known, e, 0.0)[..., None], H, variance[..., None, None])


def _condition(mean: F64, cov: F64, e: F64, H: F64, R: F64) -> tuple[F64, F64]:
    """Return the Kalman update (Joseph form) with innovation e (..., m), H (..., m, 6) and R (..., m, m)."""
    HP = H @ cov
    S = HP @ H.swapaxes(-1, -2) + R
    K = np.linalg.solve(S, HP).swapaxes(-1, -2)
    left = np.eye(STATES) - K @ H
    joseph = left @ cov @ left.swapaxes(-1, -2) + K @ R @ K.swapaxes(-1, -2)
    return mean + (K @ e[..., None])[..., 0], (joseph + joseph.swapaxes(-1, -2)) * 0.5
