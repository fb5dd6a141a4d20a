"""Halves of one vehicle that were taken for two while it stood: they are one when they drive off as one."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from service.tracking import snapshot, tandem
from service.tracking.extent import ExtentParameters
from service.tracking.model import TrackStatus
from service.tracking.parameters import TrackerParameters
from service.tracking.state import Tandems, Tracks, no_tandems, no_tracks
from service.tracking.tandem import TandemParameters
from service.tracking.tracker import TrackerState, coast, initial_state, step
from tests.tracking.test_tracker import T0_US, frame, vehicle

P, SIZE = TandemParameters(), ExtentParameters()
BUS_M = 12.0


def pair(at_m, speed_mps, *, gap_m=0.5, dv_mps=0.0, bearing_rad=0.0, heading_rad=0.0, bus_m=BUS_M, **columns):
    """Confirmed tracks 7 and 9, each half a bus long, 9 ahead of 7 and faster by dv_mps."""
    blank = no_tracks(0)
    names = [field.name for field in dataclasses.fields(blank)]
    made = Tracks(*(np.zeros((2, *c.shape[1:]), c.dtype) for c in map(blank.__getattribute__, names)))
    s, c = math.sin(heading_rad), math.cos(heading_rad)
    half = 0.5 * (bus_m - gap_m)
    along = np.array([-0.5, 0.5]) * (half + gap_m)
    mean = np.zeros((2, 6))
    mean[:, 0] = at_m * math.sin(bearing_rad) + along * s
    mean[:, 3] = at_m * math.cos(bearing_rad) + along * c
    speeds = speed_mps + np.array([0.0, dv_mps])
    mean[:, 1], mean[:, 4] = speeds * s, speeds * c
    cov = np.zeros((2, 6, 6))
    cov[:, 1, 1] = cov[:, 4, 4] = 0.005
    filled = {
        "heading_rad": heading_rad, "length_m": half, "width_m": 2.5, "log_odds": 6.0,
        "points_per_hit": 4.0, "empty": 0, "status": TrackStatus.CONFIRMED,
        "extent_m": half - SIZE.end_margin_m, **columns,
    }  # fmt: skip
    whole = {name: np.full_like(getattr(made, name), value) for name, value in filled.items()}
    return made.but(number=np.array([7, 9]), mean=mean, cov=cov, **whole)


def united(frames, p=P):
    """Return when the tracks of these frames become one, and what is left of them; else None."""
    tandems = no_tandems()
    for number, tracks in enumerate(frames):
        tandems = tandem.pairs_now(tandems, tracks, p)
        left, drop = tandem.unite(tandems, tracks, p, SIZE)
        if drop.any():
            return number, left.take(~drop)
    return None


def driving(speed_mps, count=40, **changes):
    return [pair(60.0 + k * 0.05 * speed_mps, speed_mps, **changes) for k in range(count)]


@pytest.mark.parametrize("heading_rad", [0.0, 1.2, 3.1])
def test_the_halves_of_a_bus_that_sets_off_become_one_of_its_length(heading_rad):
    speeds = np.arange(0.0, 6.0, 0.075)  # 1.5 m/s^2
    frames = [pair(60.0, v, heading_rad=heading_rad) for v in speeds]
    number, left = united(frames)
    assert number == pytest.approx(np.searchsorted(speeds, P.least_mps, side="right") + 10, abs=1)
    assert left.number.tolist() == [7 if math.cos(heading_rad) > 0.0 else 9]  # the nearer half
    assert left.length_m.tolist() == [pytest.approx(BUS_M)]
    assert (left.x_m[0], left.y_m[0]) == (pytest.approx(0.0, abs=1e-9), pytest.approx(60.0))


def test_cars_that_set_off_one_after_the_other_stay_two():
    def frame(k):
        ahead, behind = (max(0.1 * (k - late), 0.0) for late in (0, 20))  # 2 m/s^2, a second apart
        gap_m = 1.0 + 0.05 * sum(max(0.1 * (j - 0), 0.0) - max(0.1 * (j - 20), 0.0) for j in range(k))
        return pair(60.0, behind, gap_m=gap_m, dv_mps=ahead - behind)

    assert united([frame(k) for k in range(120)]) is None


@pytest.mark.parametrize(
    ("changes", "one"),
    [
        ({}, True),
        ({"gap_m": 1.9}, True),
        ({"gap_m": 2.2}, False),  # at 6 m/s
        ({"speed_mps": 2.0}, False),
        ({"dv_mps": 0.3}, False),
        ({"dv_mps": 0.3, "bearing_rad": 1.4}, True),  # seen from the side, where Doppler tells nothing
        ({"dv_mps": 1.2, "bearing_rad": 1.5}, False),
        ({"empty": (0, 3)}, False),
        ({"width_m": (0.9, 1.9)}, False),  # a motorcycle
        ({"width_m": (1.9, 0.9)}, False),
        ({"width_m": (0.9, 2.5), "length_m": (2.2, 8.5)}, True),  # the end of a truck
        ({"width_m": (2.5, 0.9), "length_m": (8.5, 2.2)}, True),
        ({"gap_m": -0.9}, True),
        ({"gap_m": -1.1}, False),  # beside one another
        ({"status": (TrackStatus.CONFIRMED, TrackStatus.TENTATIVE)}, False),
    ],
)
def test_only_what_drives_close_and_alike_is_one(changes, one):
    speed_mps = changes.pop("speed_mps", 6.0)
    assert (united(driving(speed_mps, **changes)) is not None) == one


def test_more_than_a_truck_is_long_is_two():
    assert united(driving(6.0, bus_m=18.5)) is not None
    assert united(driving(6.0, bus_m=19.5)) is None


def test_one_frame_apart_begins_the_count_anew():
    frames = [*driving(6.0, 8), pair(60.0, 6.0, dv_mps=1.0), *driving(6.0, 8)]
    assert united(frames) is None
    assert united(frames + driving(6.0, 3)) is not None


def test_only_the_next_ahead_counts():
    two = pair(60.0, 6.0)
    apart = two.mean[1] - two.mean[0]
    three = two.join(two.take(np.array([1])).but(number=np.array([11]), mean=two.mean[1:] + apart))
    found = tandem.pairs_now(no_tandems(), three, P)
    assert list(zip(found.ahead.tolist(), found.behind.tolist(), strict=True)) == [(9, 7), (11, 9)]


def test_few_points_of_the_far_half_tell_no_more_than_where_it_begins():
    frames = driving(6.0, 40)
    blind = [t.but(extent_m=np.where([[False], [True]], np.nan, t.extent_m)) for t in frames]
    whole, begun = (united(f)[1].length_m[0] for f in (frames, blind))
    half = 0.5 * (BUS_M - 0.5)
    assert whole == pytest.approx(BUS_M)
    assert begun == pytest.approx(half + 0.5 + SIZE.end_margin_m)


def test_the_tracker_ends_the_far_half_and_its_number_does_not_rest():
    rng, p = np.random.default_rng(8), TrackerParameters()
    halves = pair(60.0, 6.0, empty=(0, 1), width_m=(1.9, 1.9), heading_var=0.01, hits=200, hit_us=T0_US)
    halves = halves.but(cov=halves.cov + 0.02 * np.eye(6))
    tandems = Tandems(np.array([9]), np.array([7]), np.array([P.frames - 1]))
    state = dataclasses.replace(initial_state(p), tracks=halves, tandems=tandems, next_number=10, frames=1)
    state = dataclasses.replace(state, time_us=T0_US)

    points = [vehicle(rng, 0.5, y + 0.3, 0.0, 6.0, length=5.75, points=9) for y in halves.y_m]
    after, estimates, report = step(state, frame(1, *points), p)

    assert estimates.number.tolist() == [7]
    assert estimates.length_m[0] == pytest.approx(BUS_M, abs=0.3)
    assert estimates.width_m[0] == pytest.approx(SIZE.wide_m)
    assert report.deleted == 1
    assert not len(after.resting.number)


def test_a_setting_of_no_frames_unites_none():
    assert united(driving(6.0), dataclasses.replace(P, frames=0)) is None


def test_pairs_are_kept_in_a_snapshot_and_forgotten_without_frames():
    tracks = pair(60.0, 6.0)
    state = dataclasses.replace(initial_state(), tandems=tandem.pairs_now(no_tandems(), tracks, P))
    again = snapshot.load(TrackerState, snapshot.dump(state))
    assert (again.tandems.ahead.tolist(), again.tandems.frames.tolist()) == ([9], [1])
    assert not len(coast(again, 1_000_000, TrackerParameters())[0].tandems.ahead)
