"""Vehicles that are hardly seen, in line with a queue that stood when the recording began."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from service.tracking import births, road_map, tracker
from service.tracking.births import BirthParameters, Way
from service.tracking.boxes import PECHO, PG, POINT_COLUMNS, PVAR_AZ, PX, PY
from service.tracking.clutter import occupancy_at
from service.tracking.model import TrackStatus
from service.tracking.parameters import TrackerParameters
from service.tracking.queue_lanes import Lately, QueueLaneParameters, queue_lanes
from service.tracking.starting import find_births
from service.tracking.teaching import teach_clutter
from tests.tracking.standing_boxes import boxes
from tests.tracking.standing_points import FRAMES, points_of, queue_of

P = QueueLaneParameters()
TOWARDS_RAD = np.pi
QUEUE = ((3.0, 50.0), (3.0, 57.0))
SEEN = {"heading_rad": TOWARDS_RAD, "points_per_hit": np.full(2, 5.0)}
FADING_DB, STEADY_DB = 4.0, 1.0


def echoes(x_m, y_m, *, n=20, fades_db=FADING_DB, deep_m=0.1, seed=1):
    """Return n standing points about one place, with echoes that fade so much."""
    rng, points = np.random.default_rng(seed), np.zeros((n, POINT_COLUMNS))
    points[:, PX], points[:, PY] = x_m + rng.normal(0.0, 0.2, n), y_m + rng.normal(0.0, deep_m, n)
    points[:, PG] = np.hypot(points[:, PX], points[:, PY])
    points[:, PVAR_AZ], points[:, PECHO] = 0.005**2, rng.normal(0.0, fades_db, n)
    return points


def told(points, tracks=None, *, p=P, nearest_m=18.0, which=None):
    which = np.ones(len(points), np.bool_) if which is None else which
    tracks = boxes(*QUEUE, **SEEN) if tracks is None else tracks
    return queue_lanes(tracks, points, which, Lately(points, nearest_m), p)


def share(points, tracks=None, **settings):
    return told(points, tracks, **settings)[0].mean()


@pytest.mark.parametrize("y_m", [43.0, 64.0, 71.0])
def test_what_fades_in_line_with_two_that_stand_is_told_and_which_way_it_faces(y_m):
    in_line, heading = told(echoes(3.0, y_m))

    assert in_line.all()
    assert np.abs(np.sin(heading - TOWARDS_RAD)).max() < 0.01
    assert (np.cos(heading - TOWARDS_RAD) > 0.0).all()


@pytest.mark.parametrize(
    "points",
    [
        echoes(3.0, 95.0),  # too far behind the last
        echoes(6.0, 64.0),  # the rail beside the lane
        echoes(3.0, 64.0, fades_db=STEADY_DB),  # a post
        echoes(3.0, 64.0, n=4),  # too few to tell whether they fade
    ],
)
def test_what_is_too_far_beside_the_lane_steady_or_hardly_there_is_not_told(points):
    assert share(points) == 0.0


def test_echoes_of_unknown_strength_are_not_told():
    points = echoes(3.0, 64.0)
    points[:, PECHO] = np.nan

    assert share(points) == 0.0


def test_only_those_that_are_asked_about_are_told():
    points = echoes(3.0, 64.0)
    which = np.arange(len(points)) < 5

    assert told(points, which=which)[0].tolist() == which.tolist()


def test_near_where_the_view_begins_nobody_is_told():
    assert share(echoes(3.0, 43.0), nearest_m=36.0) == 0.0


@pytest.mark.parametrize(
    "queue",
    [
        {"places": QUEUE[:1], "points_per_hit": np.full(1, 5.0)},  # one has no lane
        {"points_per_hit": np.array([5.0, 1.0])},  # the second may be a post
        {"hits": np.array([100, 10])},
        {"status": np.full(2, TrackStatus.TENTATIVE, np.uint8)},
        {"places": ((3.0, 50.0), (3.0, 53.0))},  # two boxes on one vehicle
        {"places": ((3.0, 50.0), (6.5, 57.0))},  # in lanes beside one another
        {"places": ((3.0, 50.0), (3.0, 85.0))},  # too far apart
        {"heading_rad": np.array([TOWARDS_RAD, TOWARDS_RAD + 0.4])},  # one lies askew
        {"heading_rad": np.array([TOWARDS_RAD, 0.0])},  # each goes its own way
        {"places": ((40.0, 50.0), (40.0, 57.0)), "heading_rad": TOWARDS_RAD},  # seen from the side
    ],
)
def test_who_is_not_certain_to_stand_in_one_lane_tells_nothing(queue):
    columns = SEEN | queue
    tracks = boxes(*columns.pop("places", QUEUE), **columns)
    x_m = float(tracks.x_m[0])

    assert share(echoes(x_m, 64.0), tracks) == 0.0


def test_who_drives_tells_nothing_and_who_came_driving_does_with_few_points():
    driving, came = boxes(*QUEUE, **SEEN), boxes(*QUEUE, **(SEEN | {"points_per_hit": np.full(2, 1.5)}))
    driving.mean[:, 4] = -3.0

    assert share(echoes(3.0, 64.0), driving) == 0.0
    assert share(echoes(3.0, 64.0), came) == 0.0
    assert share(echoes(3.0, 64.0), came.but(born_y_m=came.y_m + 40.0)) == 1.0


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_a_lane_that_bends_leads_on_as_its_nearest_two_stand(order):
    places = [((3.0, 50.0), (3.2, 57.0), (3.9, 64.0))[k] for k in order]
    tracks = boxes(*places, heading_rad=TOWARDS_RAD, points_per_hit=np.full(3, 5.0))
    in_line, heading = told(echoes(4.6, 71.0), tracks)

    assert in_line.all()
    assert heading - TOWARDS_RAD == pytest.approx([0.1] * len(heading), abs=0.01)


def test_a_reach_of_nothing_tells_nothing():
    assert share(echoes(3.0, 64.0), p=dataclasses.replace(P, reach_m=0.0)) == 0.0


def born(points, *, in_line):
    n = len(points)
    way = Way(np.zeros(n, np.bool_), np.full(n, TOWARDS_RAD), np.full(n, in_line))
    return births.gather(births.standing_births(points, FRAMES, way, BirthParameters()))


def test_a_car_of_three_points_in_two_frames_starts_a_track_where_it_is_in_line():
    car = queue_of((3.0, 64.0, 4.4), rate=1.5)
    new = born(car, in_line=True)

    assert (len(new), len(born(car, in_line=False))) == (1, 0)
    assert (new.x_m[0], new.y_m[0]) == pytest.approx((3.0, 64.0), abs=0.8)
    assert np.cos(new.heading_rad[0] - TOWARDS_RAD) > 0.99


@pytest.mark.parametrize("n", [30, 80])
def test_one_place_in_line_is_a_post(n):
    assert len(born(echoes(3.0, 64.0, n=n), in_line=True)) == 0


def test_who_is_seen_well_enough_without_the_queue_needs_no_depth():
    face = np.concatenate([echoes(x, 64.0, n=30, seed=k) for k, x in enumerate((2.2, 3.0, 3.8))])

    assert len(born(face, in_line=False)) == len(born(face, in_line=True)) == 1


def test_one_place_in_line_takes_no_birth_from_a_row_seen_from_the_side():
    kept = lost = 0
    for seed in range(20):
        points = points_of((0.0, 64.0, 4.4), rate=2.0, seed=seed)
        driven = points[:, PX] < -0.8
        nobody = np.zeros(len(points), np.bool_)
        way = Way(driven, np.full(len(points), np.pi / 2), nobody)
        rows = births.standing_births(points, FRAMES, way, BirthParameters())
        queued = births.standing_births(points, FRAMES, way._replace(in_line=~driven), BirthParameters())
        kept += len(rows)
        lost += len(rows) > len(queued)

    assert kept >= 15
    assert lost == 0


def test_beside_cars_that_are_well_seen_one_in_line_starts_a_track_and_one_elsewhere_none():
    well = queue_of(*((-0.5, y, 4.4) for y in (50.0, 57.0, 64.0)))
    weak = queue_of((3.0, 57.0, 4.4), rate=1.5)
    points = np.concatenate([well, weak])
    own = np.arange(len(points)) >= len(well)
    way = Way(np.zeros(len(points), np.bool_), np.full(len(points), TOWARDS_RAD), own)

    def right_of(way):
        new = births.gather(births.standing_births(points, FRAMES, way, BirthParameters()))
        return new.heading_rad[new.x_m > 1.5]

    assert np.cos(right_of(way) - TOWARDS_RAD) == pytest.approx([1.0], abs=0.01)
    away = way._replace(heading_rad=np.zeros(len(points)))  # the queue tells which way it faces
    assert np.cos(right_of(away)) == pytest.approx([1.0], abs=0.01)
    assert len(right_of(way._replace(in_line=np.zeros(len(points), np.bool_)))) == 0


def after_a_second(points, p, *, owned=False, driven_x_m=None):
    """Return a tracker's state that has seen these points stand, of a track or not."""
    state = tracker.initial_state(p)
    window = dataclasses.replace(
        state.standing_window, points=points, time_us=np.zeros(len(points), np.int64),
        owned=np.full(len(points), owned), standing=np.ones(len(points), np.bool_),
    )  # fmt: skip
    road = state.road
    if driven_x_m is not None:
        y_m = np.repeat(np.arange(40.0, 80.0, 0.5), 10)
        road = road_map.teach(
            road, np.full(len(y_m), driven_x_m), y_m, np.full(len(y_m), TOWARDS_RAD), 10, p.road
        )
    return dataclasses.replace(
        state, range_seen_min_m=18.0, standing_window=window, road=road, frame_times_us=tuple(range(FRAMES))
    )


def learned(tracks, state, points, p):
    """Return how much a place where a point comes back for three seconds is held to be clutter."""
    free, post = np.ones(1, np.bool_), np.zeros(1, np.bool_)
    for _ in range(60):
        clutter = teach_clutter(state, tracks, points[:1], free, post, p)
        state = dataclasses.replace(state, clutter=clutter)
    return occupancy_at(state.clutter, points[:1], p.clutter)[0]


def test_what_is_in_line_is_not_learned_as_clutter():
    # it fades, but lies in one place: without the queue it is a post
    p, points = TrackerParameters(), echoes(3.0, 64.0, deep_m=0.05)
    queue, one = boxes(*QUEUE, **SEEN), boxes(*QUEUE[:1], **(SEEN | {"points_per_hit": np.full(1, 5.0)}))

    assert learned(queue, after_a_second(points, p), points, p) == 0.0
    assert learned(one, after_a_second(points, p), points, p) > 0.35


def test_where_vehicles_have_driven_it_is_and_echoes_of_other_tracks_tell_nothing():
    p, points = TrackerParameters(), echoes(3.0, 64.0, deep_m=0.05)
    queue = boxes(*QUEUE, **SEEN)

    assert learned(queue, after_a_second(points, p, driven_x_m=3.0), points, p) > 0.35
    assert learned(queue, after_a_second(points, p, owned=True), points, p) > 0.35


@pytest.mark.parametrize(("places", "found"), [(QUEUE, 1), (QUEUE[:1], 0)])
def test_behind_a_queue_a_car_that_is_hardly_seen_starts_a_track(places, found):
    p = TrackerParameters()
    car = np.concatenate([echoes(3.0, y_m, n=18, seed=k) for k, y_m in enumerate((62.0, 63.0))])
    tracks = boxes(*places, **(SEEN | {"points_per_hit": np.full(len(places), 5.0)}))
    state = dataclasses.replace(after_a_second(car, p), tracks=tracks)
    new = find_births(state, np.zeros(0, np.int64), np.zeros(0, np.bool_), car[:0], 0, p)

    assert len(new) == found
    assert new.y_m == pytest.approx([64.1] * found, abs=0.3)
