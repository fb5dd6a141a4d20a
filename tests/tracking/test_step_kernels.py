"""The kernels of one step around association and filter, against numpy written from their definitions."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from service.tracking import clutter as clutter_map
from service.tracking import existence, lifecycle, points, starting, tracker
from service.tracking.assigning import box_array
from service.tracking.boxes import BHIDDEN, PECHO, PG, PV, PVAR_AZ, PVAR_R, PWEIGHT, PX, PY
from service.tracking.clutter import ClutterParameters
from service.tracking.geometry import plan_points
from service.tracking.model import Frame, TrackStatus
from service.tracking.parameters import SensorModel, TrackerParameters
from service.tracking.state import Tracks, no_tracks


@pytest.fixture
def rng():
    return np.random.default_rng(12)


def some_tracks(rng, count=40):
    spread = rng.normal(0, 0.5, (count, 6, 6))
    mean = np.zeros((count, 6))
    mean[:, 0], mean[:, 3] = rng.uniform(-60, 60, count), rng.uniform(5, 160, count)
    mean[:, [1, 4]] = rng.normal(0, 8, (count, 2))
    empty = no_tracks(25)
    columns = (getattr(empty, field.name) for field in dataclasses.fields(empty))
    blank = Tracks(*(np.zeros((count, *column.shape[1:]), column.dtype) for column in columns))
    return blank.but(
        number=np.arange(count), mean=mean, cov=spread @ spread.swapaxes(1, 2) + np.eye(6),
        heading_rad=rng.uniform(-np.pi, np.pi, count), length_m=rng.uniform(3, 18, count),
        width_m=rng.uniform(0.9, 2.5, count), log_odds=rng.normal(0, 3, count),
        status=rng.integers(0, 3, count).astype(np.uint8), hits=rng.integers(1, 60, count),
        empty=rng.integers(0, 6, count), detect_rate=rng.uniform(0, 1, count),
        echo_db=rng.normal(20, 5, count),
    )  # fmt: skip


def some_frame(rng, count=80):
    snr = np.where(rng.random(count) < 0.1, np.nan, rng.uniform(8, 30, count))
    columns = (rng.uniform(0.1, 170, count), rng.uniform(-3.2, 3.2, count), rng.normal(0, 20, count), snr)
    return Frame("radar-1", 0, 1, None, *(column.astype(np.float32) for column in columns))


def test_points_are_those_of_the_geometry(rng):
    sensor = SensorModel(azimuth_offset_rad=0.3, mount_height_m=7.5)
    frame = some_frame(rng)
    plan = plan_points(frame, sensor)

    table = points.point_array(frame, sensor)

    expected = (
        (PX, plan.x_m), (PY, plan.y_m), (PG, plan.range_m), (PV, plan.radial_velocity_mps),
        (PVAR_R, plan.range_std_m**2), (PVAR_AZ, plan.azimuth_std_rad**2), (PWEIGHT, plan.weight),
        (PECHO, 20 * np.log10(plan.weight) + 40 * np.log10(plan.range_m / 100.0)),
    )  # fmt: skip
    for column, values in expected:
        np.testing.assert_allclose(table[:, column], values, rtol=1e-12, atol=1e-12)


def test_estimates_list_the_confirmed_and_hide_the_size_of_the_young(rng):
    t = some_tracks(rng)
    sure = t.status != TrackStatus.TENTATIVE

    e = tracker.estimates(t)

    np.testing.assert_array_equal(e.number, t.number[sure])
    np.testing.assert_array_equal(e.hits, t.hits[sure])
    np.testing.assert_array_equal(e.x_m, t.x_m[sure].astype(np.float32))
    np.testing.assert_array_equal(e.vy_mps, t.mean[sure, 4].astype(np.float32))
    np.testing.assert_array_equal(e.std_y_m, np.sqrt(t.cov[sure, 3, 3]).astype(np.float32))
    np.testing.assert_array_equal(e.cov_xy_m2, t.cov[sure, 0, 3].astype(np.float32))
    np.testing.assert_array_equal(np.isnan(e.length_m), t.hits[sure] < 8)
    np.testing.assert_allclose(e.existence, 1 / (1 + np.exp(-t.log_odds[sure])), rtol=1e-6)  # float32


def test_places_are_covered_by_widened_boxes_and_near_centres(rng):
    t = some_tracks(rng)
    x, y = rng.uniform(-60, 60, 300), rng.uniform(5, 160, 300)
    dx, dy = x[:, None] - t.x_m, y[:, None] - t.y_m
    s, c = np.sin(t.heading_rad), np.cos(t.heading_rad)
    u, w = np.abs(s * dx + c * dy), np.abs(c * dx - s * dy)
    rates = (x[:, None] * t.mean[:, 1] + y[:, None] * t.mean[:, 4]) / np.hypot(x, y)[:, None]
    rate = np.where(rng.random(300) < 0.1, np.nan, rates[np.arange(300), rng.integers(0, len(t), 300)])
    beside = np.where(np.abs(rates - rate[:, None]) < 0.5, 2.0, 0.3)  # what moves alike is of the box
    inside = (u < t.length_m / 2 + 0.7) & (w < t.width_m / 2 + beside) | (np.hypot(dx, dy) < 2.0)

    covered = starting._covered(
        x, y, rate, t.mean, t.heading_rad, t.length_m, t.width_m, (0.7, 0.3, 2.0, 2.0, 0.5)
    )

    np.testing.assert_array_equal(covered, inside.any(axis=1))
    assert 10 < covered.sum() < 250


def test_only_the_noise_of_moving_tracks_that_stay_empty_grows(rng):
    t, p = some_tracks(rng), TrackerParameters()
    late = (t.empty >= p.boxes.widen_after) & (t.speed_mps > 2.0)
    late &= t.empty > 2.0 / np.maximum(t.detect_rate, 0.1)
    hidden = existence.shadowed(t)
    speed = np.where(hidden, p.boxes.widen_shadowed_m2ps2, p.boxes.widen_velocity_m2ps2)
    place, none = np.full(len(t), p.boxes.widen_position_m2), np.zeros(len(t))
    grown = np.column_stack([place, speed, none, place, speed, none])[:, :, None] * np.eye(6)

    noise = tracker._widened(np.eye(6), t, hidden, p)

    np.testing.assert_allclose(noise, np.eye(6) + late[:, None, None] * grown)
    assert 0 < (late & hidden).sum() < late.sum() < len(t)


def test_silent_tracks_outside_the_view_have_left_and_the_sure_ones_give_the_echo(rng):
    t, p = some_tracks(rng), TrackerParameters()
    g, azimuth = np.hypot(t.x_m, t.y_m), np.abs(np.arctan2(t.x_m, t.y_m))
    s, margin = p.sensor, p.existence.leave_margin_m
    outside = (g > s.range_max_m + margin) | (g < s.range_min_m - margin)
    outside |= (azimuth - s.azimuth_max_rad) * g > margin
    sure = (t.status == TrackStatus.CONFIRMED) & (t.hits > p.existence.settled_hits) & (t.speed_mps > 3.0)

    np.testing.assert_array_equal(lifecycle._left_view(t, p), outside & (t.empty > 0))
    assert lifecycle._echo_reference(t, 0.0, p) == pytest.approx(t.echo_db[sure].mean())
    assert lifecycle._echo_reference(t.take(~sure), 7.0, p) == 7.0


@pytest.mark.parametrize(("age_s", "status"), [(3.0, TrackStatus.TENTATIVE), (5.0, TrackStatus.CONFIRMED)])
def test_what_looks_like_a_mirror_image_waits_until_a_ghost_would_be_gone(rng, age_s, status):
    t, p = some_tracks(rng).take(np.array([0])), TrackerParameters()
    mean = np.zeros((1, 6))
    mean[0, [0, 3, 4]] = 8.0, 70.0, -15.0
    t = t.but(
        mean=mean, status=np.array([TrackStatus.TENTATIVE], dtype=np.uint8), points_per_hit=np.ones(1),
        log_odds=np.full(1, 6.0), empty=np.zeros(1, dtype=np.int64), echo_db=np.zeros(1),
        born_us=np.array([0]), hit_us=np.array([round(age_s * 1e6)]),
    )  # fmt: skip
    yes, no = np.ones(1, dtype=np.bool_), np.zeros(1, dtype=np.bool_)
    around = existence.Surroundings(off_road=no, known_road=yes, behind_rail=yes, post=no)

    found, over = existence.judge(t, around, round(age_s * 1e6), no, 0.0, p.existence)

    assert (found.tolist(), over.tolist()) == ([status], [False])


def standing_points(x, y, rate=0.0):
    """Return points (N, POINT_COLUMNS) that stand at these places."""
    table = np.zeros((len(x), 8))
    table[:, PX], table[:, PY], table[:, PV] = x, y, rate
    table[:, PG] = np.hypot(table[:, PX], table[:, PY])
    return table


def learned(table, frames=100, *, clutter=None, post=False, second=None, owned=False):
    """Return the map after so many frames of these points, which nobody claims.

    second: the points of the second before, owned or not.
    """
    p = ClutterParameters()
    clutter, free = clutter or clutter_map.empty_map(p), np.ones(len(table), dtype=np.bool_)
    second = table[:0] if second is None else second
    before = clutter_map.Before(second, np.full(len(second), owned))
    for _ in range(frames):
        clutter = clutter_map.learn(clutter, table, free, free & post, before, p)
    return clutter


def occupancy(clutter, table):
    return clutter_map.occupancy_at(clutter, table, ClutterParameters())


def test_the_map_learns_lone_standing_points_and_forgets_without_subnormal_numbers():
    table = standing_points([3.0, -20.0, 8.0], [60.0, 90.0, 40.0], [0.0, 0.1, 5.0])
    known = learned(table)
    faint = clutter_map.ClutterMap(np.full_like(known.occupancy, 1e-20))

    assert (occupancy(known, table)[:2] > 0.85).all()
    assert occupancy(known, table)[2] == 0.0
    assert not learned(table[:0], 1, clutter=faint).occupancy.any()


@pytest.mark.parametrize(
    ("x", "y", "post"),
    [
        ([0.0, 0.5, -0.5, 0.2], [80.0, 82.6, 82.2, 84.8], False),
        ([0.0, 1.4, 2.7, 1.5], [80.0, 80.2, 80.1, 80.9], False),
        ([-6.0, -6.0, -6.0, -6.0], [78.0, 82.0, 86.0, 90.0], True),
        ([-50.0, -47.2, -44.4, -41.6], [50.0, 52.8, 55.6, 58.4], True),
        ([0.0, 0.2, 5.0], [80.0, 81.0, 80.0], True),
    ],
    ids=["a car end-on", "a car from the side", "a rail ahead", "a rail across", "two"],
)
def test_points_as_of_a_vehicle_teach_no_clutter(x, y, post):
    table = standing_points(np.array(x), np.array(y))
    assert (occupancy(learned(table), table) > 0.5).all() == post
    assert (occupancy(learned(table), table) == 0.0).all() == (not post)


def test_a_post_that_had_a_track_is_known_at_once_and_forgotten_where_there_is_none():
    posts = standing_points([0.0, 0.3, 0.6], [80.0, 81.0, 82.0])
    known, p = learned(posts, 1, post=True), ClutterParameters()
    other = standing_points([30.0], [50.0])

    assert (occupancy(known, posts) == 1.0).all()
    assert (occupancy(learned(posts, round(2 * p.forget_frames), clutter=known), posts) < 0.2).all()
    assert (occupancy(learned(other, round(2 * p.forget_frames), clutter=known), posts) < 0.2).all()


def a_second_of(rng, *, along_m=0.0, beside_m=0.0, fades_db=1.5, frames=20):
    """Return points of a second about (0, 80), a few decimetres wide by noise, and wider if spread out."""
    table = standing_points(
        rng.normal(0.0, 0.3, frames) + rng.uniform(-0.5, 0.5, frames) * beside_m,
        80.0 + rng.normal(0.0, 0.1, frames) + rng.uniform(-0.5, 0.5, frames) * along_m,
    )
    table[:, PVAR_R], table[:, PVAR_AZ] = 0.1**2, (0.3 / 80.0) ** 2
    table[:, PECHO] = rng.normal(0.0, fades_db, frames)
    return table


@pytest.mark.parametrize(
    ("spread", "owned", "known"),
    [
        ({"along_m": 3.0, "fades_db": 4.0}, False, False),
        ({"beside_m": 3.6, "fades_db": 4.0}, False, False),
        ({"along_m": 3.0}, False, True),
        ({"fades_db": 4.0}, False, True),
        ({}, False, True),
        ({"along_m": 3.0, "fades_db": 4.0}, True, True),
    ],
    ids=["end-on", "side-on", "steady", "in one place", "a post", "of a track"],
)
def test_what_is_spread_out_and_fades_is_no_clutter(rng, spread, owned, known):
    second = a_second_of(rng, frames=60, **spread)
    post = second[np.argmin(np.abs(second[:, PG] - 80.0) + np.abs(second[:, PX]))][None]

    found = occupancy(learned(post, second=second, owned=owned), post)

    assert (found > 0.5).tolist() == [known]


def test_points_are_sorted_by_speed_and_by_what_the_map_knows():
    p = ClutterParameters()
    table = np.zeros((6, 8))
    table[:, PX], table[:, PY], table[:, PG] = 0.0, np.arange(20.0, 80.0, 10.0), np.arange(20.0, 80.0, 10.0)
    table[:, PV] = [0.1, -1.0, 9.0, 0.1, 1.0, np.nan]
    known = clutter_map.empty_map(p).occupancy
    known[: int(45.0 / p.cell_range_m)] = 0.9  # the first three stand or drive among posts

    usable, standing, no_birth = clutter_map.sort_points(clutter_map.ClutterMap(known), table, p)

    assert usable.tolist() == [False, True, True, True, True, True]
    assert standing.tolist() == [True, False, False, True, False, False]
    assert no_birth.tolist() == [True, True, False, False, False, False]


def test_a_column_that_tracks_do_not_have_is_refused(rng):
    with pytest.raises(TypeError, match="hitz"):
        some_tracks(rng).but(hitz=np.zeros(40))


def test_columns_of_tracks_are_exchanged_taken_and_joined(rng):
    t = some_tracks(rng)

    other = t.but(hits=t.hits + 1)
    some = t.take(t.hits > 30)

    assert (other.hits == t.hits + 1).all()
    assert other.mean is t.mean
    np.testing.assert_array_equal(some.number, t.number[t.hits > 30])
    np.testing.assert_array_equal(some.join(t).number, np.concatenate([some.number, t.number]))


@pytest.mark.parametrize(("come_m", "hidden"), [(14.9, 0.0), (15.1, 1.0)])
def test_a_box_in_a_shadow_that_has_hardly_moved_may_stand_on_posts(rng, come_m, hidden):
    track = some_tracks(rng).take(np.array([0]))
    track = track.but(born_x_m=track.x_m, born_y_m=track.y_m - come_m)
    p = TrackerParameters().with_setting("shading.enabled", "false")  # it would see that nothing is there

    made = [box_array(track, track.mean, track.cov, np.array([there]), p) for there in (True, False)]

    assert [row[0, BHIDDEN] for row in made] == [hidden, 0.0]
