"""Vehicles that stand in lanes beside one another, seen end-on."""

from __future__ import annotations

import numpy as np
import pytest

from service.tracking import births
from service.tracking.births import BirthParameters
from service.tracking.boxes import POINT_COLUMNS, PX, PY
from service.tracking.end_on_rows import lanes_end_on
from service.tracking.row_direction import direction_across
from service.tracking.standing_rows import RowParameters, thin
from tests.tracking.standing_points import FRAMES, queue_of, turned

P = RowParameters()
QUEUE = [(x, y, 4.4) for x in (-4.8, -1.3, 2.2) for y in (30.0, 36.5, 43.0, 49.5)]
SIDEWAYS = [(x, y + 2.0 * (x < -2.0), length) for x, y, length in QUEUE]  # lanes not in step


def stood(points, *, driven=False, road_rad=0.0):
    x, y, times, _ = thin(points)
    road = np.full(len(x), road_rad)
    found = lanes_end_on(x, y, times, FRAMES, np.full(len(x), driven), road, 4.4, P)
    inside = sum((places for _, places in found), np.zeros(len(x), np.bool_))
    return [f for f, _ in found if f.rate >= 2.0], inside  # the rest are stray points beside the lanes


def direction(points):
    x, y, times, _ = thin(points)
    return direction_across(x, y, times, FRAMES, np.zeros(len(x), np.bool_), np.zeros(len(x)), P)


def born(points, *, driven=False):
    n = len(points)
    way = births.Way(np.full(n, driven), np.zeros(n), np.zeros(n, np.bool_))
    rows = births.standing_births(points, FRAMES, way, BirthParameters())
    return births.gather(rows)


def apart_m(found, vehicles):
    """Return how far each vehicle is from the nearest found."""
    return [min(np.hypot(f.x_m - x, f.y_m - y) for f in found) for x, y, _ in vehicles]


@pytest.mark.parametrize("queue", [QUEUE, SIDEWAYS])
@pytest.mark.parametrize("seed", range(4))
def test_each_car_of_a_queue_in_three_lanes_is_found(queue, seed):
    found, inside = stood(queue_of(*queue, seed=seed))

    assert len(found) == len(queue)
    assert max(apart_m(found, queue)) < 0.7
    assert [f.length_m for f in found] == pytest.approx([4.4] * len(queue), abs=1.1)
    assert inside.mean() > 0.9


def test_a_bus_is_one_and_as_long():
    found, _ = stood(queue_of((-1.3, 40.0, 4.4), (-1.3, 50.4, 12.0), (-1.3, 60.8, 4.4), (2.2, 45.0, 4.4)))

    assert len(found) == 4
    bus = max(found, key=lambda f: f.length_m)
    assert (bus.x_m, bus.y_m, bus.length_m) == pytest.approx((-1.3, 50.4, 12.0), abs=0.8)


def test_lanes_may_bend():
    radius_m = 250.0
    bend = []
    for lane_m in (-3.5, 0.0):
        for way_m in np.arange(30.0, 100.0, 7.0):
            r = radius_m - lane_m
            bend.append((radius_m - r * np.cos(way_m / radius_m), r * np.sin(way_m / radius_m), 4.4))

    found, _ = stood(queue_of(*bend, azimuth_std_rad=0.003))

    near = np.array(apart_m(found, bend))
    assert len(found) == len(bend)
    assert (near < 0.8).all()


def test_unknown_lanes_face_the_radar_and_driven_ones_lead_as_they_are_driven():
    queue = queue_of(*QUEUE)

    facing, _ = stood(queue)
    driven, _ = stood(queue, driven=True, road_rad=0.02)

    assert np.cos([f.heading_rad for f in facing]) == pytest.approx([-1.0] * len(QUEUE), abs=0.02)
    assert [f.heading_rad for f in driven] == pytest.approx([0.02] * len(QUEUE))
    assert max(apart_m(driven, QUEUE)) < 0.7


@pytest.mark.parametrize("angle_rad", [-0.2, 0.0, 0.3])
def test_a_queue_in_lanes_has_no_rows_across(angle_rad):
    assert direction(turned(queue_of(*QUEUE), angle_rad)) is None


def test_each_car_of_a_queue_starts_a_track():
    two_lanes = [v for v in QUEUE if v[0] < 0.0]

    new = born(queue_of(*two_lanes))

    assert len(new) == len(two_lanes)
    assert new.standing.all()
    assert np.cos(new.heading_rad) == pytest.approx([-1.0] * len(two_lanes), abs=0.02)


def posts(rng, *places):
    rows = [(x + rng.normal(0.0, 0.2), y + rng.normal(0.0, 0.05)) for x, y in places for _ in range(FRAMES)]
    points = np.zeros((len(rows), POINT_COLUMNS))
    points[:, [PX, PY]] = rows
    return points


def test_posts_of_a_rail_with_a_pole_are_no_vehicle():
    rail = posts(np.random.default_rng(4), *((6.0, y) for y in np.arange(20.0, 60.0, 4.0)), (6.8, 41.0))

    found, _ = stood(rail)

    assert found == []
    assert len(born(rail)) == 0


def test_too_few_points_are_nobody():
    found, inside = stood(queue_of((0.0, 60.0, 4.4), rate=0.2))

    assert found == []
    assert not inside.any()


@pytest.mark.parametrize("depth_m", [0.5, 2.0])
def test_a_car_of_which_only_the_face_is_seen_is_found_behind_others_and_alone(depth_m):
    faces = [(-1.3, 43.0 + 0.5 * depth_m - 2.2, depth_m), (2.2, 49.5 + 0.5 * depth_m - 2.2, depth_m)]
    row = queue_of((-1.3, 30.0, 4.4), (2.2, 36.5, 4.4))
    face = queue_of(*faces, rate=5.0 * 4.4 / depth_m, seed=5)

    behind, _ = stood(np.concatenate([row, face]))
    alone, _ = stood(face[face[:, PX] < 0.5], driven=True, road_rad=np.pi)

    assert max(apart_m(behind, [(-1.3, 43.0, 4.4), (2.2, 49.5, 4.4)])) < 0.9
    assert max(apart_m(alone, [(-1.3, 43.0, 4.4)])) < 0.9


def test_each_carriageway_of_a_road_leads_its_own_way():
    places = [(-1.7, 30.0, 4.4), (-1.7, 37.0, 4.4), (1.7, 30.0, 4.4), (1.7, 37.0, 4.4)]
    x, y, times, _ = thin(queue_of(*places))
    road = np.where(x < 0.0, np.pi, 0.0)

    found = lanes_end_on(x, y, times, FRAMES, np.full(len(x), True), road, 4.4, P)

    way = {round(f.x_m): np.cos(f.heading_rad) for f, _ in found if f.rate >= 2.0}
    assert way == {-2: pytest.approx(-1.0), 2: pytest.approx(1.0)}


def test_a_car_alone_makes_no_lane_of_an_unknown_road():
    car = queue_of((-1.3, 43.0, 4.4))

    assert stood(car)[0] == []
    assert len(born(car)) == 1


def test_a_road_that_leads_across_is_no_lane():
    assert stood(queue_of((-1.3, 43.0, 4.4)), driven=True, road_rad=0.5 * np.pi)[0] == []


def test_the_middle_of_a_car_is_midway_between_its_sides_though_one_is_seen_better():
    cars = [(-6.0, 30.0, 4.4), (-6.0, 37.0, 4.4)]
    points = queue_of(*cars, rate=12.0, azimuth_std_rad=0.001)
    weak = points[:, PX] < -6.0
    weak &= np.arange(len(points)) % 5 > 0  # of the side away from the radar one point in five

    found, _ = stood(points[~weak])

    assert [f.x_m for f in found] == pytest.approx([-6.0, -6.0], abs=0.25)


def test_nobody_is_found_where_there_is_nothing():
    none = np.zeros(0)

    assert lanes_end_on(none, none, none, FRAMES, none > 0.0, none, 4.4, P) == []
