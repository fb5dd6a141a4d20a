"""The fast target of the MAST-UKF paper: straight, a circle, a push, the circle back, and straight again.

Source: Appl. Sci. 2025, 15, 3276, section 3.3 and table 1: 175 s, a measurement a second, from (300, 200) m
at 70 m/s along x; turn rates of 0.1 and -0.1 rad/s; 0.1 m/s^2 along x.
"""

from __future__ import annotations

import numpy as np

from service.tracking.filters.space import ROAD_COLUMNS, velocity_step
from service.tracking.model import F64

PERIOD_S = 1.0
STEPS = 175
TURN_RADPS = 0.1
_PUSH_MPS2 = 0.1
_START = (300.0, 70.0, 200.0, 0.0)
# step after which a motion ends, turn rate, acceleration along x
_MOTIONS = (
    (40, 0.0, 0.0),
    (75, TURN_RADPS, 0.0),
    (100, 0.0, _PUSH_MPS2),
    (135, -TURN_RADPS, 0.0),
    (175, 0.0, 0.0),
)


def turning_target() -> tuple[F64, F64]:
    """Return the states (STEPS + 1, 6) [x vx ax y vy ay] and the true transition (STEPS + 1, 6, 6) into each.

    The push is a known input, which no transition holds; the first transition is the identity.
    """
    truth, steps = np.zeros((STEPS + 1, 6)), np.tile(np.eye(6), (STEPS + 1, 1, 1))
    columns = list(ROAD_COLUMNS)
    truth[0, columns] = _START
    for k in range(1, STEPS + 1):
        _, rate, push = next(motion for motion in _MOTIONS if k <= motion[0])
        F = velocity_step(PERIOD_S, 0.0, rate).F
        truth[k, columns] = F @ truth[k - 1, columns] + push * np.array([PERIOD_S**2 / 2, PERIOD_S, 0.0, 0.0])
        steps[k][np.ix_(columns, columns)] = F
    return truth, steps
