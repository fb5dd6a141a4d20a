"""Tell the crossings that nobody saw: of vehicles first seen behind a line, or last seen before it.

At range a vehicle is often hidden when it crosses: others drive before it, or its track begins too late or
ends too early. But vehicles neither come from nowhere nor vanish: on a lane that leads over the line,
between junctions, who drives behind the line must have crossed it. Such a crossing is told where the line is
no more than a few seconds away along the lane at the vehicle's own speed, in time that was observed, and when
nobody was counted at that place and moment: the vehicle may have been followed before, as another track.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64
from service.traffic.cells import Ruler
from service.traffic.count_parameters import CountParameters
from service.traffic.crossing_lanes import passing_s
from service.traffic.crossings import LineStates, View
from service.traffic.lines import Line, directions
from service.traffic.records import MINUTE_US, Crossing, MinuteBlock
from service.traffic.stitching import Joined, Vehicles
from service.traffic.window import EXISTENCE, LENGTH, VX, VY, X, Y, past_of, samples_of

_SAME_LANE_M = 1.75  # from where one vehicle crosses a line to another in its lane
_RECENT_US, _RECENT = 20_000_000, 3  # crossings that tell how fast the traffic is at a line
_SLOW_MPS = 1.0
_LEAST_COSINE = math.cos(math.radians(30.0))  # between a vehicle's way and its lane


@dataclass(frozen=True, slots=True)
class _Way:
    """How a vehicle stands to a line along its lane."""

    ahead_m: float  # to the line, in the direction in which it drives; negative: behind it
    x_m: float  # where it crosses, or has crossed
    y_m: float
    lane: int
    direction: int


def unseen(  # noqa: PLR0913, PLR0917 - the vehicles before and after, where they stand, and what was told
    before: Vehicles,
    stood: LineStates,
    joined: Joined,
    states: LineStates,
    view: View,
    ruler: Ruler,
    told: Sequence[MinuteBlock],
    since_us: int,
) -> tuple[Crossing, ...]:
    """Return the crossings that must have been since `since_us`; marks them in `states.counted`.

    before, stood: the vehicles before this scan; told: the crossings of the last minutes.
    """
    if not view.lines or not ruler.lane:
        return ()
    found = [
        *_first_seen(joined, states, view, ruler, told),
        *_last_seen(before, stood, joined, view, ruler, told),
    ]
    return tuple(x for x in found if x.time_us >= since_us)


def settled(  # noqa: PLR0913, PLR0917 - what waits, what was told, what is known of time
    waiting: Sequence[Crossing],
    told: Sequence[MinuteBlock],
    found: Sequence[Crossing],
    now_us: int,
    seen_us: int,
    p: CountParameters,
) -> tuple[tuple[Crossing, ...], tuple[Crossing, ...]]:
    """Return what still waits, since others may yet be counted at its place, and what is sure, by time.

    found: the crossings that were seen and became certain now; seen_us: time of the newest frame.
    """
    late = [x for x in waiting if now_us - x.time_us >= 1e6 * p.unseen_wait_s]
    others = list(found)
    for crossing in sorted(late, key=lambda x: (x.time_us, x.track)):
        if crossing.time_us <= seen_us and not _told(crossing, told, others, p):
            others.append(crossing)
    return tuple(x for x in waiting if x not in late), tuple(others[len(found) :])


def _first_seen(
    joined: Joined, states: LineStates, view: View, ruler: Ruler, told: Sequence[MinuteBlock]
) -> Iterator[Crossing]:
    """Yield crossings before their birth of the vehicles that have just been followed for long enough."""
    p, v = view.parameters, joined.vehicles
    least_us = round(p.unseen_life_s * 1e6)
    due = (joined.measured >= 0) & (v.last_us - v.first_us >= least_us)
    due &= joined.from_us - v.first_us < least_us
    due &= v.number == v.vehicle  # a vehicle of several pieces was seen before
    for row in np.flatnonzero(due).tolist():
        number = int(v.number[row])
        samples = samples_of(past_of(view.window), (number,), view.time_us)
        speed = float(np.hypot(samples.real[VX], samples.real[VY]).mean())
        if speed < p.unseen_least_mps:
            continue
        existence = float(samples.real[EXISTENCE].mean())
        pending = {x.line for x in states.pending if x.number == number}
        for line, way in _ways(samples.real[:, 0], view.lines, ruler):
            if (
                states.counted[row, line]
                or line in pending
                or not -p.unseen_behind_s * speed <= way.ahead_m < 0.0
            ):
                continue
            there = _speed_there(view.lines[line].line_id, way, view.time_us, told)
            passed_s = float(samples.time_s[0]) + way.ahead_m * _slowness(speed, there)
            states.counted[row, line] = True
            yield _crossing(
                view, line, way, round(passed_s * 1e3) * 1000 + view.time_us, number, int(samples.frame[0]),
                speed if there is None else there, float(samples.real[LENGTH, -1]), existence,
            )  # fmt: skip


def _last_seen(  # noqa: PLR0913, PLR0917 - as for `unseen`
    before: Vehicles,
    stood: LineStates,
    joined: Joined,
    view: View,
    ruler: Ruler,
    told: Sequence[MinuteBlock],
) -> Iterator[Crossing]:
    """Yield crossings after their last measurement of the vehicles that are given up in this scan."""
    if joined.origin is None or stood.counted.shape[1] != len(view.lines):
        return
    p = view.parameters
    gone = np.ones(len(before), dtype=np.bool_)
    gone[joined.origin[joined.origin >= 0]] = False
    gone &= before.last_us - before.first_us >= round(p.unseen_life_s * 1e6)
    for row in np.flatnonzero(gone).tolist():
        x_m, y_m, vx_mps, vy_mps = before.real[:, row].tolist()
        speed = math.hypot(vx_mps, vy_mps)
        if speed < p.unseen_least_mps:
            continue
        state = np.array([x_m, y_m, vx_mps, vy_mps])
        for line, way in _ways(state, view.lines, ruler):
            if stood.counted[row, line] or not 0.0 < way.ahead_m <= p.unseen_ahead_s * speed:
                continue
            there = _speed_there(view.lines[line].line_id, way, view.time_us, told)
            ahead_s = way.ahead_m * _slowness(speed, there)
            yield _crossing(
                view, line, way, int(before.last_us[row]) + round(ahead_s * 1e3) * 1000,
                int(before.number[row]), view.window[0].frame, speed if there is None else there, math.nan,
                1.0, int(before.vehicle[row]),
            )  # fmt: skip


def _speed_there(line_id: str, way: _Way, now_us: int, told: Sequence[MinuteBlock]) -> float | None:
    """Return the median speed of the last vehicles counted where a vehicle crosses, None without."""
    speeds: list[tuple[int, float]] = []
    for block in told:
        if block.line_id == line_id and block.minute >= now_us // MINUTE_US - 1:
            table = block.table()
            near = np.hypot(table["x_m"] - way.x_m, table["y_m"] - way.y_m) < _SAME_LANE_M
            near &= table["direction"] == way.direction
            rows = table[near]
            times = (block.minute * MINUTE_US + rows["time_us"].astype(np.int64)).tolist()
            speeds += zip(times, rows["speed_mps"].tolist(), strict=True)
    recent = sorted(x for x in speeds if now_us - x[0] <= _RECENT_US)[-_RECENT:]
    return float(np.median([speed for _, speed in recent])) if recent else None


def _slowness(here_mps: float, there_mps: float | None) -> float:
    """Return seconds a metre between two places of known speed."""
    return 1.0 / here_mps if there_mps is None else 0.5 / here_mps + 0.5 / max(there_mps, _SLOW_MPS)


def _crossing(  # noqa: PLR0913, PLR0917 - what is known of it
    view: View, line: int, way: _Way, time_us: int, track: int, frame: int, speed_mps: float, length_m: float,
    existence: float, vehicle: int | None = None,
) -> Crossing:  # fmt: skip
    return Crossing(
        line_id=view.lines[line].line_id,
        time_us=time_us,
        track=track,
        vehicle=track if vehicle is None else vehicle,
        frame=frame,
        lane=way.lane,
        direction=way.direction,
        x_m=way.x_m,
        y_m=way.y_m,
        speed_mps=speed_mps,
        length_m=length_m,
        probability=existence * view.parameters.unseen_share,
    )


def _ways(state: F64, lines: Sequence[Line], ruler: Ruler) -> Iterator[tuple[int, _Way]]:
    """Yield each line that the lane of a vehicle leads over, and how the vehicle stands to it.

    state: x_m, y_m, vx_mps, vy_mps and more.
    """
    place, way = state[[X, Y]], state[[VX, VY]]
    nearest: tuple[float, int, float, float, float] | None = None
    for k in range(len(ruler.lane)):
        if ruler.turn[k]:
            continue
        points = ruler.points_m[ruler.first[k] : ruler.first[k + 1]]
        along_m, left_m, cosine = _foot(points, place, way)
        inside = 0.0 <= along_m <= ruler.length_m[k] and abs(left_m) <= ruler.half_width_m[k]
        if inside and abs(cosine) >= _LEAST_COSINE and (nearest is None or abs(left_m) < abs(nearest[2])):
            nearest = abs(left_m), k, left_m, along_m, math.copysign(1.0, cosine)
    if nearest is None:
        return
    _, k, left_m, along_m, forward = nearest
    points = ruler.points_m[ruler.first[k] : ruler.first[k + 1]]
    for line, met in enumerate(_meets(points, lines)):
        if met is not None:
            at_m, x_m, y_m, ux, uy, leftward = met
            yield (
                line,
                _Way(
                    ahead_m=forward * (at_m - along_m),
                    x_m=x_m - left_m * uy,
                    y_m=y_m + left_m * ux,
                    lane=ruler.lane[k],
                    direction=1 if leftward * forward > 0 else -1,
                ),
            )


def _foot(points: F64, place: F64, way: F64) -> tuple[float, float, float]:
    """Return how far along a polyline a place is and to its left; outside it is below 0 or beyond its length.

    And the cosine between the polyline there and a way.
    """
    step = np.diff(points, axis=0)
    length = np.hypot(step[:, 0], step[:, 1])
    unit = step / length[:, None]
    away = place - points[:-1]
    ahead = (away * unit).sum(axis=1)
    clipped = np.clip(ahead, 0.0, length)
    k = int(np.argmin(((away - clipped[:, None] * unit) ** 2).sum(axis=1)))
    ends = (k == 0 and ahead[0] < 0) or (k == len(step) - 1 and ahead[-1] > length[-1])
    along = float(length[:k].sum() + (ahead[k] if ends else clipped[k]))
    left = float(unit[k, 0] * away[k, 1] - unit[k, 1] * away[k, 0])
    speed = max(float(np.hypot(way[0], way[1])), 1e-9)
    return along, left, float(unit[k] @ way) / speed


def _meets(
    points: F64, lines: Sequence[Line]
) -> Iterator[tuple[float, float, float, float, float, float] | None]:
    """Yield for each line where a polyline first goes over it: along, x, y, unit vector, to the left."""
    step = np.diff(points, axis=0)
    length = np.hypot(step[:, 0], step[:, 1])
    x0, y0, ux, uy = directions(tuple(lines))
    for line in range(len(lines)):
        dx, dy = points[:, 0] - x0[line], points[:, 1] - y0[line]
        side = ux[line] * dy - uy[line] * dx
        over = np.flatnonzero((side[:-1] >= 0) != (side[1:] >= 0))
        met = None
        for k in over.tolist():
            share = side[k] / (side[k] - side[k + 1])
            x, y = points[k] + share * step[k]
            if 0.0 <= ux[line] * (x - x0[line]) + uy[line] * (y - y0[line]) <= lines[line].length_m:
                at = float(length[:k].sum() + share * length[k])
                unit = step[k] / length[k]
                met = at, float(x), float(y), float(unit[0]), float(unit[1]), float(side[k + 1] - side[k])
                break
        yield met


def _told(x: Crossing, told: Sequence[MinuteBlock], also: Sequence[Crossing], p: CountParameters) -> bool:
    """Return whether a vehicle was counted at that place and moment: nearer than their lengths allow."""
    mine = passing_s(x.length_m, x.speed_mps, p)
    apart_s = p.unseen_apart_m / x.speed_mps

    def same(time_us: float, x_m: float, y_m: float, direction: int, length_m: float) -> bool:
        least_s = apart_s + (mine + passing_s(length_m, x.speed_mps, p)) / 2
        near = abs(time_us - x.time_us) / 1e6 < max(least_s, p.unseen_apart_s)
        return near and direction == x.direction and math.hypot(x_m - x.x_m, y_m - x.y_m) < p.unseen_across_m

    if any(same(y.time_us, y.x_m, y.y_m, y.direction, y.length_m) for y in also if y.line_id == x.line_id):
        return True
    for block in told:
        if block.line_id == x.line_id and abs(block.minute - x.time_us // MINUTE_US) <= 1:
            for row in block.table():
                time_us = block.minute * MINUTE_US + int(row["time_us"])
                length_m = float(row["length_m"])
                if same(time_us, float(row["x_m"]), float(row["y_m"]), int(row["direction"]), length_m):
                    return True
    return False
