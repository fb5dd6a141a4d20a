"""Vehicles that stand one behind another, seen from the side."""

from __future__ import annotations

import numpy as np
import pytest

from service.tracking import births, standing_rows
from service.tracking.births import BirthParameters
from service.tracking.boxes import POINT_COLUMNS, PX, PY
from service.tracking.row_direction import direction_across
from service.tracking.row_kernels import chains, part_row
from service.tracking.standing_rows import RowParameters
from tests.tracking.standing_points import FRAMES, end_on, points_of, turned

P = RowParameters()
ACROSS_RAD = np.pi / 2


def direction(points, *, driven=False, road_rad=0.0):
    x, y, times, _ = standing_rows.thin(points)
    road = np.full(len(x), road_rad)
    return direction_across(x, y, times, FRAMES, np.full(len(x), driven), road, P)


def stood(points, heading_rad=ACROSS_RAD):
    """Return the vehicles in rows of that heading, from left to right."""
    x, y, times, _ = standing_rows.thin(points)
    found, inside = standing_rows.stand(x, y, times, FRAMES, heading_rad, 4.4, P)
    return sorted(found, key=lambda f: (f.x_m, f.y_m)), times[inside].sum() / times.sum()


@pytest.mark.parametrize("seed", range(5))
def test_cars_two_metres_apart_are_two(seed):
    found, inside = stood(points_of((-23.0, 90.0, 4.4), (-16.6, 90.0, 4.4), seed=seed))

    assert [f.x_m for f in found] == pytest.approx([-23.0, -16.6], abs=0.9)
    assert [f.y_m for f in found] == pytest.approx([90.0, 90.0], abs=0.4)
    assert [f.length_m for f in found] == pytest.approx([4.4, 4.4], abs=1.2)
    assert [f.rate for f in found] == pytest.approx([4.0, 4.0], abs=0.9)
    assert inside > 0.95


@pytest.mark.parametrize("seed", range(5))
def test_a_bus_is_one(seed):
    found, _ = stood(points_of((20.0, 85.0, 12.0), seed=seed))

    assert len(found) == 1
    assert (found[0].x_m, found[0].y_m) == pytest.approx((20.0, 85.0), abs=0.6)
    assert found[0].length_m == pytest.approx(12.0, abs=1.4)


@pytest.mark.parametrize(("y_m", "lengths_m"), [(100.0, [4.4, 4.4]), (60.0, [11.2])])
def test_echoes_between_two_are_a_gap_only_where_azimuth_blurs_it(y_m, lengths_m):
    between = points_of((0.0, y_m, 2.0), rate=5.0, noise_m=0.0)  # half as many as beside it
    beside = points_of((-3.2, y_m, 4.4), (3.2, y_m, 4.4), rate=10.0, noise_m=0.05)

    found, _ = stood(np.concatenate([beside, between]))

    assert [f.length_m for f in found] == pytest.approx(lengths_m, abs=0.9)


def test_rows_of_two_lanes_are_kept_apart():
    found, _ = stood(points_of((12.0, 81.5, 4.4), (12.2, 85.0, 4.4), (18.6, 85.0, 4.4)))

    places = sorted(((f.y_m, f.x_m) for f in found), key=lambda place: (round(place[0] / 3.5), place[1]))
    assert [x for _, x in places] == pytest.approx([12.0, 12.2, 18.6], abs=0.9)
    assert [y for y, _ in places] == pytest.approx([81.5, 85.0, 85.0], abs=0.4)


def test_the_far_side_of_a_truck_is_no_row_of_its_own():
    near, far = points_of((20.0, 84.0, 12.0)), points_of((20.0, 86.2, 12.0), rate=2.0, seed=8)

    found, _ = stood(np.concatenate([near, far]))

    assert [f.y_m for f in found] == pytest.approx([84.0], abs=0.5)


@pytest.mark.parametrize("angle_rad", [-0.4, 0.0, 0.3])
def test_the_direction_of_rows_is_found(angle_rad):
    points = turned(points_of((-6.4, 90.0, 4.4), (0.0, 90.0, 4.4), (6.4, 90.0, 4.4)), angle_rad)

    heading = direction(points)

    assert heading == pytest.approx(ACROSS_RAD + angle_rad, abs=0.08)


def test_a_queue_seen_end_on_has_no_rows_across():
    queue = end_on(points_of((-6.4, 78.0, 4.4), (0.0, 78.0, 4.4), (6.4, 78.0, 4.4)))

    assert direction(queue) is None


def test_vehicles_abreast_are_no_row():
    abreast = end_on(points_of((-20.0, 76.6, 4.4), (-20.0, 80.0, 4.4), (-20.0, 83.4, 4.4), rate=6.0))

    assert direction(abreast) is None


@pytest.mark.parametrize(("road_rad", "heading"), [(0.1, None), (ACROSS_RAD + 0.2, ACROSS_RAD + 0.2)])
def test_on_a_driven_road_its_direction_tells(road_rad, heading):
    points = points_of((-6.4, 90.0, 4.4), (0.0, 90.0, 4.4))

    assert direction(points, driven=True, road_rad=road_rad) == heading


def test_too_few_points_are_nobody():
    found, inside = stood(points_of((0.0, 90.0, 4.4), rate=0.2))

    assert (found, inside) == ([], 0.0)


def parted(*pieces):
    """Return how a row of evenly spread points in these pieces (begin, end, points a metre) is parted."""
    u = np.concatenate([np.arange(a, b, 1.0 / rate) for a, b, rate in pieces])
    limits = (P.bin_m, P.gap_m, P.leak, float(P.vehicle_points), P.vehicle_nats, P.bin_told, P.shape)
    return part_row(u, np.ones(len(u)), limits)


def test_a_row_is_parted_at_a_gap_that_leaks():
    row = parted((0.0, 4.5, 20.0), (4.5, 6.5, 2.0), (6.5, 11.0, 20.0))

    assert row[:, :2].ravel() == pytest.approx([0.0, 4.5, 6.5, 11.0], abs=0.5)
    assert row[:, 2] == pytest.approx([90.0, 90.0], abs=8.0)


def test_a_row_is_not_parted_where_fewer_points_lie_for_less_than_a_gap():
    assert len(parted((0.0, 5.5, 20.0), (5.5, 6.2, 4.0), (6.2, 12.0, 20.0))) == 1


def born(points, *, driven=False):
    n = len(points)
    way = births.Way(np.full(n, driven), np.full(n, ACROSS_RAD), np.zeros(n, np.bool_))
    rows = births.standing_births(points, FRAMES, way, BirthParameters())
    return births.gather(rows)


def test_each_car_of_a_row_starts_a_track():
    new = born(points_of((-29.4, 90.0, 4.4), (-23.0, 90.0, 4.4), (-16.6, 90.0, 4.4)))

    assert sorted(new.x_m) == pytest.approx([-29.4, -23.0, -16.6], abs=0.9)
    assert np.abs(np.sin(new.heading_rad)) == pytest.approx([1.0, 1.0, 1.0], abs=0.01)
    assert new.standing.all()
    assert (new.heading_var > 0.0625).all()  # either way round: the first metres may turn it over


def test_a_road_that_is_driven_tells_the_way():
    new = born(points_of((-23.0, 90.0, 4.4), (-16.6, 90.0, 4.4), rate=1.2), driven=True)

    assert new.heading_rad == pytest.approx([ACROSS_RAD, ACROSS_RAD])
    assert new.heading_var == pytest.approx([0.15**2, 0.15**2])


def test_a_row_of_posts_starts_nothing():
    rng, places = np.random.default_rng(2), []
    for x in np.arange(-20.0, 20.0, 4.0):
        places += [(x + rng.normal(0.0, 0.4), 90.0 + rng.normal(0.0, 0.1)) for _ in range(FRAMES)]
    points = np.zeros((len(places), POINT_COLUMNS))
    points[:, [PX, PY]] = places

    assert len(born(points)) == 0


def test_a_crowd_of_rows_starts_no_more_tracks_than_a_frame_may():
    rows = [(x, y, 4.4) for y in (60.0, 64.0, 68.0, 72.0) for x in (-12.8, -6.4, 0.0, 6.4, 12.8)]

    assert len(born(points_of(*rows, noise_m=0.1))) == births.MAX_STANDING_BOXES


def test_a_side_that_is_less_deep_than_its_face_finds_nobody_and_ends():
    x, y, times, _ = standing_rows.thin(points_of((0.0, 90.0, 4.4)))
    shallow = RowParameters(depth_m=0.0, before_m=0.0)

    found, inside = standing_rows.stand(x, y, times, FRAMES, ACROSS_RAD, 4.4, shallow)

    assert found == []
    assert not inside.any()


def test_chains_are_those_of_their_definition():
    rng = np.random.default_rng(6)
    x, y = rng.uniform(-20.0, 20.0, (2, 150))

    group = chains(x, y, 2.5)

    near = np.hypot(x[:, None] - x, y[:, None] - y) < 2.5
    reached = near.copy()
    while (more := (reached.astype(int) @ near) > 0).sum() > reached.sum():
        reached = more
    np.testing.assert_array_equal(group, reached.argmax(axis=1))  # the first place of each chain
    assert len(np.unique(group)) > 5
    assert len(chains(x[:0], y[:0], 2.5)) == 0
