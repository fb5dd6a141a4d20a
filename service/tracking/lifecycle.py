"""Carry tracks through a frame: weigh what it said of them, confirm, coast and end them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.tracking import clutter as clutter_map
from service.tracking import existence, road_map
from service.tracking.assigning import Assignment
from service.tracking.existence import Surroundings
from service.tracking.model import Bool, TrackStatus
from service.tracking.parameters import TrackerParameters
from service.tracking.state import TrackerState, Tracks

ECHO_GAIN = 0.01  # of the running mean echo of confirmed vehicles: some hundred vehicle-frames


def live(state: TrackerState, a: Assignment, time_us: int, p: TrackerParameters) -> tuple[TrackerState, int]:
    """Return the state after a frame's association, its tracks those that live on, and how many ended."""
    if not len(state.tracks):
        return state, 0
    hidden = existence.shadowed(state.tracks)
    tracks = existence.remember(state.tracks, a.measured, a.miss, time_us, hidden, p.existence)
    around = _surroundings(replace(state, tracks=tracks), p)
    status, over = existence.judge(tracks, around, time_us, hidden, state.echo_reference_db, p.existence)
    tracks = replace(tracks, status=status)
    over |= _left_view(tracks, p)
    ended = int(over.sum())
    reference = _echo_reference(tracks, state.echo_reference_db, p)
    return replace(state, tracks=tracks.take(~over) if ended else tracks, echo_reference_db=reference), ended


def _left_view(tracks: Tracks, p: TrackerParameters) -> Bool:
    """Return which tracks (T,) are silent and outside the region: nothing more will be heard of them."""
    g, azimuth = np.hypot(tracks.x_m, tracks.y_m), np.abs(np.arctan2(tracks.x_m, tracks.y_m))
    s, margin = p.sensor, p.existence.leave_margin_m
    outside = (g > s.range_max_m + margin) | (g < s.range_min_m - margin)
    outside |= (azimuth - s.azimuth_max_rad) * g > margin
    return np.asarray(outside & (tracks.empty > 0))


def let_go(tracks: Tracks, time_us: int, p: TrackerParameters) -> tuple[Tracks, int]:
    """Return the tracks that live on although time passed without a frame, coasting, and how many ended."""
    if not len(tracks):
        return tracks, 0
    tracks = replace(tracks, empty=tracks.empty + 1)
    nowhere = np.zeros(len(tracks), dtype=np.bool_)
    around = Surroundings(~nowhere, nowhere, nowhere, nowhere)
    status, over = existence.judge(tracks, around, time_us, existence.shadowed(tracks), 0.0, p.existence)
    return replace(tracks, status=status).take(~over), int(over.sum())


def _surroundings(state: TrackerState, p: TrackerParameters) -> Surroundings:
    t = state.tracks
    count, _, _ = road_map.driven_at(state.road, t.x_m, t.y_m, p.road)
    known = count >= p.road.driven_tracks
    mature = state.road.teachers >= p.road.mature_tracks
    if not mature:
        nowhere = np.zeros(len(t), dtype=np.bool_)
        return Surroundings(~nowhere, nowhere, known, _behind_rail(state, p))
    off_road = ~known & (np.hypot(t.x_m, t.y_m) < p.boxes.off_road_range_m)
    return Surroundings(known, off_road, known, _behind_rail(state, p))


def _behind_rail(state: TrackerState, p: TrackerParameters) -> Bool:
    """Return which tentative tracks (T,) stand behind a row of clutter from a stronger vehicle like them."""
    t = state.tracks
    out = np.zeros(len(t), dtype=np.bool_)
    g, azimuth = np.hypot(t.x_m, t.y_m), np.arctan2(t.x_m, t.y_m)
    for i, j in zip(*existence.mirror_partners(t, p.existence), strict=True):  # tentative ones only: few
        out[i] |= clutter_map.stands_between(state.clutter, g[i], azimuth[i], azimuth[j], p.clutter)
    return out


def _echo_reference(tracks: Tracks, reference_db: float, p: TrackerParameters) -> float:
    """Return the running mean echo of confirmed moving vehicles."""
    sure = (tracks.status == TrackStatus.CONFIRMED) & (tracks.hits > p.existence.settled_hits)
    sure &= tracks.speed_mps > p.road.learn_speed_mps
    if not sure.any():
        return reference_db
    mean = float(tracks.echo_db[sure].mean())
    return mean if reference_db == 0.0 else reference_db + ECHO_GAIN * (mean - reference_db)
