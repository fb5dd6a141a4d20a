"""Judge in which lane each vehicle drives, with hysteresis, and when it crossed from one into another.

A vehicle stays in its lane until its centre has been well past the boundary for a while; the change is then
dated back to when the centre crossed the boundary. Where a lane ends the vehicle goes on in the next without
a change: that was no decision of its driver.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.kernel import kernel, part
from service.tracking.model import F32, F64, I64, U8
from service.traffic.measured import ACROSS_STD, HEADING, VX, VY, Measured, X, Y
from service.traffic.model import LaneChange, LaneMap, Moment, Samples
from service.traffic.vehicles import (
    CANDIDATE,
    CROSSED_US,
    CROSSED_X,
    CROSSED_Y,
    ENTERED_US,
    LANE,
    LAST_X,
    LAST_Y,
    PAST_US,
    SEEN_US,
    Vehicles,
)


@dataclass(frozen=True, slots=True)
class AssignmentParameters:
    """When a vehicle is in a lane, and when it has changed."""

    past_boundary_m: float = 0.3  # that the centre must be past the boundary, at least ...
    past_boundary_stds: float = 0.7  # ... and so many standard deviations of its place ...
    hold_s: float = 0.4  # ... for so long ...
    travel_m: float = 2.0  # ... and so much of its way: a standing vehicle changes no lane
    settle_s: float = 0.25  # before, the lane of a new track is a guess, and another lane only a better one
    enter_m: float = 0.3  # beyond its half width a lane takes in a vehicle ...
    outside_m: float = 0.9  # ... and holds one
    angle_deg: float = 40.0  # a vehicle at a larger angle to a lane only crosses it
    against_m: float = 1.0  # that a lane of the other direction must be nearer


@dataclass(frozen=True, slots=True)
class Chart:
    """A lane map as flat arrays: L lanes with N points in all."""

    index: I64  # (L,) of the lane
    first: I64  # (L + 1,) first point of each lane
    point: F64  # (N, 3) x, y, half width
    box: F64  # (L, 4) x and y from, x and y to, of what can lie in the lane


def chart_of(lane_map: LaneMap) -> Chart:
    """Return a map as the kernel reads it."""
    lanes = lane_map.lanes
    parts = [_prolonged(np.column_stack([lane.points_m, 0.5 * lane.width_m])) for lane in lanes]
    first = np.cumsum([0, *(len(part) for part in parts)])
    boxes = [
        np.concatenate([part[:, :2].min(axis=0) - REACH_M, part[:, :2].max(axis=0) + REACH_M])
        for part in parts
    ]
    return Chart(
        index=np.array([lane.index for lane in lanes], dtype=np.int64),
        first=first.astype(np.int64),
        point=np.concatenate([np.zeros((0, 3)), *parts]),
        box=np.array(boxes).reshape(-1, 4),
    )


def _prolonged(lane: F64) -> F64:
    """Return a lane with a straight piece before and behind it."""
    before, behind = lane[0] - lane[1], lane[-1] - lane[-2]
    for way in (before, behind):
        way[:2] *= PROLONGED_M / np.hypot(way[0], way[1])
        way[2] = 0.0
    return np.concatenate([[lane[0] + before], lane, [lane[-1] + behind]])


REACH_M = 6.0  # beyond the middle of any lane nothing belongs to it
PROLONGED_M = 12.0  # so far beyond its ends a lane goes on where there is no other
_PROLONGED_COST_M = 5.0  # ... and any other is nearer, ...
_PROLONGED_SHARE = 0.5  # ... and so much of its width is known to be of it: nothing was learned there


def assign(  # noqa: PLR0913, PLR0917 - the state, the frame, the map
    vehicles: Vehicles,
    moment: Moment,
    now: Measured,
    chart: Chart,
    version: int,
    p: AssignmentParameters,
) -> tuple[U8, tuple[LaneChange, ...]]:
    """Return the lane (T,) of each track and the changes that are sure now; writes into `vehicles`.

    Where a track merely coasts its lane stays: nobody saw where it drives.
    """
    changes: tuple[LaneChange, ...] = ()
    if len(now.row) and len(chart.index) and not moment.tick:
        time = np.full(len(now.row), moment.time_us)
        rows = (now.real[X], now.real[Y], now.real[HEADING], now.real[ACROSS_STD])
        _, whole, real = _judged(vehicles, now.row, time, rows, chart, p)
        if len(whole):
            speed = np.hypot(now.real[VX].astype(np.float32), now.real[VY].astype(np.float32))
            changes = _changes(vehicles, whole, real, speed, version)
    return vehicles.whole[:, LANE].astype(np.uint8), changes


def retrace(
    vehicles: Vehicles, samples: Samples, chart: Chart, version: int, p: AssignmentParameters
) -> tuple[U8, tuple[LaneChange, ...]]:
    """Return the lane (S,) at each sample of the listed tracks, and their changes; writes into `vehicles`."""
    slot = np.searchsorted(vehicles.number, samples.number)
    f = np.float64
    vx, vy = samples.vx_mps.astype(f), samples.vy_mps.astype(f)
    rows = (samples.x_m.astype(f), samples.y_m.astype(f), np.arctan2(vx, vy), samples.across_std_m.astype(f))
    lane, whole, real = _judged(vehicles, slot, samples.time_us, rows, chart, p)
    return lane, _changes(vehicles, whole, real, np.hypot(vx, vy), version)


def unfinished(gone: Vehicles, now_us: int, version: int, p: AssignmentParameters) -> tuple[LaneChange, ...]:
    """Return the changes that vehicles which are followed no more were about to make: past the boundary."""
    whole, real = gone.whole, gone.real
    if not len(whole):
        return ()
    over = (whole[:, CANDIDATE] > 0) & (whole[:, PAST_US] > 0)
    over &= whole[:, CROSSED_US] - whole[:, ENTERED_US] >= 1e6 * p.settle_s
    return tuple(
        LaneChange(
            number=int(gone.number[i]), time_us=int(whole[i, CROSSED_US]), decided_us=now_us,
            from_lane=int(whole[i, LANE]), to_lane=int(whole[i, CANDIDATE]), x_m=float(real[i, CROSSED_X]),
            y_m=float(real[i, CROSSED_Y]), speed_mps=math.nan, map_version=version,
        )
        for i in np.flatnonzero(over).tolist()
    )  # fmt: skip


def _judged(  # noqa: PLR0913, PLR0917 - likewise
    vehicles: Vehicles,
    slot: I64,
    time_us: I64,
    rows: tuple[F64, F64, F64, F64],
    chart: Chart,
    p: AssignmentParameters,
) -> tuple[U8, I64, F64]:
    """Return the lane of each row, and of each change found: row, slot, times, lanes; place."""
    lane = np.zeros(len(slot), dtype=np.uint8)
    whole, real = np.empty((len(slot), 6), dtype=np.int64), np.empty((len(slot), 2))
    count = _judge(
        slot, time_us, *rows, vehicles.whole, vehicles.real, chart.index, chart.first, chart.point, chart.box,
        (p.past_boundary_m, p.past_boundary_stds, p.travel_m, p.enter_m, p.outside_m,
         math.cos(math.radians(p.angle_deg)), p.against_m),
        (int(1e6 * p.hold_s), int(1e6 * p.settle_s)),
        lane, whole, real,
    )  # fmt: skip
    return lane, whole[:count], real[:count]


def _changes(
    vehicles: Vehicles, whole: I64, real: F64, speed_mps: F32 | F64, version: int
) -> tuple[LaneChange, ...]:
    return tuple(
        LaneChange(
            number=int(vehicles.number[slot]), time_us=crossed_us, decided_us=decided_us, from_lane=before,
            to_lane=after, x_m=x, y_m=y, speed_mps=float(speed_mps[row]), map_version=version,
        )
        for (row, slot, crossed_us, decided_us, before, after), (x, y) in zip(
            whole.tolist(), real.tolist(), strict=True
        )
    )  # fmt: skip


@part
def _offset(  # noqa: PLR0913, PLR0917 - numbers of one kernel
    x: float, y: float, heading: float, first: int, last: int, point: F64, least_cos: float, against: float
) -> tuple[float, float, float]:
    """Return distance to a lane's middle, the same with its penalties, and half the width.

    The distance is -1 where the place is not beside the lane or the heading across it.
    """
    best, where, share = 1e30, first, 0.0
    for k in range(first, last - 1):
        ex, ey = point[k + 1, 0] - point[k, 0], point[k + 1, 1] - point[k, 1]
        px, py = x - point[k, 0], y - point[k, 1]
        u = (px * ex + py * ey) / (ex * ex + ey * ey)
        c = min(max(u, 0.0), 1.0)
        away = (px - c * ex) ** 2 + (py - c * ey) ** 2
        if away < best:
            best, where, share = away, k, u
    if (where == first and share < 0.0) or (where == last - 2 and share > 1.0):
        return -1.0, -1.0, 0.0
    ex, ey = point[where + 1, 0] - point[where, 0], point[where + 1, 1] - point[where, 1]
    cosine = (math.sin(heading) * ex + math.cos(heading) * ey) / math.hypot(ex, ey)
    if abs(cosine) < least_cos:
        return -1.0, -1.0, 0.0
    distance, half = math.sqrt(best), point[where, 2]
    cost = distance + (against if cosine < 0.0 else 0.0)
    if where == first or where == last - 2:
        cost, half = cost + _PROLONGED_COST_M, half * _PROLONGED_SHARE
    return distance, cost, half


@kernel
def _judge(  # noqa: C901, PLR0912, PLR0913, PLR0915, PLR0917 - one pass over the rows; arrays are its language
    slot: I64, time_us: I64, xs: F64, ys: F64, headings: F64, stds: F64, whole: I64, real: F64, index: I64,
    first: I64, point: F64, box: F64, limits: tuple[float, ...], waits: tuple[int, int], lane_out: U8,
    change_whole: I64, change_real: F64,
) -> int:  # fmt: skip
    past_m, past_stds, travel_m, enter_m, outside_m, least_cos, against = limits
    hold_us, settle_us = waits
    changes = 0
    for r in range(len(slot)):
        i, x, y, heading, now = slot[r], xs[r], ys[r], headings[r], time_us[r]
        mine, held, ended = whole[i, LANE], -1, False
        best, best_cost, mine_off, mine_half = -1, 1e30, -1.0, 0.0
        for k in range(len(index)):
            if x < box[k, 0] or y < box[k, 1] or x > box[k, 2] or y > box[k, 3]:
                continue
            off, cost, half = _offset(x, y, heading, first[k], first[k + 1], point, least_cos, against)
            if off < 0.0:
                continue
            if index[k] == mine:
                held, mine_off, mine_half, ended = k, off, half, cost >= _PROLONGED_COST_M
            reach = half + (outside_m if index[k] == mine else enter_m)
            if off <= reach and cost < best_cost:
                best, best_cost = k, cost
        lost = best < 0 and mine_off > mine_half + outside_m
        if held < 0 or lost or (ended and best >= 0 and best != held):
            whole[i, LANE] = index[best] if best >= 0 else 0
            whole[i, ENTERED_US] = now
            whole[i, CANDIDATE] = 0
            whole[i, PAST_US] = 0
        elif best < 0 or best == held:
            whole[i, CANDIDATE] = 0
            whole[i, PAST_US] = 0
        else:
            best_off = _offset(x, y, heading, first[best], first[best + 1], point, least_cos, against)[0]
            margin = mine_off - best_off
            if whole[i, CANDIDATE] != index[best]:
                whole[i, CANDIDATE] = index[best]
                whole[i, PAST_US] = 0
                whole[i, CROSSED_US] = now
                real[i, CROSSED_X], real[i, CROSSED_Y] = x, y
                lx, ly = real[i, LAST_X], real[i, LAST_Y]
                a = _offset(lx, ly, heading, first[held], first[held + 1], point, least_cos, against)[0]
                b = _offset(lx, ly, heading, first[best], first[best + 1], point, least_cos, against)[0]
                if not (a >= 0.0 and b >= a and whole[i, SEEN_US] > 0):
                    whole[i, CROSSED_US] = 0  # it was not seen on this side: a lane begins here
                elif margin > 0.0:
                    share = margin / (margin + b - a)  # of the way since the last sample, seen from now
                    whole[i, CROSSED_US] = now - np.int64(share * (now - whole[i, SEEN_US]))
                    real[i, CROSSED_X], real[i, CROSSED_Y] = x + share * (lx - x), y + share * (ly - y)
            travelled = math.hypot(x - real[i, CROSSED_X], y - real[i, CROSSED_Y])
            if margin < 2.0 * max(past_m, past_stds * stds[r]):
                whole[i, PAST_US] = 0
            elif whole[i, PAST_US] == 0:
                whole[i, PAST_US] = now
            elif now - whole[i, PAST_US] >= hold_us and travelled >= travel_m:
                if whole[i, CROSSED_US] - whole[i, ENTERED_US] >= settle_us:
                    row = change_whole[changes]
                    row[0], row[1], row[2], row[3] = r, i, whole[i, CROSSED_US], now
                    row[4], row[5] = mine, index[best]
                    change_real[changes, 0], change_real[changes, 1] = real[i, CROSSED_X], real[i, CROSSED_Y]
                    changes += 1
                else:
                    whole[i, ENTERED_US] = now
                whole[i, LANE] = index[best]
                whole[i, CANDIDATE] = 0
                whole[i, PAST_US] = 0
        whole[i, SEEN_US] = now
        real[i, LAST_X], real[i, LAST_Y] = x, y
        lane_out[r] = whole[i, LANE]
    return changes
