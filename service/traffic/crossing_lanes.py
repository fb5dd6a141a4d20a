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

from service.tracking.model import F64
from service.traffic.count_parameters import CountParameters
from service.traffic.curves import beside
from service.traffic.lines import Line
from service.traffic.model import NO_LANE, LaneMap
from service.traffic.records import DECIMALS, MINUTE_US, Leader, MinuteBlock

_LEAST_COSINE = math.cos(math.radians(50.0))  # between a lane and the way across the line
_AGAINST_M = 1.0  # that a lane of the other direction must be nearer
_SLOW_MPS = 1.0  # below, the time from bumper to centre is taken as at this speed


def way_across(line: Line, direction: int) -> F64:
    """Return the unit vector (2,) at right angles to a line that points to where a vehicle went."""
    dx, dy = line.x1_m - line.x0_m, line.y1_m - line.y0_m
    return np.array([-dy, dx]) * direction / math.hypot(dx, dy)


def lane_at(x_m: float, y_m: float, way: F64, lane: int, lanes: LaneMap) -> int:
    """Return the lane of a place on a line: the nearest that goes that way, else the lane it had, `lane`."""
    place = np.array([[x_m, y_m]], dtype=np.float64)
    best, nearest, mine = NO_LANE, math.inf, math.inf
    for candidate in lanes.lanes:
        foot = beside(place, candidate.points_m)
        cosine = math.sin(foot.heading_rad[0]) * way[0] + math.cos(foot.heading_rad[0]) * way[1]
        if foot.beyond[0] or abs(cosine) < _LEAST_COSINE:
            continue
        away = abs(float(foot.right_m[0]))
        if candidate.index == lane:
            mine = away
            if candidate.kind == "turn":
                return lane  # ways through a junction lie upon one another
        if away > float(np.median(candidate.width_m)) / 2 or candidate.kind == "turn":
            continue
        cost = away + (_AGAINST_M if cosine < 0 else 0.0)
        if cost < nearest:
            best, nearest = candidate.index, cost
    return best if best and (lane == NO_LANE or nearest < mine) else lane


def passing_s(length_m: float, speed_mps: float, p: CountParameters) -> float:
    """Return the time from the front to the rear bumper over a line."""
    return (p.assumed_length_m if math.isnan(length_m) else length_m) / max(speed_mps, _SLOW_MPS)


def relabelled(
    blocks: Sequence[MinuteBlock],
    leaders: Sequence[Leader],
    lines: Sequence[Line],
    lanes: LaneMap,
    p: CountParameters,
) -> tuple[tuple[MinuteBlock, ...], tuple[MinuteBlock, ...], tuple[Leader, ...]]:
    """Return the blocks with lanes for crossings that had none, those that are others now, the leaders."""
    by_id = {line.line_id: line for line in lines}
    open_blocks = {(block.line_id, block.minute, block.part): block for block in blocks}
    known = {(x.line_id, x.lane, x.direction): x for x in leaders}
    changed: dict[tuple[str, int, int], MinuteBlock] = {}
    for line_id in sorted({block.line_id for block in blocks} & by_id.keys()):
        mine = [block for block in blocks if block.line_id == line_id]
        tables = [block.table().copy() for block in mine]
        fresh = [_with_lanes(table, by_id[line_id], lanes) for table in tables]
        if any(mask.any() for mask in fresh):
            _follow_again(mine, tables, fresh, known, p)
        for block, table, mask in zip(mine, tables, fresh, strict=True):
            if mask.any():
                records = table.view(np.uint8).reshape(len(table), -1)
                key = (block.line_id, block.minute, block.part)
                changed[key] = open_blocks[key] = replace(block, records=records)
    return tuple(open_blocks.values()), tuple(changed.values()), tuple(known.values())


def _with_lanes(table: NDArray[np.void], line: Line, lanes: LaneMap) -> NDArray[np.bool_]:
    """Write lanes into the records that have none; return which have one now."""
    fresh = np.zeros(len(table), dtype=np.bool_)
    for row in np.flatnonzero(table["lane"] == NO_LANE):
        way = way_across(line, int(table["direction"][row]))
        lane = lane_at(float(table["x_m"][row]), float(table["y_m"][row]), way, NO_LANE, lanes)
        if lane != NO_LANE:
            table["lane"][row], table["map_version"][row], fresh[row] = lane, lanes.version, True
    return fresh


def _follow_again(
    blocks: Sequence[MinuteBlock],
    tables: Sequence[NDArray[np.void]],
    fresh: Sequence[NDArray[np.bool_]],
    leaders: dict[tuple[str, int, int], Leader],
    p: CountParameters,
) -> None:
    """Write headways and gaps of records that have a lane now, and the last of each lane into `leaders`."""
    rows = [
        (block.minute * MINUTE_US + int(record["time_us"]) - round(passing / 2 * 1e6), passing, k, i)
        for k, (block, table) in enumerate(zip(blocks, tables, strict=True))
        for i, record in enumerate(table)
        for passing in (passing_s(float(record["length_m"]), float(record["speed_mps"]), p),)
        if record["lane"] != NO_LANE
    ]
    before: dict[tuple[str, int, int], Leader] = {}
    for front_us, passing, k, i in sorted(rows):
        record = tables[k][i]
        key = (blocks[k].line_id, int(record["lane"]), int(record["direction"]))
        leader = before.get(key)
        if fresh[k][i] and leader is not None and front_us > leader.front_us:
            headway_s = (front_us - leader.front_us) / 1e6
            record["headway_s"] = round(headway_s, DECIMALS)
            record["gap_s"] = round(headway_s - leader.passing_s, DECIMALS)
        before[key] = Leader(*key, front_us, passing)
    for key, leader in before.items():
        if key not in leaders or leaders[key].front_us < leader.front_us:
            leaders[key] = leader
