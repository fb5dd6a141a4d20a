"""Add up, cell by cell of the lanes, how far and how long vehicles drove: what Edie's measures are made of.

A cell is a piece of a lane, `cell_m` long along its centre line. Each vehicle's way from one measurement to
the next is a straight line in place along the lane over time, cut exactly at the edges of cells and minutes;
a gap that the tracker bridged, or that stitching did, is such a way, too. Distances are signed, so that the
trembling of a standing vehicle adds up to nothing.

Source: Edie, L. C., "Discussion of traffic stream measurements and definitions", 1963.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from service.tracking.model import F64, U8
from service.traffic.model import LaneMap
from service.traffic.records import MINUTE_US
from service.traffic.stitching import Joined

CELL = np.dtype(
    [
        ("lane", "u1"),
        ("cell", "<u2"),  # it begins at cell * cell_m along the centre line
        ("length_m", "<f4"),  # of the cell, shorter at the lane's end
        ("distance_m", "<f4"),  # driven in it by all vehicles
        ("time_s", "<f4"),  # spent in it by all vehicles
    ]
)
OPEN_MINUTES = 2  # a bridged gap ends seconds after it began, perhaps in the next minute


@dataclass(frozen=True, slots=True)
class Ruler:
    """The lanes of a map as polylines, and how many cells each has."""

    version: int
    lane: tuple[int, ...]  # indices
    points_m: tuple[F64, ...]  # (P, 2) each
    cells: tuple[int, ...]
    length_m: tuple[float, ...]
    cell_m: float


NO_RULER = Ruler(0, (), (), (), (), 0.0)


@dataclass(frozen=True, slots=True)
class MinuteCells:
    """What was driven in one minute: (lanes of the ruler, most cells) distance and time."""

    minute: int
    version: int  # of the lane map
    lane: tuple[int, ...]  # its lanes
    length_m: tuple[float, ...]  # of each
    cell_m: float
    distance_m: F64
    time_s: F64


def ruler_of(lanes: LaneMap, cell_m: float) -> Ruler:
    """Return how far along its lanes a map measures."""
    length = tuple(lane.length_m for lane in lanes.lanes)
    return Ruler(
        version=lanes.version,
        lane=tuple(lane.index for lane in lanes.lanes),
        points_m=tuple(lane.points_m for lane in lanes.lanes),
        cells=tuple(int(np.ceil(metres / cell_m)) for metres in length),
        length_m=length,
        cell_m=cell_m,
    )


def drive(
    minutes: tuple[MinuteCells, ...], ruler: Ruler, joined: Joined, lane: U8, time_us: int
) -> tuple[MinuteCells, ...]:
    """Return the open minutes with the ways that ended in this scan; lane: (T,) of its tracks."""
    rows = np.flatnonzero((joined.measured >= 0) & (joined.origin >= 0))
    index = lane[joined.measured[rows]]
    v = joined.vehicles
    ways: list[tuple[int, float, float, int]] = []
    for k, number in enumerate(ruler.lane):
        mine = rows[index == number]
        if len(mine):
            begin = along(ruler.points_m[k], joined.from_x_m[mine], joined.from_y_m[mine])
            end = along(ruler.points_m[k], v.x_m[mine], v.y_m[mine])
            ways += [
                (k, a, b, t)
                for a, b, t in zip(begin.tolist(), end.tolist(), joined.from_us[mine].tolist(), strict=True)
            ]
    return _added(minutes, ruler, ways, time_us)


def along(points_m: F64, x_m: F64, y_m: F64) -> F64:
    """Return (N,) how far along a polyline the foot of each point lies; its ends go on straight."""
    step = np.diff(points_m, axis=0)
    length = np.hypot(step[:, 0], step[:, 1])
    start = np.concatenate([[0.0], np.cumsum(length)[:-1]])
    dx, dy = x_m[:, None] - points_m[:-1, 0], y_m[:, None] - points_m[:-1, 1]
    place = (dx * step[:, 0] + dy * step[:, 1]) / length
    inside = np.clip(place, 0.0, length)
    away = np.hypot(dx - inside * step[:, 0] / length, dy - inside * step[:, 1] / length)
    nearest = np.argmin(away, axis=1)
    foot = np.take_along_axis(inside, nearest[:, None], axis=1)[:, 0]
    open_place = np.take_along_axis(place, nearest[:, None], axis=1)[:, 0]
    first, last = nearest == 0, nearest == len(length) - 1
    foot = np.where(first & (open_place < 0) | last & (open_place > length[-1]), open_place, foot)
    return np.asarray(start[nearest] + foot)


def _added(
    minutes: tuple[MinuteCells, ...],
    ruler: Ruler,
    ways: list[tuple[int, float, float, int]],
    time_us: int,
) -> tuple[MinuteCells, ...]:
    if not ruler.lane:
        return minutes
    minute = time_us // MINUTE_US
    shape = (len(ruler.lane), max(ruler.cells, default=0))
    open_minutes = {(part.minute, part.version): part for part in minutes}
    for needed in {minute, *(way[3] // MINUTE_US for way in ways)}:
        if (needed, ruler.version) not in open_minutes and needed > minute - OPEN_MINUTES:
            blank = MinuteCells(
                needed,
                ruler.version,
                ruler.lane,
                ruler.length_m,
                ruler.cell_m,
                np.zeros(shape),
                np.zeros(shape),
            )
            open_minutes[needed, ruler.version] = blank
    fresh = {
        key: replace(part, distance_m=part.distance_m.copy(), time_s=part.time_s.copy())
        for key, part in open_minutes.items()
        if key[1] == ruler.version
    }
    for lane, begin_m, end_m, begin_us in ways:
        for cell, which, distance_m, seconds in _pieces(begin_m, end_m, begin_us, time_us, ruler.cell_m):
            part = fresh.get((which, ruler.version))
            if part is not None and 0 <= cell < ruler.cells[lane]:
                part.distance_m[lane, cell] += distance_m
                part.time_s[lane, cell] += seconds
    merged = open_minutes | fresh
    return tuple(merged[key] for key in sorted(merged))


def _pieces(
    begin_m: float, end_m: float, begin_us: int, end_us: int, cell_m: float
) -> Iterator[tuple[int, int, float, float]]:
    """Yield cell, minute, metres and seconds of the pieces of a way, cut at the edges of both."""
    first, last = int(begin_m // cell_m), int(end_m // cell_m)
    minute, last_minute = begin_us // MINUTE_US, end_us // MINUTE_US
    span_us, span_m = end_us - begin_us, end_m - begin_m
    if first == last and minute == last_minute:
        yield first, minute, span_m, span_us / 1e6
        return
    cuts = {0.0, 1.0}
    low, high = sorted((first, last))
    cuts.update((edge * cell_m - begin_m) / span_m for edge in range(low + 1, high + 1) if span_m)
    cuts.update((edge * MINUTE_US - begin_us) / span_us for edge in range(minute + 1, last_minute + 1))
    ordered = sorted(cut for cut in cuts if 0.0 <= cut <= 1.0)
    for a, b in pairwise(ordered):
        middle = (a + b) / 2
        cell = int((begin_m + middle * span_m) // cell_m)
        which = int((begin_us + middle * span_us) // MINUTE_US)
        yield cell, which, (b - a) * span_m, (b - a) * span_us / 1e6


def cell_records(part: MinuteCells) -> U8:
    """Return the cells of a minute in which somebody drove, as records (N, CELL.itemsize)."""
    lane, cell = np.nonzero(part.time_s > 0)
    table = np.zeros(len(lane), CELL)
    table["lane"] = np.array(part.lane, dtype=np.int64)[lane]
    table["cell"] = cell
    ends = np.array(part.length_m)[lane]
    table["length_m"] = np.minimum(part.cell_m, ends - cell * part.cell_m)
    table["distance_m"] = np.round(part.distance_m[lane, cell], 3)
    table["time_s"] = np.round(part.time_s[lane, cell], 3)
    return table.view(np.uint8).reshape(-1, CELL.itemsize)
