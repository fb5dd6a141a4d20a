"""Remember where vehicles have driven and in which direction.

A coarse grid of the plan frame. New tracks take their heading from it, tracks off it must prove themselves
for longer, and standing objects on it may be vehicles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, Bool


@dataclass(frozen=True, slots=True)
class RoadMapParameters:
    """Cells of the driven map and what counts as driven."""

    cell_x_m: float = 2.0
    cell_y_m: float = 4.0
    reach_x_m: float = 120.0
    reach_y_m: float = 180.0
    learn_hits: int = 40  # a track teaches the map only after so many hits
    learn_speed_mps: float = 3.0
    learn_interval_frames: int = 3  # at 25 m/s a vehicle needs three frames for a cell
    arc_step_m: float = 1.0  # of the way back to where a track was first seen
    came_from_m: float = (
        8.0  # ... and straight on behind it: what is first seen somewhere has come from there
    )
    chord_error_rad: float = (
        0.4  # a track that goes elsewhere than its box points has taken over another vehicle
    )
    half_turn_rad: float = 0.1  # within two cells; of a sharper turn (20 m) no cell has one direction
    arc_half_turn_rad: float = 0.6  # a sharper turn is no arc of one circle
    driven_tracks: float = 2.0  # tracks through a cell that make it driven
    one_way_agreement: float = 0.97  # length of the mean direction: all within some 15 degrees
    mature_tracks: float = 12.0  # tracks learned before absence from the map means anything


@dataclass(frozen=True, slots=True)
class RoadMap:
    """Per cell (X, Y): number of different tracks, and the sums of sine and cosine of their headings."""

    tracks: F64
    sine: F64
    cosine: F64
    teachers: float  # different tracks that have taught the map


def empty_road_map(p: RoadMapParameters) -> RoadMap:
    """Return a map on which nobody has driven."""
    shape = (int(2 * p.reach_x_m / p.cell_x_m), int(p.reach_y_m / p.cell_y_m))
    return RoadMap(np.zeros(shape), np.zeros(shape), np.zeros(shape), 0.0)


def cell_of(x_m: F64, y_m: F64, p: RoadMapParameters) -> tuple[I64, I64, Bool]:
    """Return the cell of each place and whether it lies on the grid."""
    i = np.floor((x_m + p.reach_x_m) / p.cell_x_m).astype(np.int64)
    j = np.floor(y_m / p.cell_y_m).astype(np.int64)
    n_x, n_y = int(2 * p.reach_x_m / p.cell_x_m), int(p.reach_y_m / p.cell_y_m)
    inside = (i >= 0) & (j >= 0) & (i < n_x) & (j < n_y)
    return np.minimum(np.maximum(i, 0), n_x - 1), np.minimum(np.maximum(j, 0), n_y - 1), inside


def cell_number(x_m: F64, y_m: F64, p: RoadMapParameters) -> I64:
    """Return a number for the cell of each place, -1 off the grid or where it is NaN."""
    known = np.isfinite(x_m) & np.isfinite(y_m)
    i, j, inside = cell_of(np.where(known, x_m, 0.0), np.where(known, y_m, 0.0), p)
    return np.asarray(np.where(inside & known, i * 100_000 + j, -1))


def teach(road: RoadMap, x_m: F64, y_m: F64, heading_rad: F64, first: int, p: RoadMapParameters) -> RoadMap:
    """Return the map after tracks entered new cells; `first`: how many of them had taught nothing before."""
    if len(x_m) == 0:
        return road
    i, j, inside = cell_of(x_m, y_m, p)
    tracks, sine, cosine = road.tracks.copy(), road.sine.copy(), road.cosine.copy()
    where = (i[inside], j[inside])
    np.add.at(tracks, where, 1.0)
    np.add.at(sine, where, np.sin(heading_rad[inside]))
    np.add.at(cosine, where, np.cos(heading_rad[inside]))
    return RoadMap(tracks, sine, cosine, road.teachers + first)


def arc(start: F64, end: F64, heading_rad: float, p: RoadMapParameters) -> F64:
    """Return (K, 3) places x, y and headings along the circle from `start` to `end`, (2,), one for each cell.

    A track is sure of itself only after a second or two, a long way from where it was first seen. From its
    first place to where it is now, heading `heading_rad`, it came along a circle: the chord halves the turn.
    Behind that place it came straight, for `came_from_m`: at the edge of view others are first seen there.
    No places when the two are too near, or the turn too sharp, for the chord to tell.
    """
    dx, dy = end - start
    length = math.hypot(dx, dy)
    chord = math.atan2(dx, dy)
    half_turn = (heading_rad - chord + math.pi) % (2.0 * math.pi) - math.pi
    if length < 2.0 * p.cell_y_m or abs(half_turn) > p.arc_half_turn_rad:
        return np.zeros((0, 3))
    share = (np.arange(1.0, max(2.0, length // p.arc_step_m)) * p.arc_step_m / length)[:, None]
    bow = 0.5 * length * math.tan(0.5 * half_turn) * 4.0 * share * (1.0 - share)  # to the left of the chord
    place = start + share * (end - start) + bow * np.array([-math.cos(chord), math.sin(chord)])
    heading = chord + (2.0 * share[:, 0] - 1.0) * half_turn
    back = np.arange(math.floor(p.came_from_m / p.arc_step_m), 0.0, -1.0)[:, None] * p.arc_step_m
    first_heading = chord - half_turn
    before = start - back * np.array([math.sin(first_heading), math.cos(first_heading)])
    place = np.concatenate([before, place])
    heading = np.concatenate([np.full(len(before), first_heading), heading])
    i, j, inside = cell_of(place[:, 0], place[:, 1], p)
    _, first = np.unique(i * 100_000 + j, return_index=True)
    first = np.sort(first[inside[first]])
    return np.asarray(np.column_stack([place, heading])[first])


def driven_at(road: RoadMap, x_m: F64, y_m: F64, p: RoadMapParameters) -> tuple[F64, F64, F64]:
    """Return, for each place, the tracks seen in its cell, their mean heading [rad] and its agreement.

    Agreement is the length of the mean unit vector, 1 where all drove the same way, 0 where nobody drove.
    """
    where = (p.reach_x_m, p.cell_x_m, p.cell_y_m)
    return _driven_at(road.tracks, road.sine, road.cosine, np.array(x_m), np.array(y_m), where)


def one_way_at(road: RoadMap, x_m: F64, y_m: F64, p: RoadMapParameters) -> tuple[Bool, F64]:
    """Return which places lie where all have driven one way, and that direction [rad]."""
    count, heading, agreement = driven_at(road, x_m, y_m, p)
    return np.asarray((count >= p.driven_tracks) & (agreement > p.one_way_agreement)), heading


@kernel
def _driven_at(
    tracks: F64, sine: F64, cosine: F64, x_m: F64, y_m: F64, where: tuple[float, ...]
) -> tuple[F64, F64, F64]:
    reach_x, cell_x, cell_y = where
    count, heading, agreement = np.zeros(len(x_m)), np.zeros(len(x_m)), np.zeros(len(x_m))
    for k in range(len(x_m)):
        i, j = math.floor((x_m[k] + reach_x) / cell_x), math.floor(y_m[k] / cell_y)
        if 0 <= i < tracks.shape[0] and 0 <= j < tracks.shape[1] and tracks[i, j] > 0.0:
            count[k] = tracks[i, j]
            heading[k] = math.atan2(sine[i, j], cosine[i, j])
            agreement[k] = math.hypot(sine[i, j], cosine[i, j]) / count[k]
    return count, heading, agreement
