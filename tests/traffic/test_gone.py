"""Crossings that nobody saw, far before the line: who drove behind the vehicle tells that it was there."""

from __future__ import annotations

import numpy as np
import pytest

from service.traffic.model import LaneMap
from tests.traffic.test_crossing_lanes import lane
from tests.traffic.test_crossings import NOBODY, drive, merged
from tests.traffic.test_unseen import STEP_M, seen
from tests.traffic.tracks import FRAME_US, START_US

FRAMES, SILENT = 260, 10  # frames without a measurement after which a vehicle is lost
AWAY = LaneMap(1, START_US, 1, 40, "learned", (lane(1, 1.75, backwards=True), lane(2, -1.75, backwards=True)))


def convoy(*vehicles, x_m=1.75, speed_mps=15.0):
    """Vehicles that leave: number, place in the first frame, and between which places each is seen."""
    listed = [[NOBODY] * round(FRAMES * 15.0 / speed_mps)]
    for number, first_m, *between in vehicles:
        from_m, to_m = between or (-1e3, 1e3)
        y = first_m + speed_mps * FRAME_US / 1e6 * np.arange(len(listed[0]))
        frames = drive(number, y, x_m=x_m, vy_mps=speed_mps)
        shown = (y >= from_m) & (y <= to_m)
        listed.append([now if here else None for now, here in zip(frames, shown, strict=True)])
    return merged(*listed)


def crossed(*vehicles, **changes):
    """Return when each vehicle crossed the line at 120 m, in seconds."""
    found = seen(convoy(*vehicles, **changes), AWAY)
    return {x.track: (x.time_us - START_US) / 1e6 for x in found}


LEADER, FOLLOWER = (1, 18.0), (3, 0.0)
HIDDEN = (2, 10.0, 0.0, 55.0)  # until it is 65 m before the line, more than four seconds


def test_who_was_lost_ahead_of_one_that_crossed_did_so_before_it():
    assert crossed(LEADER, HIDDEN, FOLLOWER) == {
        1: pytest.approx(102 / 15, abs=0.01),
        2: pytest.approx(110 / 15, abs=0.05),
        3: pytest.approx(120 / 15, abs=0.01),
    }


def test_without_a_leader_its_way_to_the_line_took_as_long_as_its_followers():
    assert crossed(HIDDEN, FOLLOWER)[2] == pytest.approx(110 / 15, abs=0.05)


def test_without_a_follower_nobody_can_say():
    assert sorted(crossed(LEADER, HIDDEN)) == [1]
    beside = convoy(FOLLOWER, x_m=-1.75)
    assert sorted(x.track for x in seen(merged(convoy(LEADER, HIDDEN), beside), AWAY)) == [1, 3]


def test_one_that_was_found_again_is_not_counted_twice():
    # after more than the three seconds over which pieces are joined
    assert sorted(crossed(LEADER, HIDDEN, (7, 10.0, 103.0, 200.0), FOLLOWER)) == [1, 3, 7]
    back = convoy(LEADER, FOLLOWER), convoy(HIDDEN), convoy((2, 10.0, 103.0, 200.0))  # under its number
    assert sorted(x.track for x in seen(merged(*back), AWAY)) == [1, 2, 3]


def test_each_of_two_that_were_lost_is_counted_unless_they_may_be_one():
    at_once = (2, 18.0, 0.0, 60.0), (4, 10.0, 0.0, 50.0)
    assert sorted(crossed((1, 26.0), *at_once, FOLLOWER)) == [1, 2, 3, 4]

    # the second is first seen, 9 m farther back, after the first was lost: too far to be stitched
    one_by_one = (2, 12.0, 0.0, 26.0), (4, 3.0, 18.0, 32.0)
    assert len(crossed((1, 26.0), *one_by_one, (3, -6.0), speed_mps=5.0)) == 3


def test_a_second_track_of_a_vehicle_that_ends_is_nobody():
    assert sorted(crossed(LEADER, (2, 16.0, 0.0, 55.0), FOLLOWER)) == [1, 3]

    first, second, last = convoy(LEADER), convoy((2, 16.0, 0.0, 55.0)), convoy(FOLLOWER)
    silent = round(39.0 / STEP_M) + SILENT  # when the second is taken for lost, the first is not measured
    first[silent] = None
    assert sorted(x.track for x in seen(merged(first, second, last), AWAY)) == [1, 3]


def test_one_that_is_seen_again_and_turns_off_has_not_crossed():
    turns = convoy((2, 10.0, 66.0, 80.0))
    for k, now in enumerate(turns):
        now.x_m[:] += 0.4 * max(0.0, k - 75)  # off the road, while it is seen

    frames = merged(convoy(LEADER, HIDDEN, FOLLOWER), turns)

    assert sorted(x.track for x in seen(frames, AWAY)) == [1, 3]


def test_a_follower_that_overtakes_in_another_lane_does_not_tell_yet():
    beside = convoy((4, 4.0), x_m=-1.75)
    changes = convoy((4, 4.0))[:75] + beside[75:]

    frames = merged(convoy((1, 26.0), (2, 14.0, 0.0, 55.0), (3, -6.0)), changes)

    assert sorted(x.track for x in seen(frames, AWAY)) == [1, 2, 3, 4]


def test_one_that_was_seen_at_the_same_time_is_another():
    """It came from the next lane behind the place where the first one was lost."""
    crosses = [drive(9, 20.0 + 0.75 * np.arange(FRAMES), x_m=x, vy_mps=15.0) for x in (-1.75, 1.75)]
    changes = crosses[0][:75] + crosses[1][75:]

    frames = merged(convoy((1, 30.0), (2, 12.0, 0.0, 55.0), FOLLOWER), changes)

    assert sorted(x.track for x in seen(frames, AWAY)) == [1, 2, 3, 9]


def test_one_that_still_drives_before_the_line_has_not_crossed_it():
    """It was overtaken: silent for a while, it is seen again behind its follower."""
    frames = merged(convoy(LEADER, HIDDEN, FOLLOWER), convoy((2, -20.0, 60.0, 200.0)))

    (crossing,) = [x for x in seen(frames, AWAY) if x.track == 2]

    assert (crossing.time_us - START_US) / 1e6 == pytest.approx(140 / 15, abs=0.01)


def test_it_is_less_sure_than_one_that_was_seen():
    found = {x.track: x.probability for x in seen(convoy(LEADER, HIDDEN, FOLLOWER), AWAY)}

    assert found[2] == pytest.approx(0.9)
    assert found[2] < found[1]
