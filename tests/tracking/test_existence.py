"""When a track ends although it is still seen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from service.tracking import existence
from service.tracking.existence import ExistenceParameters, Surroundings
from service.tracking.model import TrackStatus
from service.tracking.state import Tracks, no_tracks

NOW_US = 10_000_000


def ends(*, post):
    """Return whether a confirmed track that has stood for eight seconds and was just seen ends now."""
    blank = no_tracks(0)
    columns = (getattr(blank, field.name) for field in dataclasses.fields(blank))
    track = Tracks(*(np.zeros((1, *c.shape[1:]), c.dtype) for c in columns)).but(
        mean=np.array([[0.0, 0.0, 0.0, 60.0, 0.0, 0.0]]), cov=0.1 * np.eye(6)[None],
        status=np.array([TrackStatus.CONFIRMED], dtype=np.uint8), log_odds=np.array([5.0]),
        hits=np.array([60]), hit_us=np.array([NOW_US]), born_us=np.array([NOW_US - 8_000_000]),
        born_y_m=np.array([60.0]), points_per_hit=np.ones(1),
    )  # fmt: skip
    no = np.zeros(1, dtype=np.bool_)
    around = Surroundings(off_road=no, known_road=no, behind_rail=no, post=np.array([post]))
    _, over = existence.judge(track, around, NOW_US, no, 0.0, ExistenceParameters())
    return bool(over[0])


def test_what_is_found_to_be_a_post_ends():
    assert ends(post=True)
    assert not ends(post=False)


@pytest.mark.parametrize(
    ("travel_m", "points", "speed_mps", "known_road", "status"),
    [
        (4.0, 2.9, 0.0, False, TrackStatus.TENTATIVE),
        (5.0, 2.9, 0.0, False, TrackStatus.CONFIRMED),
        (4.0, 3.2, 0.0, False, TrackStatus.CONFIRMED),
        (4.0, 2.9, 1.5, False, TrackStatus.CONFIRMED),
        (4.0, 2.9, 0.0, True, TrackStatus.CONFIRMED),
    ],
)
def test_what_may_be_three_posts_is_not_confirmed(travel_m, points, speed_mps, known_road, status):
    blank = no_tracks(0)
    columns = (getattr(blank, field.name) for field in dataclasses.fields(blank))
    track = Tracks(*(np.zeros((1, *c.shape[1:]), c.dtype) for c in columns)).but(
        mean=np.array([[0.0, 0.0, 0.0, 60.0, speed_mps, 0.0]]), log_odds=np.array([6.5]), hits=np.array([60]),
        hit_us=np.array([NOW_US]), born_us=np.array([NOW_US - 8_000_000]),
        born_y_m=np.array([60.0 + travel_m]),
        points_per_hit=np.array([points]),
    )  # fmt: skip
    no = np.zeros(1, dtype=np.bool_)
    around = Surroundings(off_road=no, known_road=np.array([known_road]), behind_rail=no, post=no)

    found, over = existence.judge(track, around, NOW_US, no, 0.0, ExistenceParameters())

    assert (found.tolist(), over.tolist()) == ([status], [False])


def in_shadow(aside_m, *, std_m, status=TrackStatus.CONFIRMED):
    """Return whether a car 90 m away, aside_m from the line through a truck 60 m away, lies in its shadow."""
    blank = no_tracks(0)
    columns = (getattr(blank, field.name) for field in dataclasses.fields(blank))
    cov = np.zeros((2, 6, 6))
    cov[:, 0, 0] = std_m**2
    tracks = Tracks(*(np.zeros((2, *c.shape[1:]), c.dtype) for c in columns)).but(
        mean=np.array([[0.0, 0.0, 0.0, 60.0, 12.0, 0.0], [aside_m, 0.0, 0.0, 90.0, 12.0, 0.0]]), cov=cov,
        length_m=np.array([12.0, 4.4]), width_m=np.array([2.5, 1.9]),
        status=np.array([TrackStatus.CONFIRMED, status], dtype=np.uint8),
    )  # fmt: skip
    hidden = existence.shadowed(tracks)
    assert not hidden[0]
    return bool(hidden[1])


def test_a_small_vehicle_is_not_in_its_own_shadow():
    mean, cov = np.array([[0.0, 12.0, 0.0, 40.0, 0.0, 0.0]]), np.zeros((1, 6, 6))
    confirmed, side_on, width_m = np.array([TrackStatus.CONFIRMED], np.uint8), np.array([np.pi / 2]), 0.9
    args = mean, cov, side_on, np.array([2.2]), np.array([width_m]), confirmed

    assert not existence._shadowed.py_func(*args).any()
    assert not existence._shadowed(*args).any()


def test_a_vehicle_that_may_well_lie_in_a_shadow_is_taken_to():
    assert in_shadow(2.0, std_m=0.1)
    assert not in_shadow(3.0, std_m=0.1)
    assert in_shadow(3.0, std_m=1.0)
    assert not in_shadow(4.0, std_m=1.0)
    assert not in_shadow(3.0, std_m=1.0, status=TrackStatus.TENTATIVE)  # nobody knows that it exists
