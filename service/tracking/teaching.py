"""Teach the maps: where vehicles drive and in which direction, and where nothing but clutter stands.

Each established moving track tells where it has driven; what stands, and is no vehicle's, is clutter.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from service.tracking import clutter as clutter_map
from service.tracking import road_map
from service.tracking.boxes import PV
from service.tracking.clutter import ClutterMap
from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, U8, Bool, TrackStatus
from service.tracking.parameters import TrackerParameters
from service.tracking.queue_lanes import Lately, queue_lanes
from service.tracking.road_map import RoadMap, RoadMapParameters
from service.tracking.starting import driven_way
from service.tracking.state import TrackerState, Tracks

_CONFIRMED = int(TrackStatus.CONFIRMED)


def teach_clutter(
    state: TrackerState, tracks: Tracks, seen: F64, unclaimed: Bool, post: Bool, p: TrackerParameters
) -> ClutterMap:
    """Return the clutter map after one more frame.

    state: its maps and what stood before are still those before the frame; tracks: after it; seen
    (N, POINT_COLUMNS): its points; unclaimed (N,): those of no vehicle; post (N,): those of a track that was
    found to be on a post. What is in line with a queue where nobody has driven yet is not learned, but for
    posts: it may be a vehicle that hardly gives points.
    """
    before = state.standing_window
    still = unclaimed & (np.abs(seen[:, PV]) < p.clutter.standing_mps)
    lately = Lately(before.points[~before.owned], state.range_seen_min_m)
    in_line, _ = queue_lanes(tracks, seen, still, lately, p.queue_lanes)
    if in_line.any():
        driven, _ = driven_way(state, seen, p)
        in_line &= ~driven
    stood = clutter_map.Before(before.points, before.owned)
    return clutter_map.learn(state.clutter, seen, unclaimed & ~in_line, post, stood, p.clutter)


def teach_road(state: TrackerState, p: TrackerParameters) -> TrackerState:
    """Return the state with its road map taught by the established moving tracks that came on by a cell.

    A place on a track's way is taught the direction of the chord from the place before it to the one behind
    it, not the heading of the box: headings lag in curves, and follow the map itself.
    """
    if state.frames % p.road.learn_interval_frames:
        return state
    t, q = state.tracks, p.road
    way, places, teach, moved = _go_on(
        t.mean, t.heading_rad, t.status, t.hits, t.way_m,
        (q.cell_y_m, float(q.learn_hits), q.learn_speed_mps, math.cos(q.chord_error_rad),
         math.cos(q.half_turn_rad)),
    )  # fmt: skip
    if not moved:
        return state
    road, cell = _teach(state.road, t, places, teach, q) if teach.any() else (state.road, t.map_cell)
    return replace(state, road=road, tracks=t.but(way_m=way, map_cell=cell))


def _teach(road: RoadMap, t: Tracks, places: F64, teach: Bool, p: RoadMapParameters) -> tuple[RoadMap, I64]:
    """Return the road with the places (2, T, 3) of the teaching tracks, and the last cell each has taught."""
    first = teach & (t.map_cell < 0)
    taught = [
        road_map.arc(np.array([t.born_x_m[k], t.born_y_m[k]]), places[1, k, :2], float(places[1, k, 2]), p)
        for k in np.flatnonzero(first & ~t.standing)
    ]
    cell = t.map_cell.copy()
    taught.append(road_map.fresh_places(places, teach, cell, road, p))
    x, y, heading = np.concatenate(taught).T
    return road_map.teach(road, x, y, heading, int(np.count_nonzero(first)), p), cell


@kernel
def _go_on(
    mean: F64, heading: F64, status: U8, hits: I64, way: F64, q: tuple[float, ...]
) -> tuple[F64, F64, Bool, bool]:
    """Return the ways (T, 4) of the tracks after this frame, what they teach, who does, and if any went on.

    The places (2, T, 3), x, y and direction, are half way between the last two of a way, and the last one.
    """
    step, least_hits, least_speed, chord_cosine, turn_cosine = q
    n, moved = len(hits), False
    out, places, teach = way.copy(), np.empty((2, n, 3)), np.zeros(n, np.bool_)
    for i in range(n):
        x, y, last_x, last_y = mean[i, 0], mean[i, 3], way[i, 2], way[i, 3]
        came = math.hypot(x - last_x, y - last_y) >= step
        if not (came or math.isnan(last_x)):
            continue
        moved = True
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = last_x, last_y, x, y
        before_x, before_y = way[i, 0], way[i, 1]
        if not came or math.isnan(before_x):  # there is no chord
            continue
        chord = math.atan2(x - before_x, y - before_y)
        between = math.atan2(last_x - before_x, last_y - before_y)
        places[0, i, 0], places[0, i, 1] = 0.5 * (before_x + last_x), 0.5 * (before_y + last_y)
        places[1, i, 0], places[1, i, 1] = last_x, last_y
        places[0, i, 2], places[1, i, 2] = between, chord
        sure = status[i] == _CONFIRMED and hits[i] >= least_hits
        moving = math.hypot(mean[i, 1], mean[i, 4]) > least_speed
        straight = math.cos(chord - heading[i]) > chord_cosine and math.cos(chord - between) > turn_cosine
        teach[i] = sure and moving and straight
    return out, places, teach, moved
