"""Carry tracks through a frame: weigh what it said of them, confirm, coast and end them."""

from __future__ import annotations

import math

import numpy as np

from service.tracking import clutter as clutter_map
from service.tracking import creeping, existence, resting, road_map
from service.tracking.assigning import Assignment
from service.tracking.existence import Surroundings
from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, U8, Bool, TrackStatus
from service.tracking.parameters import TrackerParameters
from service.tracking.posts import Evidence, on_posts
from service.tracking.state import TrackerState, Tracks

_CONFIRMED = int(TrackStatus.CONFIRMED)
ECHO_GAIN = 0.01  # of the running mean echo of confirmed vehicles: some hundred vehicle-frames


def live(
    state: TrackerState, tracks: Tracks, a: Assignment, time_us: int, p: TrackerParameters
) -> tuple[Tracks, float, int, I64, I64]:
    """Return the tracks that live on after a frame's association, the echo reference, and who ended.

    That is how many did, the numbers of those that were on posts, and of those that were so beyond doubt.
    """
    if not len(tracks):
        return tracks, state.echo_reference_db, 0, tracks.number, tracks.number
    hidden = existence.shadowed(tracks)
    tracks = existence.remember(tracks, a.measured, a.miss, time_us, hidden, p.existence)
    around, certain = _surroundings(state, tracks, hidden, time_us, p)
    status, over = existence.judge(tracks, around, time_us, hidden, state.echo_reference_db, p.existence)
    tracks = tracks.but(status=status)
    over |= _left_view(tracks, p)
    ended = int(np.count_nonzero(over))
    reference = _echo_reference(tracks, state.echo_reference_db, p)
    left = tracks.take(~over) if ended else tracks
    return left, reference, ended, tracks.number[around.post], tracks.number[certain]


def _left_view(tracks: Tracks, p: TrackerParameters) -> Bool:
    """Return which tracks (T,) are silent and outside the region: nothing more will be heard of them."""
    s = p.sensor
    return _outside(
        tracks.mean, tracks.empty, s.range_min_m, s.range_max_m, s.azimuth_max_rad, p.existence.leave_margin_m
    )


@kernel
def _outside(
    mean: F64, empty: I64, range_min: float, range_max: float, azimuth_max: float, margin: float
) -> Bool:
    out = np.zeros(len(mean), np.bool_)
    for i in range(len(mean)):
        g, azimuth = math.hypot(mean[i, 0], mean[i, 3]), abs(math.atan2(mean[i, 0], mean[i, 3]))
        if empty[i] > 0:
            beyond = g > range_max + margin or g < range_min - margin
            out[i] = beyond or (azimuth - azimuth_max) * g > margin
    return out


def let_go(tracks: Tracks, time_us: int, p: TrackerParameters) -> tuple[Tracks, int]:
    """Return the tracks that live on although time passed without a frame, coasting, and how many ended."""
    if not len(tracks):
        return tracks, 0
    tracks = tracks.but(empty=tracks.empty + 1)
    nowhere = np.zeros(len(tracks), dtype=np.bool_)
    around = Surroundings(nowhere, nowhere, nowhere, nowhere)
    status, over = existence.judge(tracks, around, time_us, existence.shadowed(tracks), 0.0, p.existence)
    return tracks.but(status=status).take(~over), int(over.sum())


def _surroundings(
    state: TrackerState, t: Tracks, hidden: Bool, time_us: int, p: TrackerParameters
) -> tuple[Surroundings, Bool]:
    count, _, _ = road_map.driven_at(state.road, t.x_m, t.y_m, p.road)
    known = count >= p.road.driven_tracks
    crept = creeping.seen(t, p.creeping)
    vouched = _vouched(state, t, known, p)
    mature = state.road.teachers >= p.road.mature_tracks  # before nobody knows where nobody drives
    evidence = Evidence(hidden, known if mature else np.ones_like(known), vouched, crept)
    post, certain = on_posts(t, evidence, time_us, state.echo_reference_db, p.posts)
    around = Surroundings(
        off_road=~known & mature & (np.hypot(t.x_m, t.y_m) < p.boxes.off_road_range_m),
        known_road=vouched | crept,
        behind_rail=_behind_rail(state, t, p),
        post=post,
    )
    return around, certain


def _vouched(state: TrackerState, t: Tracks, known: Bool, p: TrackerParameters) -> Bool:
    """Return which tracks (T,) are where vehicles are known to drive, or to have gone."""
    asked = np.flatnonzero(~known & ~t.confirmed)
    if not len(asked) or not len(state.resting.number):
        return known
    out = known.copy()
    out[asked] = resting.awaited(state.resting, t.x_m[asked], t.y_m[asked], p.resting)
    return out


def _behind_rail(state: TrackerState, t: Tracks, p: TrackerParameters) -> Bool:
    """Return which tentative tracks (T,) stand behind a row of clutter from a stronger vehicle like them."""
    out = np.zeros(len(t), dtype=np.bool_)
    first, second = existence.mirror_partners(t, p.existence)
    if not len(first):
        return out
    g, azimuth = np.hypot(t.x_m, t.y_m), np.arctan2(t.x_m, t.y_m)
    for i, j in zip(first, second, strict=True):  # tentative ones only: few
        out[i] |= clutter_map.stands_between(state.clutter, g[i], azimuth[i], azimuth[j], p.clutter)
    return out


def _echo_reference(tracks: Tracks, reference_db: float, p: TrackerParameters) -> float:
    """Return the running mean echo of confirmed moving vehicles."""
    mean = _mean_echo(
        tracks.mean, tracks.status, tracks.hits, tracks.echo_db, p.existence.settled_hits,
        p.road.learn_speed_mps,
    )  # fmt: skip
    if math.isnan(mean):
        return reference_db
    return mean if reference_db == 0.0 else reference_db + ECHO_GAIN * (mean - reference_db)


@kernel
def _mean_echo(mean: F64, status: U8, hits: I64, echo_db: F64, settled_hits: int, speed_mps: float) -> float:
    total, count = 0.0, 0
    for i in range(len(hits)):
        if status[i] == _CONFIRMED and hits[i] > settled_hits:
            if math.hypot(mean[i, 1], mean[i, 4]) > speed_mps:
                total += echo_db[i]
                count += 1
    return total / count if count > 0 else math.nan
