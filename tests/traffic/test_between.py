"""Crossings that nobody saw, far behind the line: the order of the lane tells when they were."""

from __future__ import annotations

import numpy as np
import pytest

from tests.traffic.test_crossings import NOBODY, drive, merged
from tests.traffic.test_unseen import STEP_M, seen
from tests.traffic.tracks import FRAME_US, START_US

FRAMES = 260


def convoy(*vehicles, others=()):
    """Vehicles at 15 m/s: number, place in the first frame, and between which places each is seen."""
    listed, born_us = [[NOBODY] * FRAMES, *others], {}
    for number, first_m, *between in vehicles:
        most_m, least_m = between or (1e3, -1e3)
        y = first_m - STEP_M * np.arange(FRAMES)
        frames = drive(number, y, x_m=1.75, vy_mps=-15.0)
        shown = (y <= most_m) & (y >= least_m)
        born_us[number] = START_US + int(np.argmax(shown)) * FRAME_US
        listed.append([now if here else None for now, here in zip(frames, shown, strict=True)])
    frames = merged(*listed)
    for now in frames:
        now.born_us[:] = [born_us.get(number, START_US) for number in now.number.tolist()]
    return frames


def crossed(*vehicles):
    """Return when each vehicle crossed the line at 120 m, in seconds."""
    return {x.track: (x.time_us - START_US) / 1e6 for x in seen(convoy(*vehicles))}


LEADER, FOLLOWER = (1, 142.0), (3, 158.0)
HIDDEN = (7, 150.0, 59.0, 0.0)  # until it is 61 m behind the line, more than four seconds


def test_who_drives_between_two_that_crossed_did_so_between_them():
    assert crossed(LEADER, FOLLOWER, HIDDEN) == {
        1: pytest.approx(22 / 15, abs=0.01),
        7: pytest.approx(30 / 15, abs=0.05),
        3: pytest.approx(38 / 15, abs=0.01),
    }


def test_who_was_counted_there_as_another_track_is_not_counted_again():
    assert sorted(crossed(LEADER, FOLLOWER, (5, 150.0, 150.0, 95.0), HIDDEN)) == [1, 3, 5]


def test_of_two_that_were_hidden_each_is_counted():
    assert sorted(crossed(LEADER, HIDDEN, (8, 158.0, 59.0, 0.0), (3, 166.0))) == [1, 3, 7, 8]


def test_a_follower_that_is_still_before_the_line_crosses_it_after_it():
    found = crossed(LEADER, (3, 235.0), HIDDEN)

    assert sorted(found) == [1, 3, 7]
    assert found[1] < found[7] < found[3]


def test_one_that_waits_just_behind_the_line_has_crossed_it():
    # 5 was counted, lost and is seen again as 7; 9 has stepped over the line and waits there
    y = np.maximum(150.0 - STEP_M * np.arange(FRAMES), 119.5)
    waits = drive(9, y, x_m=1.75, vy_mps=-0.1)
    frames = convoy(LEADER, (5, 150.0, 150.0, 95.0), HIDDEN, (3, 235.0), others=[waits])

    assert [x.track for x in seen(frames)].count(7) == 0


def test_without_one_ahead_and_one_behind_nobody_can_say():
    assert sorted(crossed(LEADER, HIDDEN)) == [1]
    assert sorted(crossed(FOLLOWER, HIDDEN)) == [3]


def test_those_of_another_lane_tell_nothing():
    beside = [
        drive(n, y - STEP_M * np.arange(FRAMES), x_m=-1.75, vy_mps=-15.0) for n, y in (LEADER, FOLLOWER)
    ]

    frames = convoy(HIDDEN, others=beside)

    assert sorted(x.track for x in seen(frames)) == [1, 3]


def test_who_was_counted_and_still_seen_when_it_was_first_seen_is_another():
    others = (5, 146.0, 146.0, 35.0), (7, 150.5, 59.0, 0.0)  # both are seen for a moment

    assert sorted(crossed(LEADER, FOLLOWER, *others)) == [1, 3, 5, 7]

    shorter = (5, 146.0, 146.0, 51.5), (7, 150.5, 59.0, 0.0)  # for 0.2 s: it may be the second track of one
    assert sorted(crossed(LEADER, FOLLOWER, *shorter)) == [1, 3, 5]


def test_it_is_less_sure_than_one_whose_speed_tells():
    (crossing,) = [x for x in seen(convoy(LEADER, FOLLOWER, HIDDEN)) if x.track == 7]

    assert crossing.probability == pytest.approx(0.99 * 0.75, abs=1e-3)
