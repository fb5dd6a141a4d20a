"""In which lane a vehicle was as it crossed a line: by its place there, told when it is behind the line.

The lane that a vehicle has from frame to frame follows it with hysteresis, so that near a boundary it is the
one of a moment ago; at a line the place itself decides. Crossings from before the first map get their lanes
when a map comes, as long as their minutes are open.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.tracking.kernel import kernel, part
from service.tracking.model import F64, I64, Bool
from service.traffic.cells import Ruler
from service.traffic.count_parameters import CountParameters
from service.traffic.lines import Line
from service.traffic.model import NO_LANE
from service.traffic.records import DECIMALS, MINUTE_US, Leader, MinuteBlock

_LEAST_COSINE = math.cos(math.radians(50.0))  # between a lane and the way across the line
_AGAINST_M = 1.0  # that a lane of the other direction must be nearer
_SLOW_MPS = 1.0  # below, the time from bumper to centre is taken as at this speed


def way_across(line: Line, direction: int) -> F64:
    """Return the unit vector (2,) at right angles to a line that points to where a vehicle went."""
    dx, dy = line.x1_m - line.x0_m, line.y1_m - line.y0_m
    return np.array([-dy, dx]) * direction / math.hypot(dx, dy)


def lanes_at(place_m: F64, way: F64, lane: I64, ruler: Ruler, *, stay: bool = False) -> I64:
    """Return the lane (N,) of places (N, 2) on lines: the nearest that goes that way, else the one it had.

    way: (N, 2) unit vectors across the lines; lane: (N,) that the vehicles had; stay: it keeps those that lie
    inside of it.
    """
    found = lane.copy()
    _lanes_at(
        place_m, way, found, np.array(ruler.lane, dtype=np.int64), ruler.first, ruler.points_m,
        ruler.half_width_m, ruler.turn, stay,
    )  # fmt: skip
    return found


@kernel
def _lanes_at(  # noqa: PLR0913, PLR0917 - arrays are a kernel's language
    place: F64, way: F64, found: I64, index: I64, first: I64, points: F64, half_width: F64, turn: Bool,
    stay: bool,  # noqa: FBT001 - a kernel has no names for its arguments
) -> None:  # fmt: skip
    """Write the lane of each place over the one that its vehicle had."""
    for i in range(len(place)):
        lane, best, nearest, mine = found[i], NO_LANE, math.inf, math.inf
        for k in range(len(index)):
            away, cosine = _beside_lane(place[i], way[i], first[k], first[k + 1], points)
            if away < 0.0 or abs(cosine) < _LEAST_COSINE:
                continue
            if index[k] == lane:
                mine = away
                if turn[k] or (stay and away <= half_width[k]):
                    best = NO_LANE  # ways through a junction lie upon one another
                    break
            if away > half_width[k] or turn[k]:
                continue
            cost = away + (_AGAINST_M if cosine < 0.0 else 0.0)
            if cost < nearest:
                best, nearest = index[k], cost
        if best != NO_LANE and (lane == NO_LANE or nearest < mine):
            found[i] = best


@part
def _beside_lane(place: F64, way: F64, first: int, end: int, points: F64) -> tuple[float, float]:
    """Return the distance from a lane, -1 beyond its ends, and the cosine of its heading there to a way."""
    best, where, share = 1e30, first, 0.0
    for k in range(first, end - 1):
        ex, ey = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
        px, py = place[0] - points[k, 0], place[1] - points[k, 1]
        square = ex * ex + ey * ey
        u = (px * ex + py * ey) / square if square > 0.0 else 0.0
        c = min(max(u, 0.0), 1.0)
        away = (px - c * ex) ** 2 + (py - c * ey) ** 2
        if away < best:
            best, where, share = away, k, u
    if (where == first and share < 0.0) or (where == end - 2 and share > 1.0):
        return -1.0, 0.0
    heading = math.atan2(points[where + 1, 0] - points[where, 0], points[where + 1, 1] - points[where, 1])
    return math.sqrt(best), math.sin(heading) * way[0] + math.cos(heading) * way[1]


def passing_s(length_m: float, speed_mps: float, p: CountParameters) -> float:
    """Return the time from the front to the rear bumper over a line."""
    return (p.assumed_length_m if math.isnan(length_m) else length_m) / max(speed_mps, _SLOW_MPS)


def relabelled(
    blocks: Sequence[MinuteBlock],
    leaders: Sequence[Leader],
    lines: Sequence[Line],
    ruler: Ruler,
    p: CountParameters,
) -> tuple[tuple[MinuteBlock, ...], tuple[MinuteBlock, ...], tuple[Leader, ...]]:
    """Return the blocks with lanes for crossings that had none, those that are others now, the leaders.

    A lane that a new map cuts keeps its number on one part; crossings elsewhere get the number of theirs.
    """
    by_id = {line.line_id: line for line in lines}
    open_blocks = {(block.line_id, block.minute, block.part): block for block in blocks}
    known = {(x.line_id, x.lane, x.direction): x for x in leaders}
    changed: dict[tuple[str, int, int], MinuteBlock] = {}
    for line_id in sorted({block.line_id for block in blocks} & by_id.keys()):
        mine = [block for block in blocks if block.line_id == line_id]
        table = np.concatenate([block.table() for block in mine])
        minute = np.repeat([block.minute for block in mine], [len(block.records) for block in mine])
        fresh = _with_lanes(table, by_id[line_id], ruler)
        if not fresh.any():
            continue
        _follow_again(line_id, minute, table, fresh, known, p)
        begin = 0
        for block in mine:
            end = begin + len(block.records)
            if fresh[begin:end].any():
                records = table[begin:end].copy().view(np.uint8).reshape(end - begin, -1)
                key = (block.line_id, block.minute, block.part)
                changed[key] = open_blocks[key] = replace(block, records=records)
            begin = end
    return tuple(open_blocks.values()), tuple(changed.values()), tuple(known.values())


def _with_lanes(table: NDArray[np.void], line: Line, ruler: Ruler) -> Bool:
    """Write the lanes of a new map into the records; return which have another than before."""
    place = np.column_stack([table["x_m"], table["y_m"]]).astype(np.float64)
    way = table["direction"][:, None] * way_across(line, 1)
    before = table["lane"].astype(np.int64)
    lane = lanes_at(place, way, before, ruler, stay=True)
    fresh = lane != before
    table["lane"][fresh], table["map_version"][fresh] = lane[fresh], ruler.version
    table["headway_s"][fresh] = table["gap_s"][fresh] = np.nan  # to one in the lane that it had
    return np.asarray(fresh)


def _follow_again(  # noqa: PLR0913, PLR0917 - a line's records and whom they follow
    line_id: str,
    minute: I64,
    table: NDArray[np.void],
    fresh: Bool,
    leaders: dict[tuple[str, int, int], Leader],
    p: CountParameters,
) -> None:
    """Write headways and gaps of records that have a lane now, and the last of each lane into `leaders`."""
    names = ("time_us", "length_m", "speed_mps", "lane", "direction")
    columns = (minute.tolist(), *(table[name].tolist() for name in names))
    rows = []
    for i, (at, time_us, length_m, speed_mps, lane, direction) in enumerate(zip(*columns, strict=True)):
        if lane != NO_LANE:
            passing = passing_s(length_m, speed_mps, p)
            rows.append((at * MINUTE_US + time_us - round(passing / 2 * 1e6), passing, i, lane, direction))
    before: dict[tuple[str, int, int], Leader] = {}
    for front_us, passing, i, lane, direction in sorted(rows):
        key = (line_id, lane, direction)
        leader = before.get(key)
        if fresh[i] and leader is not None and front_us > leader.front_us:
            headway_s = (front_us - leader.front_us) / 1e6
            table["headway_s"][i] = round(headway_s, DECIMALS)
            table["gap_s"][i] = round(headway_s - leader.passing_s, DECIMALS)
        before[key] = Leader(*key, front_us, passing)
    for key, leader in before.items():
        if key not in leaders or leaders[key].front_us < leader.front_us:
            leaders[key] = leader
