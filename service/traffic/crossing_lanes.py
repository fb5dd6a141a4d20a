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

from service.tracking.model import F64, I64, Bool
from service.traffic.cells import Ruler
from service.traffic.count_parameters import CountParameters
from service.traffic.lane_places import lanes_at
from service.traffic.lines import Line
from service.traffic.model import NO_LANE
from service.traffic.records import DECIMALS, MINUTE_US, Leader, MinuteBlock

_SLOW_MPS = 1.0  # below, the time from bumper to centre is taken as at this speed


def way_across(line: Line, direction: int) -> F64:
    """Return the unit vector (2,) at right angles to a line that points to where a vehicle went."""
    dx, dy = line.x1_m - line.x0_m, line.y1_m - line.y0_m
    return np.array([-dy, dx]) * direction / math.hypot(dx, dy)


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
