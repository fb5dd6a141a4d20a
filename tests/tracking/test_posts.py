"""What stands and is no vehicle: posts, told from vehicles by what they give and by what they never did."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from service.tracking.model import TrackStatus
from service.tracking.posts import Evidence, PostParameters, on_posts
from service.tracking.state import Tracks, no_tracks

NOW_US = 60_000_000
P = PostParameters()
DRIVEN = {"driven": True, "known_road": True}


def standing(*, aside_m=0.0, points=1.0, age_s=8.0, moved_m=0.0, speed_mps=0.0, echo_db=0.0, tentative=False):
    """Return one track that stands 60 m ahead."""
    blank = no_tracks(0)
    columns = (getattr(blank, field.name) for field in dataclasses.fields(blank))
    status = TrackStatus.TENTATIVE if tentative else TrackStatus.CONFIRMED
    return Tracks(*(np.zeros((1, *c.shape[1:]), c.dtype) for c in columns)).but(
        mean=np.array([[aside_m, 0.0, 0.0, 60.0, speed_mps, 0.0]]), born_x_m=np.array([aside_m]),
        born_y_m=np.array([60.0 + moved_m]), born_us=np.array([NOW_US - round(age_s * 1e6)]),
        points_per_hit=np.array([points]), echo_db=np.array([echo_db]),
        status=np.array([status], dtype=np.uint8),
    )  # fmt: skip


def judged(track, *others, hidden=False, driven=False, known_road=False, crept=False, reference_db=0.0):
    """Return whether the first track is on a post, with others about it, and whether beyond doubt."""
    tracks = track
    for other in others:
        tracks = tracks.join(other)
    seen = Evidence(*(np.full(len(tracks), told) for told in (hidden, driven, known_road, crept)))
    found, certain = on_posts(tracks, seen, NOW_US, reference_db, P)
    return bool(found[0]), bool(certain[0])


def is_post(track, *others, **told):
    """Return whether the first track is on a post, with others about it."""
    return judged(track, *others, **told)[0]


def test_what_gives_few_points_where_nobody_drives_is_a_post():
    assert is_post(standing(moved_m=10.0))
    assert not is_post(standing(moved_m=10.0), driven=True)
    assert not is_post(standing(moved_m=10.0, points=2.0))
    assert not is_post(standing(moved_m=16.0))
    assert not is_post(standing(moved_m=10.0, speed_mps=1.5))
    assert not is_post(standing(moved_m=10.0, age_s=0.9))


def test_what_stands_behind_a_vehicle_gives_few_points_too():
    assert not is_post(standing(), hidden=True)


def test_what_was_seen_to_stop_is_no_post():
    assert not is_post(standing(), crept=True)


@pytest.mark.parametrize(
    ("echo_db", "points", "post"),
    [(13.0, 1.0, True), (13.0, 1.7, True), (15.0, 1.0, False), (13.0, 1.9, False)],
)
def test_on_a_driven_road_the_echo_tells_a_post(echo_db, points, post):
    assert is_post(standing(echo_db=echo_db, points=points), reference_db=20.0, **DRIVEN) == post


def test_three_posts_are_no_vehicle_before_anybody_knows_the_road():
    assert is_post(standing(points=3.0, age_s=3.0), driven=True)
    assert not is_post(standing(points=3.2, age_s=3.0), driven=True)
    assert not is_post(standing(points=3.0, age_s=1.5), driven=True)
    assert not is_post(standing(points=3.0, age_s=3.0, moved_m=8.5), driven=True)
    assert is_post(standing(points=3.0, age_s=3.0, moved_m=7.5), driven=True)  # from one to the next but one
    assert not is_post(standing(points=3.0, age_s=3.0), **DRIVEN)


def passing(*, aside_m=0.8, speed_mps=10.0, hits=30, ahead_m=0.0, empty=0, status=TrackStatus.CONFIRMED):
    """Return a car that drives by, or through, what stands 60 m ahead."""
    return standing(points=5.0).but(
        mean=np.array([[aside_m, 0.0, 0.0, 60.0 + ahead_m, speed_mps, 0.0]]), hits=np.array([hits]),
        empty=np.array([empty]), length_m=np.array([4.4]), status=np.array([status], dtype=np.uint8),
    )  # fmt: skip


def test_a_vehicle_drives_through_nothing_but_posts():
    on_the_road = {"hidden": True, **DRIVEN}
    assert is_post(standing(points=3.0), passing(), **on_the_road)
    assert not is_post(standing(points=3.2), passing(), **on_the_road)
    assert not is_post(standing(points=3.0, moved_m=9.0), passing(), **on_the_road)
    slid = standing(points=3.0).but(born_x_m=np.array([-10.0]))  # onto it, across the line of sight
    assert is_post(slid, passing(), **on_the_road)
    assert not is_post(standing(points=3.0), passing(), crept=True, **on_the_road)


@pytest.mark.parametrize(
    "other",
    [
        passing(aside_m=1.2),
        passing(speed_mps=2.0),
        passing(hits=10),
        passing(ahead_m=2.5),
        passing(status=TrackStatus.COASTING),
        passing(empty=1),
        passing(status=TrackStatus.TENTATIVE),
    ],
    ids=["beside it", "slow", "young", "past it", "not seen", "no longer seen", "tentative"],
)
def test_nothing_else_drives_through(other):
    assert not is_post(standing(points=3.0), other, hidden=True, **DRIVEN)


@pytest.mark.parametrize(
    ("told", "certain"),
    [
        (judged(standing(), reference_db=20.0, **DRIVEN), True),
        (judged(standing(points=3.0), passing(), hidden=True, **DRIVEN), True),
        (judged(standing(moved_m=10.0)), False),
        (judged(standing(points=3.0, age_s=3.0), driven=True), False),
    ],
    ids=["weak", "driven through", "few points", "never moved"],
)
def test_only_what_no_vehicle_can_do_is_beyond_doubt(told, certain):
    assert told == (True, certain)


@pytest.mark.parametrize(
    ("company", "age_s", "post"),
    [(5.0, 180.0, False), (5.0, 250.0, True), (2.7, 19.0, False), (2.7, 21.0, True), (3.0, 21.0, True)],
    ids=["a red light", "longer", "in a row", "for longer", "posts, too"],
)
def test_near_a_vehicle_that_stands_it_has_longer_to_move(company, age_s, post):
    queue = standing(aside_m=20.0, points=company)
    assert is_post(standing(points=3.0, age_s=age_s), queue, driven=True) == post


def test_one_that_was_seen_to_stop_is_company_whatever_it_gives():
    tracks = standing(points=3.0).join(standing(aside_m=20.0, points=1.0))
    seen = Evidence(*(np.array(told) for told in ([False] * 2, [True] * 2, [False] * 2, [False, True])))
    assert not on_posts(tracks, seen, NOW_US, 0.0, P)[0].any()


@pytest.mark.parametrize(
    "other",
    [
        standing(aside_m=26.0, points=5.0),
        standing(aside_m=20.0, points=2.5),
        standing(aside_m=20.0, points=5.0, tentative=True),
        standing(aside_m=20.0, points=5.0, speed_mps=8.0),
    ],
    ids=["far away", "a post, too", "tentative", "drives"],
)
def test_nothing_else_is_company(other):
    assert is_post(standing(points=3.0), other, driven=True)
