"""Judge how each vehicle moves, over a window of frames: stationary, moving, oncoming or start-stop.

Source: "A novel target tracking ... ISRCKF" 2020, section 4: a state is entered after N frames in a row with
the speed in its band; who comes to rest is in start-stop first, and stationary after M seconds. Two rules are
added where the paper leaves a state without a way out: moving and oncoming change into one another through
start-stop, and start-stop becomes stationary only while the speed is still near zero. Frames without a
detection neither count nor break a row.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, U8, MotionState
from service.traffic.assignment import Chart
from service.traffic.measured import VX, VY, Measured, X, Y
from service.traffic.model import Moment
from service.traffic.vehicles import AHEAD_X, AHEAD_Y, IN_A_ROW, LANE, MOTION, STOPPED_US, ZONE, Vehicles

_UNCLASSIFIED, _STATIONARY, _MOVING = (
    int(MotionState.UNCLASSIFIED), int(MotionState.STATIONARY), int(MotionState.MOVING)
)  # fmt: skip
_ONCOMING, _START_STOP = int(MotionState.ONCOMING), int(MotionState.START_STOP)


@dataclass(frozen=True, slots=True)
class MotionParameters:
    """Bands and windows of the state machine; the defaults are the paper's."""

    frames: int = 3  # N: in a row with the speed in one band
    stationary_after_s: float = 2.0  # M: in start-stop
    rest_mps: float = 0.5  # slower is at rest
    leave_mps: float = 0.5  # who is at rest moves from here on; 0.8 bears 0.3 m/s of noise


def classify(  # noqa: PLR0913, PLR0917 - the state, the frame, the map
    vehicles: Vehicles, moment: Moment, now: Measured, chart: Chart, forward_rad: float | None,
    p: MotionParameters,
) -> U8:  # fmt: skip
    """Return the motion state (T,) of each track; writes into `vehicles`.

    Forward is the direction of the vehicle's lane; outside of lanes `forward_rad`, or, where that is None,
    away from the radar.
    """
    if len(now.row) and not moment.tick:
        fixed = (0.0, 0.0) if forward_rad is None else (math.sin(forward_rad), math.cos(forward_rad))
        _classify(
            now.row, moment.time_us, now.real[:4], vehicles.whole, vehicles.real, chart.index, chart.first,
            chart.point, fixed, (p.frames, int(1e6 * p.stationary_after_s)), (p.rest_mps, p.leave_mps),
        )  # fmt: skip
    return vehicles.whole[:, MOTION].astype(np.uint8)


@kernel
def _classify(  # noqa: C901, PLR0912, PLR0913, PLR0917 - one pass over the tracks
    row: I64, now_us: int, plane: F64, whole: I64, real: F64, index: I64, first: I64, point: F64,
    fixed: tuple[float, float], window: tuple[int, int], bands: tuple[float, float],
) -> None:  # fmt: skip
    """Write the state of each vehicle; plane (4, M): x, y, vx, vy of those in the rows `row`."""
    frames, stationary_after_us = window
    rest, leave = bands
    for r in range(len(row)):
        i, x, y = row[r], plane[X, r], plane[Y, r]
        ahead_x, ahead_y = fixed
        if ahead_x == 0.0 and ahead_y == 0.0:
            away = math.hypot(x, y)
            ahead_x, ahead_y = x / away, y / away
        for k in range(len(index)):
            if index[k] == whole[i, LANE]:
                best = math.inf
                for n in range(first[k], first[k + 1] - 1):
                    ex, ey = point[n + 1, 0] - point[n, 0], point[n + 1, 1] - point[n, 1]
                    middle_x, middle_y = point[n, 0] + 0.5 * ex, point[n, 1] + 0.5 * ey
                    distance = (x - middle_x) ** 2 + (y - middle_y) ** 2
                    if distance < best:
                        best, ahead_x, ahead_y = distance, ex, ey
                if best < math.inf:
                    size = math.hypot(ahead_x, ahead_y)
                    ahead_x, ahead_y = ahead_x / size, ahead_y / size
        state = whole[i, MOTION]
        if real[i, AHEAD_X] * ahead_x + real[i, AHEAD_Y] * ahead_y < 0.0:
            # forward is judged anew (a lane has been learned): what the vehicle does has not changed
            if state in (_MOVING, _ONCOMING):
                state = _MOVING + _ONCOMING - state
            whole[i, ZONE] = -whole[i, ZONE]
        real[i, AHEAD_X], real[i, AHEAD_Y] = ahead_x, ahead_y
        speed = plane[VX, r] * ahead_x + plane[VY, r] * ahead_y
        band = leave if state in (_STATIONARY, _START_STOP) else rest
        zone = 0 if abs(speed) <= band else (1 if speed > 0.0 else -1)
        whole[i, IN_A_ROW] = whole[i, IN_A_ROW] + 1 if zone == whole[i, ZONE] else 1
        whole[i, ZONE] = zone
        if whole[i, IN_A_ROW] >= frames:
            if zone == 0:
                if state == _UNCLASSIFIED:
                    state = _STATIONARY
                elif state in (_MOVING, _ONCOMING):
                    state = _START_STOP
                    whole[i, STOPPED_US] = now_us
            else:
                wanted = _MOVING if zone > 0 else _ONCOMING
                if state == _MOVING + _ONCOMING - wanted:
                    state = _START_STOP
                    whole[i, STOPPED_US] = now_us
                    whole[i, IN_A_ROW] = 0
                else:
                    state = wanted
        if state == _START_STOP and zone == 0 and now_us - whole[i, STOPPED_US] >= stationary_after_us:
            state = _STATIONARY
        whole[i, MOTION] = state
