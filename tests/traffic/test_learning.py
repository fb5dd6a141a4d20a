from __future__ import annotations

import numpy as np
import pytest

from service.traffic.curves import at, beside, headings
from service.traffic.learning import LearningParameters
from service.traffic.learning import learn as learn_in_steps
from service.traffic.steps import at_once
from tests.traffic.roads import arc, drive, evidence_of, s_curve, straight

SPACING_M = 3.5
P = LearningParameters()


def learn(evidence, parameters):
    return at_once(learn_in_steps(evidence, parameters))


ROADS = {
    "straight": (straight(), (-3.5, 0.0, 3.5), ()),
    "two ways": (straight(), (3.5, 7.0), (-3.5, -7.0)),
    "curve": (arc(220), (-3.5, 0.0, 3.5), ()),
    "s-curve": (s_curve(180), (-3.5, 0.0, 3.5), ()),
    "turned by 20 degrees": (straight(20), (-3.5, 0.0, 3.5), ()),
}


def traffic(road, count, rng, *, sigma_m=0.4):
    """`count` vehicles over all lanes of a road; those of the second group drive the other way."""
    middle, forth, back = ROADS[road]
    lanes = [(d, False) for d in forth] + [(d, True) for d in back]
    return [
        drive(k + 1, middle, d, rng, sigma_m=sigma_m, backwards=backwards)
        for k in range(count)
        for d, backwards in [lanes[k % len(lanes)]]
    ]


def offset_m(lanes, middle, right_m):
    """The mean distance of each true lane from the learned lane that is nearest to it, away from the ends."""
    out = []
    for d in right_m:
        true = at(middle, np.arange(10.0, 120.0, 5.0), np.full(22, d))
        fits = [beside(true, lane.points_m) for lane in lanes]
        out.append(min(float(np.abs(fit.right_m).mean()) for fit in fits))
    return out


@pytest.mark.parametrize("road", ROADS)
def test_every_lane_is_found_where_it_is_and_none_is_invented(road, rng):
    middle, forth, back = ROADS[road]

    lanes = learn(evidence_of(traffic(road, 60, rng)), P)

    assert len(lanes) == len(forth) + len(back)
    assert max(offset_m(lanes, middle, forth + back)) < 0.25
    assert all(abs(np.mean(lane.width_m) - SPACING_M) < 0.4 for lane in lanes)


@pytest.mark.parametrize("road", ROADS)
def test_lanes_point_where_their_vehicles_go(road, rng):
    middle, _, _ = ROADS[road]

    lanes = learn(evidence_of(traffic(road, 60, rng)), P)

    for lane in lanes:
        place = beside(lane.points_m, middle)
        ahead = np.cos(headings(lane.points_m) - place.heading_rad)
        # on these roads who drives back drives to the left of the middle
        back = road == "two ways" and place.right_m.mean() < 0
        assert np.all(ahead < -0.9 if back else ahead > 0.9)


def test_turning_the_scene_turns_the_map(rng):
    paths = traffic("straight", 60, rng)
    turned = straight(20)
    seed = np.random.default_rng(7)
    upright = learn(evidence_of([drive(k, straight(), d, seed) for k in range(1, 31) for d in (0.0, 3.5)]), P)
    seed = np.random.default_rng(7)
    aslant = learn(evidence_of([drive(k, turned, d, seed) for k in range(1, 31) for d in (0.0, 3.5)]), P)

    angle = np.radians(20)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    assert len(paths) == 60
    assert len(upright) == len(aslant) == 2
    for one, other in zip(upright, aslant, strict=True):
        # the windows along the course begin elsewhere, so the lines agree to centimetres, not to the bit
        assert np.abs(beside(one.points_m @ turn, other.points_m).right_m).max() < 0.15


def test_uneven_traffic_does_not_bend_the_course(rng):
    middle = straight()
    paths = [drive(k, middle, 0.0, rng) for k in range(1, 41)] + [
        drive(k, middle, 7.0, rng) for k in range(41, 49)
    ]

    lanes = learn(evidence_of(paths), P)

    assert len(lanes) == 2
    assert max(offset_m(lanes, middle, (0.0, 7.0))) < 0.25


def test_lane_changers_leave_the_lanes_where_they_are(rng):
    middle, forth, _ = ROADS["straight"]
    paths = traffic("straight", 80, rng)
    across = np.linspace(0, 1, len(middle))
    ramp = np.clip((across - 0.4) / 0.3, 0, 1)
    paths += [drive(100 + k, middle, 3.5 * ramp - 3.5 * (k % 2), rng) for k in range(20)]

    lanes = learn(evidence_of(paths), P)

    assert len(lanes) == 3
    assert max(offset_m(lanes, middle, forth)) < 0.25


def test_a_lane_that_joins_ends_where_it_joins(rng):
    middle = straight()
    s = np.linspace(0, 130, len(middle))
    joining = np.interp(s, [0, 50, 90], [3.5, 3.5, 0.0])
    paths = [drive(k, middle, (-3.5, 0.0)[k % 2], rng) for k in range(1, 41)]
    paths += [drive(k, middle, joining, rng) for k in range(41, 61)]

    lanes = learn(evidence_of(paths), P)

    counts = []
    for at_m in (20.0, 40.0, 110.0):
        points = at(middle, np.full(3, at_m), np.array([-3.5, 0.0, 3.5]))
        near = [beside(points, lane.points_m) for lane in lanes]
        counts.append(
            [any(bool(f.beyond[k] == 0 and abs(f.right_m[k]) < 1.0) for f in near) for k in range(3)]
        )
    assert counts == [[True, True, True], [True, True, True], [True, True, False]]


def test_a_junction_is_cut_into_what_comes_before_the_way_through_and_what_goes_on(rng):
    north, east = straight(), np.column_stack([np.arange(-60.0, 61.0, 2.0), np.full(61, 85.0)])
    paths = [drive(k, north, (1.7, 5.2)[k % 2], rng) for k in range(1, 31)]
    paths += [drive(k, east, 1.7, rng) for k in range(31, 51)]

    lanes = learn(evidence_of(paths), P)

    straight_on = [lane for lane in lanes if abs(np.cos(headings(lane.points_m).mean())) > 0.9]
    across = [lane for lane in lanes if abs(np.cos(headings(lane.points_m).mean())) < 0.1]
    assert [lane.turn for lane in straight_on].count(False) == 4
    assert [lane.turn for lane in across].count(False) == 2
    before = [lane for lane in straight_on if not lane.turn and lane.points_m[0, 1] < 40]
    assert all(60 < lane.points_m[-1, 1] < 83 for lane in before)


def test_a_few_ghosts_make_no_lane(rng):
    middle, _, _ = ROADS["straight"]
    ghosts = [drive(200 + k, middle, 12.0, rng, sigma_m=1.0) for k in range(2)]

    lanes = learn(evidence_of(traffic("straight", 60, rng) + ghosts), P)

    assert len(lanes) == 3


def test_no_paths_no_lanes():
    assert learn(evidence_of([]), P) == []
