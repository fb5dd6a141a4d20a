"""Remember where vehicles have driven and in which direction.

A coarse grid of the plan frame. New tracks take their heading from it, tracks off it must prove themselves
for longer, and standing objects on it may be vehicles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.kernel import kernel, part, ready
from service.tracking.model import F64, I64, Bool

_NUMBERED = 100_000  # cells of a row at most, so that one number names a cell


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
    shape = _shape(p)
    return RoadMap(np.zeros(shape), np.zeros(shape), np.zeros(shape), 0.0)


def _shape(p: RoadMapParameters) -> tuple[int, int]:
    """Return how many cells the grid has across and along the view."""
    return int(2 * p.reach_x_m / p.cell_x_m), int(p.reach_y_m / p.cell_y_m)


def teach(road: RoadMap, x_m: F64, y_m: F64, heading_rad: F64, first: int, p: RoadMapParameters) -> RoadMap:
    """Return the map after tracks entered new cells; `first`: how many of them had taught nothing before."""
    if len(x_m) == 0:
        return road
    tracks, sine, cosine = road.tracks.copy(), road.sine.copy(), road.cosine.copy()
    _teach(tracks, sine, cosine, ready(x_m), ready(y_m), ready(heading_rad), _grid(p))
    return RoadMap(tracks, sine, cosine, road.teachers + first)


def _grid(p: RoadMapParameters) -> tuple[float, float, float]:
    """Return where the grid begins and how large its cells are, as the kernels take it."""
    return p.reach_x_m, p.cell_x_m, p.cell_y_m


@part
def cell_of(x_m: float, y_m: float, where: tuple[float, ...]) -> tuple[int, int]:
    """Return the cell of a place, which may lie off the grid."""
    reach_x, cell_x, cell_y = where
    return math.floor((x_m + reach_x) / cell_x), math.floor(y_m / cell_y)


def fresh_places(places: F64, teach: Bool, cell: I64, road: RoadMap, p: RoadMapParameters) -> F64:
    """Return the places (K, 3) of teaching tracks, in cells other than the one each of them taught last.

    places (2, T, 3): x, y and direction of two places of each track; teach (T,) who teaches; cell (T,) the
    number of the last cell, -1 for none, brought up to date in place.
    """
    rows, columns = road.tracks.shape
    return _fresh_places(places, teach, cell, rows, columns, _grid(p))


@kernel
def _fresh_places(
    places: F64, teach: Bool, cell: I64, rows: int, columns: int, where: tuple[float, ...]
) -> F64:
    out, found = np.empty((2 * len(cell), 3)), 0
    for which in range(2):
        for i in range(len(cell)):
            if not teach[i]:
                continue
            a, b = cell_of(places[which, i, 0], places[which, i, 1], where)
            number = a * _NUMBERED + b
            if not (0 <= a < rows and 0 <= b < columns) or number == cell[i]:
                continue
            cell[i] = number
            for c in range(3):
                out[found, c] = places[which, i, c]
            found += 1
    return out[:found]


@kernel
def _teach(
    tracks: F64, sine: F64, cosine: F64, x_m: F64, y_m: F64, heading: F64, where: tuple[float, ...]
) -> None:
    for k in range(len(x_m)):
        i, j = cell_of(x_m[k], y_m[k], where)
        if 0 <= i < tracks.shape[0] and 0 <= j < tracks.shape[1]:
            tracks[i, j] += 1.0
            sine[i, j] += math.sin(heading[k])
            cosine[i, j] += math.cos(heading[k])


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
    corner, size = np.array([-p.reach_x_m, 0.0]), np.array([p.cell_x_m, p.cell_y_m])
    cell = np.floor((place - corner) / size).astype(np.int64)
    nearest = np.clip(cell, 0, np.array(_shape(p)) - 1)  # on the grid
    _, first = np.unique(nearest @ [_NUMBERED, 1], return_index=True)
    first = np.sort(first[(cell == nearest).all(axis=1)[first]])
    return np.asarray(np.column_stack([place, heading])[first])


def driven_at(road: RoadMap, x_m: F64, y_m: F64, p: RoadMapParameters) -> tuple[F64, F64, F64]:
    """Return, for each place, the tracks seen in its cell, their mean heading [rad] and its agreement.

    Agreement is the length of the mean unit vector, 1 where all drove the same way, 0 where nobody drove.
    """
    return _driven_at(road.tracks, road.sine, road.cosine, ready(x_m), ready(y_m), _grid(p))


def one_way_at(road: RoadMap, x_m: F64, y_m: F64, p: RoadMapParameters) -> tuple[Bool, F64]:
    """Return which places lie where all have driven one way, and that direction [rad]."""
    count, heading, agreement = driven_at(road, x_m, y_m, p)
    return np.asarray((count >= p.driven_tracks) & (agreement > p.one_way_agreement)), heading


@kernel
def _driven_at(
    tracks: F64, sine: F64, cosine: F64, x_m: F64, y_m: F64, where: tuple[float, ...]
) -> tuple[F64, F64, F64]:
    count, heading, agreement = np.zeros(len(x_m)), np.zeros(len(x_m)), np.zeros(len(x_m))
    for k in range(len(x_m)):
        i, j = cell_of(x_m[k], y_m[k], where)
        if 0 <= i < tracks.shape[0] and 0 <= j < tracks.shape[1] and tracks[i, j] > 0.0:
            count[k] = tracks[i, j]
            heading[k] = math.atan2(sine[i, j], cosine[i, j])
            agreement[k] = math.hypot(sine[i, j], cosine[i, j]) / count[k]
    return count, heading, agreement
