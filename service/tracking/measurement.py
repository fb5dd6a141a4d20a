"""The measurement of a point in the plan frame: z = (ground range, azimuth, ground-plane range rate).

Metres, radians, metres per second; azimuth is atan2(x, y), clockwise from +y. The state is [x vx ax y vy
ay]. A measurement without Doppler carries NaN as its range rate; `innovation` leaves the NaN in place and
the filters treat that channel as not measured.
"""

from __future__ import annotations

import math

import numpy as np

from service.tracking.geometry import wrap_angle
from service.tracking.kernel import kernel, ready
from service.tracking.model import F64
from service.tracking.motion import STATES

CHANNELS = 3
RANGE, AZIMUTH, RANGE_RATE = 0, 1, 2  # columns of z
# The azimuth has no derivative at the radar itself; a state nearer than this counts as this far. Vehicles are
# tracked from tens of metres on, so only a lost track ever meets it.
NEAREST_M = 0.5


def predict_measurement(mean: F64) -> F64:
    """Return the measurement (..., 3) of the states (..., 6)."""
    return linearise(mean)[0]


def jacobian(mean: F64) -> F64:
    """Return H = dz/dx (..., 3, 6) at the states (..., 6)."""
    return linearise(mean)[1]


def linearise(mean: F64) -> tuple[F64, F64]:
    """Return the measurement z (..., 3) of the states (..., 6) and its derivative H = dz/dx (..., 3, 6).

    With the unit vector u = (x, y)/r along the line of sight: dr = u dp; daz = (y dx - x dy)/r^2;
    d(rdot) = u dv + (v - (u v) u)/r dp.
    """
    states, leading = ready(mean).reshape(-1, STATES), mean.shape[:-1]
    z, H = np.empty((*leading, CHANNELS)), np.zeros((*leading, CHANNELS, STATES))
    _linearise(states, z.reshape(-1, CHANNELS), H.reshape(-1, CHANNELS, STATES))
    return z, H


@kernel
def _linearise(mean: F64, z: F64, H: F64) -> None:
    for t in range(len(mean)):
        x, vx, y, vy = mean[t, 0], mean[t, 1], mean[t, 3], mean[t, 4]
        r = max(math.hypot(x, y), NEAREST_M)
        ux, uy = x / r, y / r
        rate = ux * vx + uy * vy
        z[t, RANGE] = r
        z[t, AZIMUTH] = math.atan2(x, y)
        z[t, RANGE_RATE] = rate
        H[t, RANGE, 0] = H[t, RANGE_RATE, 1] = ux
        H[t, RANGE, 3] = H[t, RANGE_RATE, 4] = uy
        H[t, AZIMUTH, 0] = uy / r
        H[t, AZIMUTH, 3] = -ux / r
        H[t, RANGE_RATE, 0] = (vx - rate * ux) / r
        H[t, RANGE_RATE, 3] = (vy - rate * uy) / r


def innovation(z: F64, z_hat: F64) -> F64:
    """Return z - z_hat (..., 3) with the azimuth wrapped to (-pi, pi]."""
    e = z - z_hat
    e[..., AZIMUTH] = wrap_angle(e[..., AZIMUTH])
    return e
