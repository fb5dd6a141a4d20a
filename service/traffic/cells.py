"""Add up, cell by cell of the lanes, how far and how long vehicles drove: what Edie's measures are made of.

A cell is a piece of a lane, `cell_m` long along its centre line. Each vehicle's way from one measurement to
the next is a straight line in place along the lane over time, cut exactly at the edges of cells and minutes;
a gap that the tracker bridged, or that stitching did, is such a way, too; so is that from where a vehicle was
lost to where it is listed again. Distances are signed, so that the trembling of a standing vehicle adds up to
nothing.

Source: Edie, L. C., "Discussion of traffic stream measurements and definitions", 1963.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from service.tracking.kernel import kernel, part
from service.tracking.model import F64, I64, U8, Bool
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
    half_width_m: F64  # (L,) half the median width
    turn: Bool  # (L,) ways through a junction
    cells: tuple[int, ...]
    length_m: tuple[float, ...]
    cell_m: float


NO_RULER = Ruler(
    0,
    (),
    np.zeros(1, dtype=np.int64),
    np.zeros((0, 2)),
    np.zeros(0),
    np.zeros(0, dtype=np.bool_),
    (),
    (),
    0.0,
)


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
        half_width_m=np.array([float(np.median(lane.width_m)) / 2 for lane in lanes.lanes]),
        turn=np.array([lane.kind == "turn" for lane in lanes.lanes], dtype=np.bool_),
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
    which, from_us, (x, y) = _lanes(joined, lane, ruler), joined.from_us, joined.vehicles.real[:2]
    now = time_us // MINUTE_US
    parts = {(one.minute, one.version): one for one in minutes}
    current = parts.get((now, ruler.version))
    current = parts[now, ruler.version] = _blank(now, ruler) if current is None else _own(current)
    ways, cut = _drive(
        ruler.points_m, ruler.first, np.array(ruler.cells), which, joined.from_x_m, joined.from_y_m, x, y,
        from_us, time_us, MINUTE_US, ruler.cell_m, current.distance_m, current.time_s,
    )  # fmt: skip
    if len(cut):
        for minute in set((from_us[cut] // MINUTE_US).tolist()):
            if (minute, ruler.version) not in parts and minute > now - OPEN_MINUTES:
                parts[minute, ruler.version] = _blank(minute, ruler)
        own = {now}
        for k in cut.tolist():
            ends = (float(ways[0, k]), float(ways[1, k]), int(from_us[k]), time_us)
            for cell, minute, metres, seconds in _pieces(*ends, ruler.cell_m):
                key = (minute, ruler.version)
                if key not in parts or not 0 <= cell < ruler.cells[which[k]]:
                    continue
                if minute not in own:
                    parts[key] = _own(parts[key])
                    own.add(minute)
                parts[key].distance_m[which[k], cell] += metres
                parts[key].time_s[which[k], cell] += seconds
    return tuple(parts[key] for key in sorted(parts))


def _lanes(joined: Joined, lane: U8, ruler: Ruler) -> I64:
    """Return (V,) the place in the ruler of each vehicle's lane, -1 if it was not measured now."""
    if not len(lane):
        return np.full(len(joined.vehicles), -1)
    which: I64 = _places(ruler.lane)[lane[joined.measured]]
    which[joined.measured < 0] = -1
    return which


@lru_cache(maxsize=256)  # sensors of one process
def _places(lanes: tuple[int, ...]) -> I64:
    """Return the place of each lane's index among these, -1 where it is not."""
    place = np.full(MOST_LANES + 1, -1)
    place[list(lanes)] = np.arange(len(lanes))
    return place


def along(points_m: F64, x_m: F64, y_m: F64) -> F64:
    """Return (N,) how far along a polyline the foot of each point lies; its ends go on straight."""
    points, (x, y) = np.ascontiguousarray(points_m), np.array((x_m, y_m), dtype=np.float64)
    lane, nothing = np.zeros(len(x), dtype=np.int64), np.zeros((1, 0))
    first, cells = np.array([0, len(points)]), np.zeros(1, dtype=np.int64)
    ways, _ = _drive(points, first, cells, lane, x, y, x, y, lane, 0, MINUTE_US, 1.0, nothing, nothing)
    return np.asarray(ways[0])


@part
def _place(points: F64, begin: int, last: int, x: float, y: float) -> float:
    """Return how far along the points begin..last the foot of a place lies."""
    best, where, start, before = np.inf, begin, 0.0, 0.0
    for k in range(begin, last):
        ex, ey = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
        dx, dy = x - points[k, 0], y - points[k, 1]
        square = ex * ex + ey * ey
        share = min(max((dx * ex + dy * ey) / square, 0.0), 1.0)
        away = (dx - share * ex) ** 2 + (dy - share * ey) ** 2
        if away < best:
            best, where, start = away, k, before
        before += math.sqrt(square)
    ex, ey = points[where + 1, 0] - points[where, 0], points[where + 1, 1] - points[where, 1]
    length = math.sqrt(ex * ex + ey * ey)
    place = ((x - points[where, 0]) * ex + (y - points[where, 1]) * ey) / length
    beyond = (where == begin and place < 0.0) or (where == last - 1 and place > length)
    out: float = start + (place if beyond else min(max(place, 0.0), length))
    return out


@kernel
def _drive(  # noqa: PLR0913, PLR0917 - one pass over the ways; arrays are its language
    points: F64, first: I64, cells: I64, lane: I64, from_x: F64, from_y: F64, x: F64, y: F64, from_us: I64,
    time_us: int, minute_us: int, cell_m: float, distance_m: F64, time_s: F64,
) -> tuple[F64, I64]:  # fmt: skip
    """Add the ways (N,) that stay in one cell and the running minute; return all, and which are not added.

    lane: places in the ruler, -1 for none.  Returned (2, N): where each begins and ends along its lane.
    """
    n = len(lane)
    ways, cut, count = np.zeros((2, n)), np.empty(n, np.int64), 0
    for i in range(n):
        k = lane[i]
        if k < 0:
            continue
        begin = _place(points, first[k], first[k + 1] - 1, from_x[i], from_y[i])
        end = _place(points, first[k], first[k + 1] - 1, x[i], y[i])
        ways[0, i], ways[1, i] = begin, end
        cell = math.floor(begin / cell_m)
        if cell != math.floor(end / cell_m) or from_us[i] // minute_us != time_us // minute_us:
            cut[count] = i
            count += 1
        elif 0 <= cell < cells[k]:
            distance_m[k, cell] += end - begin
            time_s[k, cell] += (time_us - from_us[i]) / 1e6
    return ways, cut[:count]


def _own(minute: MinuteCells) -> MinuteCells:
    """Return a minute in arrays of its own."""
    return replace(minute, distance_m=minute.distance_m.copy(), time_s=minute.time_s.copy())


def _blank(minute: int, ruler: Ruler) -> MinuteCells:
    """Return a minute in which nobody has driven yet."""
    shape = (len(ruler.lane), max(ruler.cells, default=0))
    return MinuteCells(
        minute, ruler.version, ruler.lane, ruler.length_m, ruler.cell_m, np.zeros(shape), np.zeros(shape)
    )


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
