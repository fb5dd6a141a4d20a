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
    driven_tracks: float = 2.0  # tracks through a cell that make it driven
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


def driven_at(road: RoadMap, x_m: F64, y_m: F64, p: RoadMapParameters) -> tuple[F64, F64, F64]:
    """Return, for each place, the tracks seen in its cell, their mean heading [rad] and its agreement.

    Agreement is the length of the mean unit vector, 1 where all drove the same way, 0 where nobody drove.
    """
    where = (p.reach_x_m, p.cell_x_m, p.cell_y_m)
    return _driven_at(road.tracks, road.sine, road.cosine, np.array(x_m), np.array(y_m), where)


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
