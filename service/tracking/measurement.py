"""The measurement of a point in the plan frame: z = (ground range, azimuth, ground-plane range rate).

Metres, radians, metres per second; azimuth is atan2(x, y), clockwise from +y. The state is [x vx ax y vy
ay]. A measurement without Doppler carries NaN as its range rate; `innovation` leaves the NaN in place and
the filters treat that channel as not measured.
"""

from __future__ import annotations

import numpy as np

from service.tracking.geometry import wrap_angle
from service.tracking.model import F64
from service.tracking.motion import STATES

CHANNELS = 3
RANGE, AZIMUTH, RANGE_RATE = 0, 1, 2  # columns of z
# The azimuth has no derivative at the radar itself; a state nearer than this counts as this far. Vehicles are
# tracked from tens of metres on, so only a lost track ever meets it.
NEAREST_M = 0.5


def predict_measurement(mean: F64) -> F64:
    """Return the measurement (..., 3) of the states (..., 6)."""
    x, vx, y, vy = mean[..., 0], mean[..., 1], mean[..., 3], mean[..., 4]
    r = _range(x, y)
    return np.stack([r, np.arctan2(x, y), (x * vx + y * vy) / r], axis=-1)


def jacobian(mean: F64) -> F64:
    """Return H = dz/dx (..., 3, 6) at the states (..., 6).

    With the unit vector u = (x, y)/r along the line of sight: dr = u dp; daz = (y dx - x dy)/r^2;
    d(rdot) = u dv + (v - (u v) u)/r dp.
    """
    x, vx, y, vy = mean[..., 0], mean[..., 1], mean[..., 3], mean[..., 4]
    r = _range(x, y)
    ux, uy = x / r, y / r
    rate = ux * vx + uy * vy
    H = np.zeros((*mean.shape[:-1], CHANNELS, STATES))
    H[..., RANGE, 0], H[..., RANGE, 3] = ux, uy
    H[..., AZIMUTH, 0], H[..., AZIMUTH, 3] = uy / r, -ux / r
    H[..., RANGE_RATE, 0], H[..., RANGE_RATE, 3] = (vx - rate * ux) / r, (vy - rate * uy) / r
    H[..., RANGE_RATE, 1], H[..., RANGE_RATE, 4] = ux, uy
    return H


def innovation(z: F64, z_hat: F64) -> F64:
    """Return z - z_hat (..., 3) with the azimuth wrapped to (-pi, pi]."""
    e = z - z_hat
    e[..., AZIMUTH] = wrap_angle(e[..., AZIMUTH])
    return e


def _range(x: F64, y: F64) -> F64:
    return np.maximum(np.hypot(x, y), NEAREST_M)
