"""The kernels that hold points against boxes, against numpy written from their definitions."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from service.tracking import boxes as b
from service.tracking.assigning import doppler_noise
from service.tracking.merging import MergingParameters, find_pairs, merge
from service.tracking.model import TrackStatus
from service.tracking.parameters import TrackerParameters
from service.tracking.state import Tracks, no_tracks

GATE, CLUSTER_GATE = 12.0, 25.0


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def crowd(rng, vehicles=12, points=90):
    """Return boxes in a small place and points in and around them."""
    box = np.zeros((vehicles, b.BOX_COLUMNS))
    box[:, b.BX], box[:, b.BY] = rng.uniform(-8, 8, vehicles), rng.uniform(40, 80, vehicles)
    heading = rng.uniform(-np.pi, np.pi, vehicles)
    box[:, b.BSIN], box[:, b.BCOS] = np.sin(heading), np.cos(heading)
    speed = rng.uniform(0, 25, vehicles)
    box[:, b.BVX], box[:, b.BVY], box[:, b.BSPEED] = speed * np.sin(heading), speed * np.cos(heading), speed
    box[:, b.BLEN], box[:, b.BWID] = rng.uniform(3, 18, vehicles), rng.uniform(0.9, 2.5, vehicles)
    box[:, [b.BVAR_U, b.BVAR_W, b.BVAR_V]] = rng.uniform(0.01, 1.5, (vehicles, 3))
    box[:, b.BGROW_FAR] = rng.uniform(0, 5, vehicles)
    box[:, b.BGROW_NEAR] = 0.2 * box[:, b.BGROW_FAR]
    box[:, b.BPRIOR] = rng.uniform(0, 6, vehicles)
    point = np.zeros((points, b.POINT_COLUMNS))
    near = box[rng.integers(0, vehicles, points)]
    point[:, b.PX] = near[:, b.BX] + rng.normal(0, 3, points)
    point[:, b.PY] = near[:, b.BY] + rng.normal(0, 3, points)
    point[:, b.PG] = np.hypot(point[:, b.PX], point[:, b.PY])
    radial = (near[:, b.BVX] * point[:, b.PX] + near[:, b.BVY] * point[:, b.PY]) / point[:, b.PG]
    point[:, b.PV] = np.where(rng.random(points) < 0.1, np.nan, radial + rng.normal(0, 0.2, points))
    point[:, b.PVAR_R], point[:, b.PVAR_AZ] = rng.uniform(0.01, 0.1, points), rng.uniform(1e-5, 1e-4, points)
    point[:, b.PWEIGHT], point[:, b.PECHO] = rng.uniform(1, 20, points), rng.uniform(0, 40, points)
    return box, point


def frame_of(box, point):
    dx, dy = point[None, :, b.PX] - box[:, None, b.BX], point[None, :, b.PY] - box[:, None, b.BY]
    s, c = box[:, None, b.BSIN], box[:, None, b.BCOS]
    return s * dx + c * dy, c * dx - s * dy


def slow_costs(box, point):
    u, w = frame_of(box, point)
    column = [box[:, None, k] for k in range(b.BOX_COLUMNS)]
    towards = -(column[b.BSIN] * column[b.BX] + column[b.BCOS] * column[b.BY])
    towards /= np.hypot(column[b.BX], column[b.BY])
    across2 = 1.0 - towards**2
    var_t = point[:, b.PG] ** 2 * point[:, b.PVAR_AZ]
    var_u = towards**2 * point[:, b.PVAR_R] + across2 * var_t
    var_w = across2 * point[:, b.PVAR_R] + towards**2 * var_t
    grow = np.where(u * towards > 0, column[b.BGROW_NEAR], column[b.BGROW_FAR])
    beyond = np.where(np.abs(w) < 0.5 * column[b.BWID] + 0.6, grow, 0.0)
    du = np.maximum(np.abs(u) - 0.5 * column[b.BLEN] - beyond, 0.0)
    dw = np.maximum(np.abs(w) - 0.35 * column[b.BWID], 0.0)
    d2 = du**2 / (var_u + column[b.BVAR_U] + 0.09) + dw**2 / (var_w + column[b.BVAR_W] + 0.04)
    far = d2 > 60.0
    rate = (column[b.BVX] * point[:, b.PX] + column[b.BVY] * point[:, b.PY]) / point[:, b.PG]
    doppler = (point[:, b.PV] - rate) ** 2 / ((0.02 * column[b.BSPEED]) ** 2 + column[b.BVAR_V])
    cost = d2 + np.nan_to_num(doppler) + 0.25 * (w / (0.5 * column[b.BWID] + 0.3)) ** 2
    return np.where(far, np.inf, cost)


def test_costs_are_those_of_the_definition_for_every_pair(rng):
    for _ in range(20):
        box, point = crowd(rng)
        np.testing.assert_allclose(b.point_costs(point, box), slow_costs(box, point), rtol=1e-9)


def test_a_point_goes_to_its_cheapest_box_and_a_cluster_of_one_box_as_a_whole(rng):
    box, point = crowd(rng)
    cost, label = b.point_costs(point, box), rng.integers(-1, 25, len(point))
    inside = np.where(cost < GATE, cost + box[:, [b.BPRIOR]], np.inf)
    expected = np.where(np.isfinite(inside).any(axis=0), inside.argmin(axis=0), -1)
    for cluster in range(label.max() + 1):
        mine = label == cluster
        claimants = set(expected[mine]) - {-1}
        if len(claimants) == 1:
            (only,) = claimants
            expected[mine & (expected < 0) & (cost[only] < CLUSTER_GATE)] = only

    owner = b.claim_points(cost, box[:, b.BPRIOR], label, GATE, CLUSTER_GATE)

    np.testing.assert_array_equal(owner, expected)


def test_pairs_are_every_box_with_its_own_points_and_with_sets_half_in_its_gate(rng):
    box, point = crowd(rng)
    cost = b.point_costs(point, box)
    owner = b.claim_points(cost, box[:, b.BPRIOR], np.full(len(point), -1), GATE, CLUSTER_GATE)
    expected = [
        (i, j)
        for i in range(len(box))
        for j in range(len(box))
        if (owner == j).any() and (i == j or (cost[i, owner == j] < GATE).mean() >= 0.5)
    ]

    pairs = list(zip(*b.contested_pairs(cost, owner, GATE), strict=True))

    assert pairs == expected
    assert len(pairs) > len(set(owner) - {-1})


def test_a_box_keeps_the_nearer_of_two_groups_side_by_side(rng):
    box, point = crowd(rng, vehicles=1, points=6)
    box[0, [b.BSIN, b.BCOS, b.BX, b.BY, b.BWID]] = 0.0, 1.0, 0.0, 50.0, 1.9
    point[:, b.PX] = [-0.4, 0.1, 0.5, 3.4, 3.8, 3.1]
    owner = np.zeros(6, dtype=np.int64)

    b.drop_neighbours(owner, point, box)

    assert owner.tolist() == [0, 0, 0, -1, -1, -1]


def test_a_measurement_sums_up_the_points_of_its_set(rng):
    box, point = crowd(rng)
    cost = b.point_costs(point, box)
    owner = b.claim_points(cost, box[:, b.BPRIOR], np.full(len(point), -1), GATE, CLUSTER_GATE)
    pair_box, pair_set = b.contested_pairs(cost, owner, GATE)
    u, w = frame_of(box, point)
    bearing = np.arctan2(box[:, b.BX], box[:, b.BY])
    aspect = np.arctan2(box[:, b.BSIN], box[:, b.BCOS]) - bearing
    angle = np.arccos(np.abs(np.cos(aspect)))
    bias = box[:, b.BWID] * np.interp(angle, b._BIAS_ANGLE_RAD, b._BIAS_WIDTHS)

    measured = b.measure_boxes(pair_box, pair_set, owner, point, box, 20.0)

    for row, i, j in zip(measured, pair_box, pair_set, strict=True):
        mine = owner == j
        known = point[mine & np.isfinite(point[:, b.PV])]
        rate = (box[i, b.BVX] * known[:, b.PX] + box[i, b.BVY] * known[:, b.PY]) / known[:, b.PG]
        assert row[b.M_COUNT] == mine.sum()
        if not row[b.M_EDGE]:
            assert (row[b.M_U_MIN], row[b.M_U_MAX]) == pytest.approx((u[i, mine].min(), u[i, mine].max()))
        assert row[b.M_U_MEAN] == pytest.approx(u[i, mine].mean())
        mean_w = np.average(w[i, mine], weights=point[mine, b.PWEIGHT])
        assert row[b.M_W] == pytest.approx(mean_w - np.copysign(bias[i], np.sin(aspect[i])))
        assert row[b.M_V] == pytest.approx(
            np.median(known[:, b.PV] - rate) if len(known) else np.nan, nan_ok=True
        )
        assert row[b.M_VAR_V] == pytest.approx(known[:, b.PVAR_R].sum() / max(len(known), 1) ** 2)
        assert row[b.M_ECHO] == pytest.approx(point[mine, b.PECHO].mean())


def test_a_point_of_the_stated_strength_has_the_stated_doppler_noise_and_a_weak_one_more():
    p = TrackerParameters()
    spread, share = doppler_noise(p)
    stated, weak = p.sensor.range_std_m**2, (2.5 * p.sensor.range_std_m) ** 2

    assert spread + share * stated == pytest.approx((1.3 * p.sensor.velocity_std_mps) ** 2)
    assert spread + share * weak == pytest.approx((0.69 + 2.5**2) * p.sensor.velocity_std_mps**2)


def receding_car(*along_m):
    """Return a receding 4.4 m box at y = 60 m and points on its axis, along_m from its centre."""
    box, point = np.zeros((1, b.BOX_COLUMNS)), np.zeros((len(along_m), b.POINT_COLUMNS))
    box[0, [b.BY, b.BCOS, b.BLEN, b.BWID]] = 60.0, 1.0, 4.4, 1.9
    point[:, b.PY] = point[:, b.PG] = 60.0 + np.array(along_m)
    point[:, b.PWEIGHT], point[:, b.PVAR_R], point[:, b.PVAR_AZ] = 10.0, 0.02, 1e-5
    return box, point


@pytest.mark.parametrize(
    ("along_m", "near_m"),
    [
        ((-2.2, -1.0, 0.5, 2.0), -2.2),
        ((-5.0, -2.2, -1.0, 0.5), -2.2),  # a point alone behind it is of another vehicle
        ((-5.0, -4.5, -2.2, 0.5), -5.0),  # two are not alone: the box is longer than it is known to be
        ((-5.0, -2.2), -5.0),  # of two points nobody knows which is alone
    ],
)
def test_a_point_alone_beyond_the_near_end_is_not_the_near_end(along_m, near_m):
    box, point = receding_car(*along_m)

    measured = b.measure_boxes(
        np.array([0]), np.array([0]), np.zeros(len(point), dtype=np.int64), point, box, 20.0
    )

    assert measured[0, b.M_U] == pytest.approx(near_m - 0.05 + 2.2, abs=1e-9)


@pytest.mark.parametrize(
    ("along_m", "centre_m"),
    [
        ((-0.9, 0.0, 0.9), 0.05),  # rear, middle and front: the rear is the nearest of all
        ((0.0, 0.9), 0.5),  # two of the three
        ((0.0,), 0.05),  # one: it may be any of them, and is the middle one on average
    ],
)
def test_the_nearest_echo_of_a_motorcycle_may_be_any_of_its_three(along_m, centre_m):
    box, point = receding_car(*along_m)
    box[0, [b.BLEN, b.BWID]] = 2.2, 0.9

    measured = b.measure_boxes(
        np.array([0]), np.array([0]), np.zeros(len(point), dtype=np.int64), point, box, 20.0
    )

    assert measured[0, b.M_U] == pytest.approx(centre_m, abs=0.11)


def test_without_a_range_rate_the_place_of_a_hidden_point_tells_that_its_vehicle_brakes():
    box, point = receding_car(1.8)
    box[0, b.BHIDDEN], point[:, b.PV] = 1.0, np.nan

    measured = b.measure_boxes(np.array([0]), np.array([0]), np.zeros(1, np.int64), point, box, 20.0)

    assert measured[0, b.M_U] == pytest.approx(1.8 - 0.05 + 2.2, abs=1e-9)


@pytest.mark.parametrize(
    ("along_m", "hidden", "centre_m"),
    [
        ((1.8,), False, 1.8 - 0.05 + 2.2),  # in plain sight the nearest point is of the near face
        ((1.8,), True, 0.0),  # in a shadow it may be of the roof, as long as the box holds it
        ((0.5, 1.8), True, 0.0),
        ((3.0,), True, 3.0 - 2.2),  # ... and the box goes back no further than to hold it
        ((-3.0,), True, -3.0 - 0.05 + 2.2),  # what is nearer than the near face is the near face
        ((0.4, 1.0, 1.8), True, 0.4 - 0.05 + 2.2),  # so many points are seen of what is in sight
    ],
)
def test_a_point_of_a_vehicle_in_a_shadow_may_be_of_its_far_end(along_m, hidden, centre_m):
    box, point = receding_car(*along_m)
    box[0, b.BHIDDEN] = float(hidden)

    measured = b.measure_boxes(
        np.array([0]), np.array([0]), np.zeros(len(point), dtype=np.int64), point, box, 20.0
    )

    assert measured[0, b.M_U] == pytest.approx(centre_m, abs=1e-9)
    assert (measured[0, b.M_VAR_U] > 1.0) == (hidden and along_m[0] > 0.0 and len(along_m) < 3)


@pytest.mark.parametrize(
    ("along_m", "speed_mps", "centre_m", "std_m"),
    [
        ((-0.5, 0.5), 8.0, 0.0, 2.25),  # two echoes say that it holds them, and hardly where its centre is
        ((-0.5, 0.5), 0.5, 0.0, 0.75),  # a box that stands is kept where it is
        ((1.5, 2.6), 8.0, 0.4, 0.75),  # an end that the box does not reach carries it on
        ((-2.1, 2.1), 8.0, 0.0, 0.45),  # both ends
    ],
)
def test_from_the_side_echoes_in_a_moving_box_tell_little_of_its_centre(along_m, speed_mps, centre_m, std_m):
    box, point = np.zeros((1, b.BOX_COLUMNS)), np.zeros((len(along_m), b.POINT_COLUMNS))
    box[0, [b.BX, b.BY, b.BSIN, b.BCOS, b.BLEN, b.BWID, b.BSPEED]] = 0.0, 60.0, 1.0, 0.0, 4.4, 1.9, speed_mps
    point[:, b.PX], point[:, b.PY], point[:, b.PWEIGHT] = along_m, 59.0, 10.0
    point[:, b.PG] = np.hypot(point[:, b.PX], point[:, b.PY])

    measured = b.measure_boxes(
        np.array([0]), np.array([0]), np.zeros(len(point), dtype=np.int64), point, box, 20.0
    )

    assert measured[0, b.M_U] == pytest.approx(centre_m, abs=0.01)
    assert np.sqrt(measured[0, b.M_VAR_U]) == pytest.approx(std_m, abs=0.01)


def measured_turn(x, y, aspect_rad, turned_rad, points):
    """Return the angle and variance that points (u, w) of a car tell, whose box lies turned_rad from it."""
    box, point = np.zeros((1, b.BOX_COLUMNS)), np.zeros((len(points), b.POINT_COLUMNS))
    heading = np.arctan2(x, y) + aspect_rad
    s, c = np.sin(heading), np.cos(heading)
    u, w = np.array(points).T
    box[0, [b.BX, b.BY, b.BSIN, b.BCOS]] = x, y, np.sin(heading - turned_rad), np.cos(heading - turned_rad)
    box[0, [b.BLEN, b.BWID]] = 4.4, 1.9
    point[:, b.PX], point[:, b.PY] = x + s * u + c * w, y + c * u - s * w
    point[:, b.PG] = np.hypot(point[:, b.PX], point[:, b.PY])
    point[:, b.PWEIGHT], point[:, b.PVAR_R], point[:, b.PVAR_AZ] = 10.0, 0.02, 1e-5
    nobody = np.zeros(len(point), dtype=np.int64)
    row = b.measure_boxes(np.array([0]), np.array([0]), nobody, point, box, 20.0)[0]
    return row[b.M_TURN], row[b.M_VAR_TURN]


@pytest.mark.parametrize("turned_rad", [-0.5, 0.0, 0.3])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_row_of_points_tells_how_far_a_box_is_turned(turned_rad, side):
    row = [(u, side * 0.95) for u in (-2.0, -1.0, 0.0, 1.5, 2.1)]

    turn, variance = measured_turn(10.0, 70.0, side * np.pi / 2, turned_rad, row)
    worse = measured_turn(10.0, 70.0, side * np.pi / 2, turned_rad, row[1:-1])[1]

    assert turn == pytest.approx(turned_rad, abs=0.18)  # a box turned off its points expects two faces
    assert 0.01 < variance < 0.03
    assert worse > 2 * variance
    assert measured_turn(10.0, 70.0, side * np.pi / 2, turned_rad, row[:2])[1] == np.inf


@pytest.mark.parametrize("aspect_rad", np.deg2rad([45.0, 135.0, -45.0, -135.0]))
def test_two_faces_seen_at_once_do_not_turn_a_box_to_its_diagonal(aspect_rad):
    near, right = -np.sign(np.cos(aspect_rad)), np.sign(np.sin(aspect_rad))
    side = [(u, 0.95 * right) for u in np.linspace(-2.2, 2.2, 9)]
    end = [(2.2 * near, w) for w in np.linspace(-0.95, 0.95, 4)]

    turn, _ = measured_turn(-8.0, 60.0, aspect_rad, 0.0, side + end)

    assert abs(turn) < 0.08


def slow_pairs(mean, rate_var, heading, turn_rate, length, hits, empty, p):
    """Return the pairs of one vehicle and whether one is a piece, matrix by matrix."""
    dx, dy = mean[None, :, 0] - mean[:, None, 0], mean[None, :, 3] - mean[:, None, 3]
    s, c = np.sin(heading)[:, None], np.cos(heading)[:, None]
    along, across, apart = np.abs(s * dx + c * dy), np.abs(c * dx - s * dy), np.hypot(dx, dy)
    sin, cos = np.stack([mean[:, 0], mean[:, 3]]) / np.hypot(mean[:, 0], mean[:, 3])
    gap_vx, gap_vy = mean[:, None, 1] - mean[:, 1], mean[:, None, 4] - mean[:, 4]
    at_first = np.abs(sin[:, None] * gap_vx + cos[:, None] * gap_vy)
    dv, speed = np.minimum(at_first, at_first.T), np.hypot(mean[:, 1], mean[:, 4])[:, None]
    most = p.same_speed_mps + p.same_speed_stds * np.sqrt(rate_var[:, None] + rate_var)
    most += np.maximum(np.abs(turn_rate)[:, None], np.abs(turn_rate)) * apart
    half, like = 0.5 * length[:, None], dv <= most
    close = (apart < p.same_centre_m) & (across < 0.75 * p.same_centre_m) & like
    inside = (along < half) & (across < p.inside_across_m) & (length[:, None] >= length) & like
    piece = (across < p.lane_across_m) & (dv < p.piece_dv_mps) & like & (speed > p.piece_speed_mps)
    gap = along - half - half.T
    piece &= (gap < np.minimum(p.piece_gap_s * speed, p.piece_gap_m)) & (
        along + half + half.T < p.length_max_m
    )
    piece &= (gap < 0.0) | (np.minimum(hits[:, None], hits) < p.piece_hits)
    silent = empty >= p.silent_frames
    seen_hits = np.where(silent[:, None], hits, np.where(silent, hits[:, None], 0))
    lost = (silent[:, None] != silent) & (dv < p.silent_dv_mps) & (seen_hits < p.piece_hits)
    young = (silent[:, None] == silent) & like & (dv < p.piece_dv_mps) & (speed > p.overlap_speed_mps)
    young &= np.minimum(hits[:, None], hits) < p.piece_hits
    overlap = (along < p.overlap_share * (half + half.T)) & (across < p.lane_across_m) & (lost | young)
    pair = close | inside | inside.T | (piece & piece.T) | overlap
    np.fill_diagonal(pair, False)
    return [(i, j, piece[i, j] and not close[i, j] and not inside[i, j]) for i, j in np.argwhere(pair)]


def limits_of(p):
    return (
        p.same_centre_m, p.same_speed_mps, p.same_speed_stds, p.inside_across_m, p.lane_across_m,
        p.piece_speed_mps, p.piece_dv_mps, p.piece_gap_s, p.piece_gap_m, float(p.piece_hits), p.length_max_m,
        p.overlap_share, p.overlap_speed_mps, float(p.silent_frames), p.silent_dv_mps,
    )  # fmt: skip


def test_tracks_of_one_vehicle_are_found_as_by_the_definition(rng):
    p, found = MergingParameters(), 0
    for _ in range(30):
        mean, turn_rate = np.zeros((14, 6)), rng.choice([0.0, 0.1], 14)
        mean[:, 0], mean[:, 3] = rng.uniform(-4, 4, 14), rng.uniform(40, 80, 14)
        mean[:, 4] = rng.choice([-15.0, -14.7, 2.0], 14)
        heading = np.arctan2(0.0, mean[:, 4]) + rng.normal(0, 0.05, 14)
        length, hits = rng.uniform(2.2, 12, 14), rng.integers(1, 100, 14)
        rate_var = rng.uniform(0.001, 0.04, 14)
        cov = np.zeros((14, 6, 6))
        cov[:, 1, 1] = cov[:, 4, 4] = rate_var
        empty = rng.choice([0, 20], 14, p=(0.8, 0.2))
        expected = slow_pairs(mean, rate_var, heading, turn_rate, length, hits, empty, p)
        found += len(expected)

        pairs = find_pairs(mean, cov, heading, turn_rate, length, hits, empty, limits_of(p))

        assert list(zip(*pairs, strict=True)) == expected

    assert found > 100


def two_behind_another(gap_m, dv_mps, hits):
    """Return the pairs among two cars of 4.4 m in one lane, `gap_m` from centre to centre, at 14 m/s."""
    mean, cov = np.zeros((2, 6)), np.zeros((2, 6, 6))
    mean[:, 3], mean[:, 4] = (60.0, 60.0 + gap_m), (14.0, 14.0 + dv_mps)
    cov[:, 1, 1] = cov[:, 4, 4] = 0.005
    pairs = find_pairs(
        mean,
        cov,
        np.zeros(2),
        np.zeros(2),
        np.full(2, 4.4),
        np.array(hits),
        np.zeros(2, np.int64),
        limits_of(MergingParameters()),
    )
    return len(pairs[0])


def test_a_vehicle_that_passes_another_closely_is_not_taken_for_it():
    assert two_behind_another(1.5, 0.1, (200, 100))
    assert not two_behind_another(1.5, 0.8, (200, 100))  # Doppler tells them apart


def test_only_a_young_track_is_a_piece_of_the_vehicle_before_it():
    assert two_behind_another(6.0, 0.1, (200, 10))
    assert not two_behind_another(6.0, 0.1, (200, 100))  # it has proved to be a vehicle of its own


def merged(y_m, vy_mps=12.0, **columns):
    """Return numbers and lengths of what two confirmed tracks 7 and 9 in one lane are merged to."""
    left = what_is_left(y_m, vy_mps, **columns)
    return left.number.tolist(), left.length_m.tolist()


def what_is_left(y_m, vy_mps, **columns):
    """Return the tracks that these two are merged to."""
    empty = no_tracks(0)
    names = [field.name for field in dataclasses.fields(empty)]
    blank = Tracks(
        *(np.zeros((2, *column.shape[1:]), column.dtype) for column in map(empty.__getattribute__, names))
    )
    mean, cov = np.zeros((2, 6)), np.zeros((2, 6, 6))
    mean[:, 3], mean[:, 4] = y_m, vy_mps
    cov[:, 1, 1] = cov[:, 4, 4] = 0.005
    values = {"status": (TrackStatus.CONFIRMED, TrackStatus.CONFIRMED)} | columns
    typed = {name: np.array(value, getattr(blank, name).dtype) for name, value in values.items()}
    left, drop = merge(blank.but(number=np.array([7, 9]), mean=mean, cov=cov, **typed), MergingParameters())
    return left.take(~drop)


def one_in_another(**changes):
    """Return what remains of an old motorcycle's track in the box of a bus."""
    usual = {
        "log_odds": (6.0, 6.0), "points_per_hit": (3.0, 4.0), "hits": (200, 150), "length_m": (2.2, 11.5),
        "width_m": (0.9, 2.5),
    }  # fmt: skip
    return merged((61.0, 60.0), **(usual | changes))


def test_the_older_of_two_tracks_stays_unless_it_fell_silent_or_has_far_fewer_points():
    assert one_in_another() == ([7], [2.2])
    assert one_in_another(points_per_hit=(3.0, 7.0)) == ([9], [11.5])
    assert one_in_another(log_odds=(0.0, 5.0), empty=(22, 0)) == ([9], [11.5])
    assert one_in_another(points_per_hit=(3.0, 7.0), hits=(200, 10)) == ([7], [2.2])  # not yet settled


@pytest.mark.parametrize(
    ("changes", "numbers"),
    [
        ({}, [7]),
        ({"hits": (200, 100)}, [7, 9]),  # it has proved to be a vehicle of its own
        ({"y_m": (60.0, 64.0)}, [7, 9]),  # nearly bumper to bumper
        ({"vy_mps": 1.0}, [7, 9]),  # in a queue places may be this wrong
        ({"vy_mps": (2.0, 3.0)}, [7, 9]),
        ({"vy_mps": (2.0, 3.0), "empty": (10, 0)}, [7]),
        ({"vy_mps": (2.0, 5.5), "empty": (10, 0)}, [7, 9]),
        ({"vy_mps": (2.0, 3.0), "empty": (5, 0)}, [7, 9]),
        ({"vy_mps": (2.0, 3.0), "empty": (10, 0), "hits": (200, 100)}, [7, 9]),
    ],
)
def test_a_young_track_that_overlaps_another_in_its_lane_is_the_same_vehicle(changes, numbers):
    usual = {
        "y_m": (60.0, 63.3), "vy_mps": 2.0, "hits": (200, 10), "length_m": (4.4, 4.4), "width_m": (1.9, 1.9),
    }  # fmt: skip

    assert merged(**(usual | changes))[0] == numbers


def test_a_vehicle_that_was_lost_goes_on_from_where_it_is_seen_with_its_number():
    left = what_is_left(
        (60.0, 63.3), (2.0, 3.0), hits=(200, 10), length_m=(4.4, 4.4), width_m=(1.9, 1.9), empty=(10, 0)
    )

    assert left.number.tolist() == [7]
    assert (left.y_m[0], left.mean[0, 4], left.empty[0], left.hits[0]) == (63.3, 3.0, 0, 10)


@pytest.mark.parametrize("crept_m", [(-3.0, 0.5), (0.5, -3.0)])
def test_what_either_track_showed_to_be_a_vehicle_still_is_one(crept_m):
    left = what_is_left(
        (60.0, 63.3), (2.0, 3.0), hits=(200, 10), length_m=(4.4, 4.4), width_m=(1.9, 1.9), empty=(10, 0),
        crept_m=crept_m,
    )  # fmt: skip

    assert left.crept_m.tolist() == [-3.0]


def test_a_confirmed_track_stays_before_a_tentative_one():
    status = (TrackStatus.TENTATIVE, TrackStatus.CONFIRMED)

    assert one_in_another(status=status) == ([9], [11.5])


@pytest.mark.parametrize(("empty", "length_m"), [(0, 10.4), (20, 4.4)])
def test_a_silent_box_stretches_no_other(empty, length_m):
    found = merged(
        (60.0, 66.0), hits=(200, 10), length_m=(4.4, 4.4), width_m=(1.9, 1.9), empty=(0, empty),
        points_per_hit=(3.0, 3.0),
    )  # fmt: skip

    assert found == ([7], [pytest.approx(length_m)])
