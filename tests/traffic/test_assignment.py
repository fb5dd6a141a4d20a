from __future__ import annotations

import numpy as np
import pytest

from service.tracking.model import TrackStatus
from service.traffic.assignment import AssignmentParameters, assign, chart_of, unfinished
from service.traffic.measured import measured_of
from service.traffic.model import Lane, LaneMap, Moment
from service.traffic.vehicles import aligned, no_vehicles, parted
from tests.traffic.tracks import FRAME_US, START_US, estimates

P = AssignmentParameters()
SPEED_MPS = 15.0


def lane(index, x_m, *, start_m=20.0, end_m=150.0, width_m=3.5, backwards=False):
    y = np.arange(start_m, end_m + 1.0, 4.0)
    points = np.column_stack([np.full(len(y), x_m), y])
    return Lane(
        index=index, lane_id=f"L{index}", kind="lane", direction="receding",
        points_m=points[::-1] if backwards else points, width_m=np.full(len(y), width_m), confidence=1.0,
        vehicles=20,
    )  # fmt: skip


def road(*lanes):
    return chart_of(LaneMap(1, START_US, 1, 60, "learned", tuple(lanes)))


TWO = road(lane(1, 0.0), lane(2, 3.5))


def follow(chart, x_m, *, y_m=None, speed_mps=SPEED_MPS, status=None, std_m=0.1, parameters=P):
    """Drive one vehicle along x_m (K,) and return its lane at each frame and its changes."""
    vehicles, lanes, changes = no_vehicles(), [], []
    y_m = 25 + speed_mps * FRAME_US / 1e6 * np.arange(len(x_m)) if y_m is None else y_m
    for k, (x, y) in enumerate(zip(x_m, y_m, strict=True)):
        seen = TrackStatus.CONFIRMED if status is None else status[k]
        now = estimates([1], x, y, 0.0, speed_mps, status=seen, std_m=std_m)
        vehicles = aligned(vehicles, now.number)
        moment = Moment(START_US + k * FRAME_US, k, tick=False)
        found, changed = assign(vehicles, moment, measured_of(now), chart, 1, parameters)
        lanes.append(int(found[0]))
        changes += changed
    return lanes, changes


def ramp(start_s, seconds, *, from_m=0.0, to_m=3.5, total_s=8.0):
    t = np.arange(0, total_s, FRAME_US / 1e6)
    return from_m + (to_m - from_m) * np.clip((t - start_s) / seconds, 0, 1)


def test_a_change_is_told_once_and_dated_back_to_the_boundary():
    lanes, changes = follow(TWO, ramp(2.0, 4.0))

    assert lanes[0] == 1
    assert lanes[-1] == 2
    assert len(changes) == 1
    change = changes[0]
    assert (change.from_lane, change.to_lane) == (1, 2)
    assert (change.time_us - START_US) / 1e6 == pytest.approx(4.0, abs=0.03)
    assert change.x_m == pytest.approx(1.75, abs=0.03)
    assert change.y_m == pytest.approx(25 + 4.0 * SPEED_MPS, abs=0.5)
    assert change.speed_mps == pytest.approx(SPEED_MPS)
    assert change.decided_us > change.time_us + 0.6e6


def test_who_trembles_about_the_boundary_changes_nothing():
    t = np.arange(0, 8.0, FRAME_US / 1e6)

    lanes, changes = follow(TWO, 1.75 + 0.25 * np.sin(2 * np.pi * t / 1.5))

    assert changes == []
    assert len(set(lanes)) == 1


def test_who_goes_over_for_a_moment_and_comes_back_changes_nothing():
    t = np.arange(0, 8.0, FRAME_US / 1e6)

    lanes, changes = follow(TWO, 2.6 * np.exp(-(((t - 4) / 0.4) ** 2)))

    assert changes == []
    assert set(lanes) == {1}


def test_a_doubtful_place_must_be_farther_past_the_boundary():
    path = ramp(2.0, 3.0, to_m=2.3)  # half a metre past the boundary, and there it stays

    assert len(follow(TWO, path, std_m=0.1)[1]) == 1
    assert follow(TWO, path, std_m=0.9)[1] == []


def test_a_standing_vehicle_changes_no_lane():
    path = ramp(2.0, 1.0, to_m=2.6)

    assert follow(TWO, path, y_m=np.full(len(path), 60.0), speed_mps=0.2)[1] == []


def test_nobody_saw_a_change_while_the_track_coasted():
    path = ramp(2.0, 3.0)
    status = np.where(np.arange(len(path)) > 40, TrackStatus.COASTING, TrackStatus.CONFIRMED)

    lanes, changes = follow(TWO, path, status=status)

    assert changes == []
    assert set(lanes) == {1}


def test_the_first_lane_of_a_new_track_is_a_guess():
    lanes, changes = follow(TWO, ramp(0.0, 0.4))  # born in the wrong lane by its first points

    assert lanes[-1] == 2
    assert changes == []


def test_where_a_lane_ends_the_way_into_the_next_is_no_change():
    chart = road(lane(1, 0.0), lane(2, 3.5, end_m=70.0))

    lanes, changes = follow(chart, ramp(2.5, 2.0, from_m=3.5, to_m=0.6))

    assert lanes[0] == 2
    assert lanes[-1] == 1
    assert changes == []


def test_beside_the_road_there_is_no_lane():
    assert set(follow(TWO, np.full(60, 9.0))[0]) == {0}
    assert set(follow(TWO, np.full(60, 4.0))[0]) == {2}


def test_a_lane_holds_a_vehicle_further_out_than_it_takes_one_in():
    outside = 1.75 + 0.6  # beyond its half width: as a vehicle of a lane that is not learned yet
    assert set(follow(TWO, np.full(60, -outside))[0]) == {0}
    assert set(follow(TWO, np.full(60, -1.75 - 0.2))[0]) == {1}
    assert set(follow(TWO, ramp(1.0, 2.0, to_m=-outside))[0]) == {1}


def test_who_drives_beside_its_lane_does_not_go_over_into_one_that_has_ended():
    chart, x = road(lane(1, 0.0), lane(2, 3.5, end_m=72.0)), ramp(0.3, 0.5, to_m=2.4, total_s=2.0)
    y = 73.0 + 5.0 * FRAME_US / 1e6 * np.arange(len(x))

    lanes, changes = follow(chart, x, y_m=y, speed_mps=5.0)

    assert set(lanes) == {1}
    assert changes == []


@pytest.mark.parametrize(("y_m", "backwards"), [(14.0, False), (157.0, False), (14.0, True), (157.0, True)])
def test_beyond_its_ends_a_lane_is_narrow(y_m, backwards):
    chart, y = road(lane(1, 0.0, backwards=backwards)), np.full(10, y_m)
    assert set(follow(chart, np.full(10, 1.0), y_m=y)[0]) == {1}
    assert set(follow(chart, np.full(10, 1.4), y_m=y)[0]) == {0}
    assert set(follow(chart, np.full(10, 1.4), y_m=y + 10.0 * np.sign(80.0 - y_m))[0]) == {1}


def test_who_crosses_a_lane_is_not_in_it():
    now = estimates([1, 2], [0.1, 0.1], [60, 60], [12, 0], [0, 12])
    vehicles = aligned(no_vehicles(), now.number)

    found, _ = assign(vehicles, Moment(START_US, 1, tick=False), measured_of(now), TWO, 1, P)

    assert found.tolist() == [0, 1]


def test_a_wrong_way_driver_is_in_the_lane_it_drives_in():
    lanes, _ = follow(road(lane(1, 0.0, backwards=True)), np.full(20, 0.2))

    assert set(lanes) == {1}


def test_where_lanes_lie_on_one_another_the_one_of_the_same_way_is_taken():
    chart = road(lane(1, 0.0, backwards=True), lane(2, 0.6))

    assert set(follow(chart, np.full(20, 0.2))[0]) == {2}


def test_no_change_is_told_where_a_lane_begins_beside_the_vehicle():
    chart = road(lane(1, 0.0), lane(2, 2.6, start_m=70.0))

    lanes, changes = follow(chart, np.full(120, 1.9))

    assert (lanes[0], lanes[-1]) == (1, 2)
    assert changes == []


def test_who_is_lost_past_the_boundary_was_about_to_change():
    vehicles = no_vehicles()
    for k, x in enumerate(ramp(2.0, 4.0)[:91]):  # half a second behind the boundary
        now = estimates([1], x, 25 + SPEED_MPS * FRAME_US / 1e6 * k, 0.0, SPEED_MPS, std_m=0.1)
        vehicles = aligned(vehicles, now.number)
        _, changed = assign(
            vehicles, Moment(START_US + k * FRAME_US, k, tick=False), measured_of(now), TWO, 1, P
        )
        assert changed == ()

    (change,) = unfinished(
        parted(vehicles, np.zeros(0, dtype=np.int64))[1], now_us=START_US + 5_000_000, version=1, p=P
    )

    assert (change.from_lane, change.to_lane) == (1, 2)
    assert (change.time_us - START_US) / 1e6 == pytest.approx(4.0, abs=0.06)
    assert len(unfinished(parted(vehicles, vehicles.number)[1], now_us=0, version=1, p=P)) == 0
