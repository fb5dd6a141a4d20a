from __future__ import annotations

import numpy as np

from service.tracking.model import MotionState, TrackStatus
from service.traffic.assignment import chart_of
from service.traffic.measured import measured_of
from service.traffic.model import NO_MAP, LaneMap, Moment
from service.traffic.motion_state import MotionParameters, classify
from service.traffic.vehicles import LANE, aligned, no_vehicles
from tests.traffic.test_assignment import lane
from tests.traffic.tracks import START_US, estimates

NOWHERE = chart_of(NO_MAP)
FORWARD_RAD = 0.0


def states(speed_mps, *, hz=20.0, status=None, chart=NOWHERE, index=0, forward=FORWARD_RAD, y_m=60.0, p=None):
    """The motion state after each frame of a vehicle with these speeds along +y."""
    vehicles, out = no_vehicles(), []
    for k, v in enumerate(speed_mps):
        seen = TrackStatus.CONFIRMED if status is None else status[k]
        now = estimates([1], 0.0, y_m, 0.0, v, status=seen)
        vehicles = aligned(vehicles, now.number)
        vehicles.whole[:, LANE] = index if np.isscalar(index) else index[k]
        moment = Moment(START_US + round(1e6 * k / hz), k, tick=False)
        out.append(
            int(classify(vehicles, moment, measured_of(now), chart, forward, p or MotionParameters())[0])
        )
    return out


def transitions(found, hz):
    """(time in seconds, state) of each change of state."""
    changes = [k for k in range(1, len(found)) if found[k] != found[k - 1]]
    return [(k / hz, MotionState(found[k]).name) for k in changes]


def test_the_drive_of_the_paper_gives_its_states_at_its_times():
    """Parked, reversing, stopped, forwards, stopped: section 5 of the paper, at 25 frames/s.

    The speed is put together from straight pieces of 1 m/s^2 that pass 0.5 m/s three frames before the
    paper's times: the curve of its figure 10 is not published as numbers.
    """
    hz = 25.0
    t = np.arange(0, 30, 1 / hz)
    corners_s = [0, 1.7, 5.7, 10.9, 14.9, 18.8, 22.8, 24.8, 28.8, 30]
    speed = np.interp(t, corners_s, [0, 0, -4, -4, 0, 0, 4, 4, 0, 0])
    speed = speed + np.random.default_rng(3).normal(0, 0.05, len(t))

    found = transitions(states(speed, hz=hz), hz)

    wanted = [
        (0.08, "STATIONARY"), (2.3, "ONCOMING"), (14.5, "START_STOP"), (16.5, "STATIONARY"),
        (19.4, "MOVING"), (28.4, "START_STOP"),
    ]  # fmt: skip
    assert [name for _, name in found] == [name for _, name in wanted]
    np.testing.assert_allclose([time for time, _ in found], [time for time, _ in wanted], atol=0.1)


def test_one_odd_frame_changes_nothing():
    speed = np.full(60, 10.0)
    speed[30:32] = 0.0

    assert set(states(speed)[2:]) == {MotionState.MOVING}


def test_misses_neither_count_nor_break_a_row():
    status = np.full(6, TrackStatus.CONFIRMED)
    status[[1, 3, 4]] = TrackStatus.COASTING

    found = states([10, 0, 10, 0, 0, 10], status=status)

    assert found == [0, 0, 0, 0, 0, MotionState.MOVING]


def test_turning_round_passes_through_start_stop():
    found = states([10] * 10 + [-10] * 10)

    assert [name for _, name in transitions(found, 20)] == ["MOVING", "START_STOP", "ONCOMING"]


def test_without_lane_and_heading_going_away_from_the_radar_is_moving():
    assert states([10] * 5, forward=None)[-1] == MotionState.MOVING
    assert states([-10] * 5, forward=None)[-1] == MotionState.ONCOMING
    assert states([10] * 5, forward=None, y_m=-60.0)[-1] == MotionState.ONCOMING


def test_the_lane_says_what_is_forward_and_learning_it_is_no_manoeuvre():
    chart = chart_of(LaneMap(1, 0, 1, 9, "learned", (lane(1, 0.0, backwards=True),)))

    found = states([-10] * 20, chart=chart, index=[0] * 10 + [1] * 10)

    assert found[5] == MotionState.ONCOMING
    assert set(found[10:]) == {MotionState.MOVING}
    assert states([10] * 20, chart=chart, index=1)[-1] == MotionState.ONCOMING


def test_who_creeps_in_a_queue_does_not_become_stationary():
    speed = np.tile(np.concatenate([np.full(20, 0.2), np.full(10, 0.9)]), 6)

    assert MotionState.STATIONARY not in states(np.concatenate([np.full(20, 5.0), speed]))
