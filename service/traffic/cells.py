"""Add up, cell by cell of the lanes, how far and how long vehicles drove: what Edie's measures are made of.

A cell is a piece of a lane, `cell_m` long along its centre line. Each vehicle's way from one measurement to
the next is a straight line in place along the lane over time, cut exactly at the edges of cells and minutes;
a gap that the tracker bridged, or that stitching did, is such a way, too. Distances are signed, so that the
trembling of a standing vehicle adds up to nothing.

Source: Edie, L. C., "Discussion of traffic stream measurements and definitions", 1963.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, U8
from service.traffic.model import MOST_LANES, LaneMap
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
    first: I64  # (L + 1,) first point of each lane
    points_m: F64  # (P, 2) of all lanes
    cells: tuple[int, ...]
    length_m: tuple[float, ...]
    cell_m: float


NO_RULER = Ruler(0, (), np.zeros(1, dtype=np.int64), np.zeros((0, 2)), (), (), 0.0)


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
        first=np.cumsum([0, *(len(lane.points_m) for lane in lanes.lanes)]),
        points_m=np.concatenate([np.zeros((0, 2)), *(lane.points_m for lane in lanes.lanes)]),
        cells=tuple(int(np.ceil(metres / cell_m)) for metres in length),
        length_m=length,
        cell_m=cell_m,
    )


def drive(
    minutes: tuple[MinuteCells, ...], ruler: Ruler, joined: Joined, lane: U8, time_us: int
) -> tuple[MinuteCells, ...]:
    """Return the open minutes with the ways that ended in this scan; lane: (T,) of its tracks."""
    if not ruler.lane:
        return minutes
    place = np.full(MOST_LANES + 1, -1)  # of each lane in the ruler
    place[list(ruler.lane)] = np.arange(len(ruler.lane))
    known = joined.measured >= 0
    if joined.origin is not None:
        known &= joined.origin >= 0
    rows = np.flatnonzero(known)
    which = place[lane[joined.measured[rows]]]
    order = np.argsort(which, kind="stable")
    order = order[which[order] >= 0]
    rows, which = rows[order], which[order]
    x, y = joined.vehicles.real[:2].take(rows, axis=1)
    begin, end = _along(
        ruler.points_m, ruler.first, np.concatenate((which, which)),
        np.concatenate((joined.from_x_m[rows], x)), np.concatenate((joined.from_y_m[rows], y)),
    ).reshape(2, -1)  # fmt: skip
    return _added(minutes, ruler, Ways(which, begin, end, joined.from_us[rows]), time_us)


@dataclass(frozen=True, slots=True)
class Ways:
    """What N vehicles drove from one measurement to the next, by lane."""

    lane: I64  # (N,) place in the ruler
    begin_m: F64  # along the lane
    end_m: F64
    begin_us: I64


def along(points_m: F64, x_m: F64, y_m: F64) -> F64:
    """Return (N,) how far along a polyline the foot of each point lies; its ends go on straight."""
    first, lane = np.array([0, len(points_m)]), np.zeros(len(x_m), dtype=np.int64)
    return _along(
        np.ascontiguousarray(points_m), first, lane, np.array(x_m, np.float64), np.array(y_m, np.float64)
    )


@kernel
def _along(points: F64, first: I64, lane: I64, xs: F64, ys: F64) -> F64:
    """Return how far along its lane the foot of each point lies."""
    out = np.empty(len(lane))
    for i in range(len(lane)):
        x, y, begin, last = xs[i], ys[i], first[lane[i]], first[lane[i] + 1] - 1
        nearest, start = np.inf, 0.0
        for k in range(begin, last):
            ex, ey = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
            dx, dy = x - points[k, 0], y - points[k, 1]
            length = math.hypot(ex, ey)
            place = (dx * ex + dy * ey) / length
            inside = min(max(place, 0.0), length)
            away = math.hypot(dx - inside * ex / length, dy - inside * ey / length)
            if away < nearest:
                nearest = away
                beyond = (k == begin and place < 0.0) or (k == last - 1 and place > length)
                out[i] = start + (place if beyond else inside)
            start += length
    return out


def _added(
    minutes: tuple[MinuteCells, ...], ruler: Ruler, ways: Ways, time_us: int
) -> tuple[MinuteCells, ...]:
    minute = time_us // MINUTE_US
    begun = ways.begin_us // MINUTE_US
    open_minutes = {(part.minute, part.version): part for part in minutes}
    needed = {minute} if not len(begun) or begun.min() == minute else {minute, *begun.tolist()}
    for which in needed:
        if (which, ruler.version) not in open_minutes and which > minute - OPEN_MINUTES:
            open_minutes[which, ruler.version] = _blank(which, ruler)
    first, last = ways.begin_m // ruler.cell_m, ways.end_m // ruler.cell_m
    whole = (first == last) & (begun == minute)  # inside one cell and minute: nearly all
    driven, spent = ways.end_m - ways.begin_m, (time_us - ways.begin_us) / 1e6
    table = np.column_stack([ways.lane, first, begun, driven, spent])
    if not whole.all():
        table = np.concatenate([
            table[i : i + 1] if whole[i] else _cut(ways, i, time_us, ruler.cell_m) for i in range(len(whole))
        ])  # fmt: skip
    lane, cell, which = table[:, :3].astype(np.int64).T
    inside = (cell >= 0) & (cell < np.array(ruler.cells)[lane])
    for key, part in open_minutes.items():
        mine = inside & (which == key[0])
        if key[1] == ruler.version and mine.any():
            distance_m, time_s = part.distance_m.copy(), part.time_s.copy()
            np.add.at(distance_m, (lane[mine], cell[mine]), table[mine, 3])
            np.add.at(time_s, (lane[mine], cell[mine]), table[mine, 4])
            open_minutes[key] = replace(part, distance_m=distance_m, time_s=time_s)
    return tuple(open_minutes[key] for key in sorted(open_minutes))


def _blank(minute: int, ruler: Ruler) -> MinuteCells:
    """Return a minute in which nobody has driven yet."""
    shape = (len(ruler.lane), max(ruler.cells, default=0))
    return MinuteCells(
        minute, ruler.version, ruler.lane, ruler.length_m, ruler.cell_m, np.zeros(shape), np.zeros(shape)
    )


def _cut(ways: Ways, i: int, time_us: int, cell_m: float) -> F64:
    """Return the pieces (N, 5) of one way: lane, cell, minute, metres, seconds."""
    ends = float(ways.begin_m[i]), float(ways.end_m[i]), int(ways.begin_us[i]), time_us
    return np.array([(ways.lane[i], *piece) for piece in _pieces(*ends, cell_m)]).reshape(-1, 5)


def _pieces(
    begin_m: float, end_m: float, begin_us: int, end_us: int, cell_m: float
) -> Iterator[tuple[int, int, float, float]]:
    """Yield cell, minute, metres and seconds of the pieces of a way, cut at the edges of both."""
    first, last = int(begin_m // cell_m), int(end_m // cell_m)
    minute, last_minute = begin_us // MINUTE_US, end_us // MINUTE_US
    span_us, span_m = end_us - begin_us, end_m - begin_m
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
