from __future__ import annotations

import numpy as np
import pytest

from service.traffic import mapping as lane_mapping
from service.traffic.curves import along, beside
from service.traffic.evidence import EvidenceParameters, add, no_evidence
from service.traffic.identity import IdentityParameters, gone_with, named
from service.traffic.learning import Learned
from service.traffic.mapping import Given
from service.traffic.model import MOST_LANES, Moment
from service.traffic.parameters import TrafficParameters
from service.traffic.steps import at_once
from tests.traffic.roads import drive, straight

P = IdentityParameters()


def found(x_m, start_m, end_m, *, confidence=0.9, turn=False):
    """A lane along y at `x_m`, in driving direction."""
    y_m = np.linspace(start_m, end_m, max(round(abs(end_m - start_m) / 4), 1) + 1)
    return Learned(
        np.column_stack([np.full(len(y_m), x_m), y_m]), np.full(len(y_m), 3.5), confidence, 20, turn
    )


class Maps:
    """Maps that come one after another, with what is remembered between them."""

    def __init__(self) -> None:
        self.lanes, self.gone = (), ()

    def come(self, *lanes):
        """Put a map into force; return the numbers of its lanes in the order given."""
        now = at_once(named(lanes, self.lanes, self.gone, P))
        self.gone, self.lanes = gone_with(self.gone, self.lanes, now), now
        by_place = {lane.points_m.tobytes(): lane.index for lane in now}
        assert len({lane.index for lane in now}) == len(now)
        return [by_place.get(lane.points_m.tobytes()) for lane in lanes]


@pytest.fixture
def maps():
    return Maps()


def test_a_lane_that_grows_and_moves_a_little_keeps_its_number(maps):
    assert maps.come(found(0.0, 40, 80), found(3.5, 40, 80)) == [1, 2]
    assert maps.come(found(3.9, 20, 140), found(0.3, 20, 140)) == [2, 1]


def test_a_lane_that_is_cut_keeps_its_number_on_the_longest_part(maps):
    maps.come(found(0.0, 0, 150), found(3.5, 0, 150))

    parts = maps.come(
        found(0.0, 0, 50), found(0.0, 50, 75, turn=True), found(0.0, 75, 150), found(3.5, 0, 150)
    )

    assert parts == [3, 4, 1, 2]


def test_no_number_is_given_to_another_lane_when_its_own_has_gone(maps):
    maps.come(found(0.0, 0, 100), found(3.5, 0, 100), found(7.0, 0, 100))
    maps.come(found(0.0, 0, 100))

    assert maps.come(found(0.0, 0, 100), found(14.0, 0, 100)) == [1, 4]


def test_a_lane_that_comes_back_takes_its_own_number_again(maps):
    maps.come(found(0.0, 0, 100), found(3.5, 0, 100))
    maps.come(found(0.0, 0, 100))

    assert maps.come(found(0.0, 0, 100), found(10.5, 0, 100), found(3.5, 10, 90)) == [1, 3, 2]


@pytest.mark.parametrize(
    "other",
    [found(0.0, 100, 0), found(3.5, 0, 100), found(0.0, 60, 160)],
    ids=["against it", "beside it", "behind it"],
)
def test_a_lane_that_is_not_the_same_gets_a_new_number(maps, other):
    maps.come(found(0.0, 0, 100))

    assert maps.come(other) == [2]


def test_a_lane_that_crosses_is_not_the_same(maps):
    maps.come(found(0.0, 0, 100))
    across = Learned(
        np.column_stack([np.linspace(-20.0, 20.0, 11), np.full(11, 50.0)]), np.full(11, 3.5), 0.9, 20
    )

    assert maps.come(across) == [2]


def test_a_new_lane_must_be_sure_and_a_known_one_less_so(maps):
    maps.come(found(0.0, 0, 100))

    assert maps.come(found(0.0, 0, 100, confidence=0.45), found(3.5, 0, 100, confidence=0.45)) == [1, None]
    # ... and one that was not told of took no number
    assert maps.come(found(0.0, 0, 100), found(3.5, 0, 100)) == [1, 2]


def test_when_all_numbers_are_used_that_of_the_lane_that_left_first_is_given_again(maps):
    for k in range(MOST_LANES):
        assert maps.come(found(10.0 * k, 0, 40)) == [k + 1]

    assert maps.come(found(-10.0, 0, 40)) == [1]
    assert maps.come(found(-20.0, 0, 40), found(-10.0, 0, 40)) == [2, 1]


def test_numbers_outlast_an_epoch_and_lanes_of_a_user():
    learned = at_once(named([found(0.0, 0, 100), found(3.5, 0, 100)], (), (), P))
    p = TrafficParameters()
    state = lane_mapping.begin(lane_mapping.no_mapping(), moment(1), Given(learned[1:], 7), p, "")
    state = lane_mapping.begun_anew(state)
    state = lane_mapping.begin(state, moment(2), Given(learned[:1], 8), p, "")
    state = lane_mapping.begin(state, moment(3), Given(None, 0), p, "")

    lanes = at_once(named([found(14.0, 0, 100)], state.map.lanes, state.gone, P))

    assert [lane.index for lane in state.gone] == [2]
    assert [lane.index for lane in lanes] == [3]


def test_at_a_junction_whose_lanes_are_cut_while_it_is_learned_a_number_means_one_lane(rng):
    p = TrafficParameters()
    east = np.column_stack([np.arange(-70.0, 71.0, 2.0), np.full(71, 85.0)])
    paths = [drive(k, straight(), 3.5 * (k % 2), rng, sigma_m=0.2) for k in range(1, 25)]
    paths += [drive(k, east, 3.5 * (k % 2), rng, sigma_m=0.2) for k in range(25, 49)]
    evidence, lanes, gone, seen = no_evidence(), (), (), {}
    for k, path in enumerate(paths, start=1):
        evidence = add(evidence, path, EvidenceParameters())
        if k % 12 == 0:
            now = at_once(lane_mapping.lanes_in_steps(evidence, lanes, gone, p))
            lanes, gone = now, gone_with(gone, lanes, now)
            for lane in lanes:
                for other in seen.setdefault(lane.index, []):
                    assert shared(lane.points_m, other) > 0.7
                seen[lane.index].append(lane.points_m)

    assert len(seen) > 8  # the two lanes that led through were cut in three, and those across them, too
    assert len(seen) == max(seen)
    assert sum(len(maps) == 4 for maps in seen.values()) == 2  # the longest part of each of the first two


def shared(points_m, other_m):
    """Along which share of the shorter of two lines they lie upon one another."""
    place = beside(points_m, other_m)
    upon = (~place.beyond & (np.abs(place.right_m) < 1.4)).mean() * along(points_m)[-1]
    return upon / min(along(points_m)[-1], along(other_m)[-1])


def moment(frame):
    return Moment(frame * 50_000, frame, tick=False)
