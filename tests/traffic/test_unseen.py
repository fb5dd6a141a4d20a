from __future__ import annotations

import numpy as np
import pytest

from service.formats.sensor import CountLine, SensorConfig
from service.traffic.counting import count, nothing_counted
from service.traffic.measured import measured_of
from service.traffic.model import NO_MAP, LaneMap, Moment
from service.traffic.parameters import traffic_setup
from tests.traffic.test_crossing_lanes import LANES, lane
from tests.traffic.test_crossings import NOBODY, crossings, drive, merged, watch
from tests.traffic.tracks import FRAME_US, START_US, estimates

FAR = traffic_setup(SensorConfig(count_lines=(CountLine(line_id="C120", p0=(-6.0, 120.0), p1=(6.0, 120.0)),)))
STEP_M = 15.0 * FRAME_US / 1e6


def approach(number, first_m, last_m, *, x_m=1.75, wait=60, born=True):
    """Nobody for some frames, then a vehicle that comes at 15 m/s; born: its track begins as it is listed."""
    y = np.arange(first_m, last_m, -STEP_M)
    frames = drive(number, y, x_m=x_m, vy_mps=-15.0)
    if born:
        for now in frames:
            now.born_us[:] = START_US + wait * FRAME_US
    return [NOBODY] * wait + frames


def leave(number, first_m, last_m, *, x_m=1.75, speed_mps=15.0):
    y = np.arange(first_m, last_m, speed_mps * FRAME_US / 1e6)
    return drive(number, y, x_m=x_m, vy_mps=speed_mps)


def seen(frames, lanes=LANES, setup=FAR):
    return crossings(frames, lanes=lanes, setup=setup)


def test_a_vehicle_first_seen_behind_a_line_of_its_lane_crossed_it_before():
    (crossing,) = seen(approach(7, 105.0, 30.0))

    assert (crossing.track, crossing.lane, crossing.direction) == (7, 2, -1)
    assert crossing.time_us - START_US == pytest.approx(60 * FRAME_US - 1e6, abs=2000)
    assert (crossing.x_m, crossing.y_m) == pytest.approx((1.75, 120.0), abs=1e-3)
    assert crossing.speed_mps == pytest.approx(15.0, abs=1e-3)
    assert crossing.probability == pytest.approx(0.99 * 0.93, abs=1e-3)  # less sure than one that was seen


def test_a_vehicle_last_seen_before_a_line_crosses_it_later():
    away = LaneMap(1, START_US, 1, 40, "learned", (lane(1, 1.75, backwards=True),))
    frames = leave(3, 60.0, 105.0)
    (crossing,) = seen([*frames, *[NOBODY] * 120], away)

    last_us = (len(frames) - 1) * FRAME_US
    ahead_m = 120.0 - float(frames[-1].y_m[0])
    assert crossing.time_us - START_US == pytest.approx(last_us + ahead_m / 15.0 * 1e6, abs=2000)
    assert (crossing.track, crossing.lane, crossing.direction) == (3, 1, 1)


def test_without_a_lane_over_the_line_nobody_must_have_crossed_it():
    beside = LaneMap(1, START_US, 1, 40, "learned", (lane(1, -8.0), lane(2, 20.0)))
    turning = LaneMap(1, START_US, 1, 40, "learned", (lane(2, 1.75, kind="turn"),))
    for lanes in (NO_MAP, beside, turning):
        assert seen(approach(7, 105.0, 30.0), lanes) == []


def test_it_must_have_been_followed_for_a_while_near_the_line_and_in_motion():
    assert seen(approach(7, 105.0, 80.0)) == []  # for 1.7 s
    assert seen(approach(7, 55.0, 5.0)) == []  # 4.3 s behind it
    creeping = [NOBODY] * 60 + drive(7, 118.0 - 0.1 * np.arange(80), x_m=1.75, vy_mps=-2.0)
    for now in creeping[60:]:
        now.born_us[:] = START_US + 60 * FRAME_US
    assert seen(creeping) == []


def test_a_crossing_before_the_first_frame_or_in_time_without_frames_was_not_observed():
    assert seen(approach(7, 105.0, 30.0, wait=10)) == []

    frames, gap_us = approach(7, 105.0, 30.0, wait=0), 3_000_000
    state, told = nothing_counted(), []
    for k, now in enumerate([NOBODY, *frames]):
        now.born_us[:] = START_US + gap_us
        moment = Moment(START_US + (gap_us if k else 0) + k * FRAME_US, k, tick=False)
        state, counts = count(state, moment, now, measured_of(now), LANES, FAR)
        told += counts.crossings
    assert told == []

    away = LaneMap(1, START_US, 1, 40, "learned", (lane(1, 1.75, backwards=True),))
    assert seen(leave(3, 60.0, 105.0), away) == []  # no frame came when it would have crossed
    assert not watch(leave(3, 60.0, 105.0), lanes=away, setup=FAR, ticks=8)[1].unseen.waiting


def later(frames, number, first_m, last_m):
    """Put a vehicle that is first seen in frame `frames` behind that many frames without it."""
    born_us = START_US + frames * FRAME_US
    found = drive(number, np.arange(first_m, last_m, -STEP_M), x_m=1.75, vy_mps=-15.0)
    for now in found:
        now.born_us[:] = born_us
    return [NOBODY] * frames + found


def test_who_was_counted_there_at_that_moment_is_not_counted_again():
    first, again = approach(1, 140.0, 110.0), later(165, 7, 61.25, 5.0)

    assert [crossing.track for crossing in seen([*first, *again[len(first) :]])] == [1]
    assert [crossing.track for crossing in seen(again)] == [7]


def test_a_follower_that_was_hidden_behind_another_is_counted():
    leader, hidden = approach(1, 140.0, 20.0), later(120, 7, 110.0, 20.0)
    frames = merged(leader, [*[None] * 120, *hidden[120:]])
    for k, now in enumerate(frames):
        now.born_us[now.number == 7] = START_US + 120 * FRAME_US
        now.born_us[now.number == 1] = START_US + min(k, 60) * FRAME_US

    assert sorted(crossing.track for crossing in seen(frames)) == [1, 7]


def test_where_speeds_are_known_at_the_line_they_tell_how_long_it_took():
    slow = [estimates([1], 1.75, y, 0.0, -5.0) for y in np.arange(125.0, 112.0, -0.25)]
    for now in slow:
        now.born_us[:] = START_US
    fast = approach(7, 105.0, 30.0, wait=0, born=False)
    for now in fast:
        now.born_us[:] = START_US + (len(slow) + 90) * FRAME_US
    found = seen([*slow, *[NOBODY] * 90, *fast])

    assert [crossing.track for crossing in found] == [1, 7]
    back_s = 15.0 * (0.5 / 15.0 + 0.5 / 5.0)
    born_us = (len(slow) + 90) * FRAME_US
    assert found[1].time_us - START_US == pytest.approx(born_us - back_s * 1e6, abs=5000)
    assert found[1].speed_mps == pytest.approx(5.0, abs=0.01)


AWAY = LaneMap(1, START_US, 1, 40, "learned", (lane(1, 1.75, backwards=True),))


def listed_from(first, listed):
    """Put a vehicle whose track begins in frame `first` behind that many frames without anybody."""
    for now in listed:
        now.born_us[:] = START_US + first * FRAME_US
    return [NOBODY] * first + listed


def test_one_lost_before_a_line_and_found_again_before_it_crosses_once():
    lost = leave(3, 60.0, 105.0)
    again = listed_from(len(lost) + 40, leave(9, 107.0, 126.0, speed_mps=4.0))

    assert [crossing.track for crossing in seen([*lost, *again[len(lost) :], *[NOBODY] * 90], AWAY)] == [9]
    assert [crossing.track for crossing in seen([*lost, *[NOBODY] * 300], AWAY)] == [3]


def test_where_one_stands_before_the_line_the_next_has_not_crossed_it():
    standing = drive(1, [118.0] * 400, x_m=1.75, vy_mps=0.0)
    behind = leave(3, 60.0, 105.0)
    together = merged(standing, behind)

    assert seen(together, AWAY) == []
    beside = merged(drive(1, [118.0] * 400, x_m=-1.75, vy_mps=0.0), behind)
    assert [crossing.track for crossing in seen(beside, AWAY)] == [3]


def test_one_lost_before_a_line_and_found_behind_it_is_counted_once_however_late():
    lost = approach(1, 150.0, 126.0, wait=0)
    lost = lost[:1] * 40 + lost  # followed for long enough
    found = later(len(lost) + 66, 7, 66.0, 5.0)  # 0.8 s too far on

    assert len(seen([*lost, *found[len(lost) :], *[NOBODY] * 60])) == 1


def test_who_starts_behind_a_line_did_not_cross_it_a_moment_ago():
    y, speed, frames = 112.0, 0.3, []
    for _ in range(120):
        frames.append(estimates([7], 1.75, y, 0.0, -speed))
        y, speed = y - speed * FRAME_US / 1e6, min(speed + 3.0 * FRAME_US / 1e6, 12.0)

    assert seen(listed_from(60, frames)) == []
    assert len(seen(listed_from(60, approach(7, 112.0, 40.0, wait=0)))) == 1


def test_a_vehicle_near_the_middle_of_a_two_way_road_crossed_in_a_lane_of_its_own_direction():
    both = LaneMap(1, START_US, 1, 40, "learned", (lane(1, -1.5, backwards=True), lane(2, 1.5)))
    (crossing,) = seen(approach(7, 105.0, 30.0, x_m=-0.1), both)

    assert (crossing.lane, crossing.direction) == (2, -1)


def test_who_was_last_seen_on_the_line_or_first_seen_on_it_is_counted():
    lost = leave(3, 60.0, 120.7)
    assert [crossing.track for crossing in seen([*lost, *[NOBODY] * 120], AWAY)] == [3]

    found = listed_from(60, approach(7, 120.7, 60.0, wait=0))
    (crossing,) = seen(found)
    assert crossing.time_us - START_US == pytest.approx(60 * FRAME_US + 0.7 / 15.0 * 1e6, abs=2000)


def test_one_that_has_stepped_over_the_line_and_waits_behind_it_is_not_counted_twice():
    waits = np.concatenate(
        [np.arange(126.0, 119.0, -STEP_M), np.full(160, 119.0), np.arange(119.0, 100.0, -STEP_M)]
    )
    standing = drive(1, waits, x_m=1.75, vy_mps=-1.0)
    again = later(9 + 20, 7, 105.0, 40.0)
    frames = merged(standing, [*[None] * 29, *again[29:]])
    for now in frames:
        now.born_us[now.number == 7] = START_US + 29 * FRAME_US

    assert [crossing.track for crossing in seen([*frames, *[NOBODY] * 60])] == [1]


def test_the_speed_of_a_crossing_that_nobody_saw_tells_nothing_of_the_next():
    slow = [estimates([1], 1.75, y, 0.0, -5.0) for y in np.arange(125.0, 112.0, -0.25)]
    first, second = 260, 560  # 13 and 28 s after the start
    frames = [*slow, *later(first, 7, 105.0, 30.0)[len(slow) :]]
    frames += later(second, 8, 105.0, 30.0)[len(frames) :]
    found = seen(frames)

    assert [crossing.track for crossing in found] == [1, 7, 8]
    assert [crossing.speed_mps for crossing in found[1:]] == pytest.approx([5.0, 15.0], abs=0.01)


def test_the_frame_of_a_crossing_is_the_newest_one_when_it_was():
    lost = leave(3, 60.0, 105.0)
    (crossing,) = seen([*lost, *[NOBODY] * 120], AWAY)

    assert abs(START_US + crossing.frame * FRAME_US - crossing.time_us) <= 2_100_000
    assert crossing.frame > len(lost)
    assert crossing.time_us % 1000 == 0
