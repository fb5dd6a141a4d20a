"""Tell the crossings that nobody saw: of vehicles first seen behind a line, or last seen before it.

At range a vehicle is often hidden when it crosses: others drive before it, or its track begins too late or
ends too early. But vehicles neither come from nowhere nor vanish: on a lane that leads over the line,
between junctions, who drives behind the line must have crossed it. Such a crossing is told where the line is
no more than a few seconds away along the lane at the vehicle's own speed, in time that was observed, and when
nobody was counted at that place and moment: the vehicle may have been followed before, as another track.
Farther behind the line, or before it, it is told where the order of the lane says when it was (`between`,
`gone`). Nor is it told by speed of a vehicle lost before a line where one is found later, or stands, between:
it may be the same one, or the lane is held up.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.traffic.between import crossed_between
from service.traffic.count_parameters import CountParameters
from service.traffic.crossing_lanes import passing_s
from service.traffic.crossings import LineStates, View
from service.traffic.ended import left
from service.traffic.gone import Gone, passed_before, watch_lost
from service.traffic.known import SAME_LANE_M, Known
from service.traffic.lane_places import Way, stands, ways
from service.traffic.measured import EXISTENCE, LENGTH, VX, VY, X, Y
from service.traffic.records import MINUTE_US, Crossing, MinuteBlock
from service.traffic.stitching import Vehicles
from service.traffic.window import samples_of

_RECENT_US, _RECENT = 20_000_000, 3  # crossings that tell how fast the traffic is at a line
_SLOW_MPS = 1.0


@dataclass(frozen=True, slots=True)
class Lost:
    """Where a vehicle was seen last, before a line."""

    time_us: int
    ahead_m: float  # to the line
    vx_mps: float
    vy_mps: float


@dataclass(frozen=True, slots=True)
class Waiting:
    """A crossing that nobody saw, until it is sure that nobody else was meant."""

    crossing: Crossing
    lost: Lost | None  # None: the vehicle was first seen behind the line
    in_order: bool = (
        False  # its time is that of its place among those of its lane: it is nobody who was counted
    )


@dataclass(frozen=True, slots=True)
class UnseenState:
    """What waits, what was told in the last seconds, and who is lost."""

    waiting: tuple[Waiting, ...] = ()
    told: tuple[Waiting, ...] = ()
    gone: tuple[Gone, ...] = ()


def unseen(
    state: UnseenState, before: Vehicles, stood: LineStates, known: Known
) -> tuple[UnseenState, tuple[Crossing, ...]]:
    """Return what waits now, and the crossings that must have been, by time; marks in `known.states.counted`.

    before, stood: the vehicles before this scan, and where they stood.
    """
    if not known.view.lines or not known.ruler.lane:
        return UnseenState(), ()
    late_us = known.view.time_us - _RECENT_US
    if state.told and state.told[0].crossing.time_us < late_us:
        state = replace(state, told=tuple(x for x in state.told if x.crossing.time_us >= late_us))
    fresh = (*_first_seen(state, known), *_last_seen(state, before, stood, known))
    gone = watch_lost(state.gone, known)
    if fresh or gone is not state.gone:
        state = replace(state, waiting=(*state.waiting, *fresh), gone=gone)
    if state.gone and known.found:
        state = _passed(state, known)
    return _settled(state, known) if state.waiting else (state, ())


def _passed(state: UnseenState, known: Known) -> UnseenState:
    """Return what waits with those who crossed ahead of the vehicles that did."""
    view = known.view
    for follower in known.found:
        inferred = [x.crossing for x in state.waiting]
        gone, passed = passed_before(state.gone, follower, known, inferred)
        if gone is state.gone:
            continue
        fresh = []
        for x, time_us in passed:
            crossing = _crossing(
                view, view.line(x.line_id), x.way, time_us, x.track, view.window[0].frame,
                follower.speed_mps, math.nan, view.parameters.unseen_passed_share, x.vehicle,
            )  # fmt: skip
            lost = Lost(x.last_us, x.way.ahead_m, 0.0, 0.0)
            fresh.append(Waiting(crossing, lost, in_order=True))
        better = {(x.crossing.line_id, x.crossing.vehicle) for x in fresh}  # than what its speed tells
        waiting = (x for x in state.waiting if (x.crossing.line_id, x.crossing.vehicle) not in better)
        state = replace(state, waiting=(*waiting, *fresh), gone=gone)
    return state


def _settled(state: UnseenState, known: Known) -> tuple[UnseenState, tuple[Crossing, ...]]:
    """Return what still waits, since others may yet be counted at its place, and what is sure, by time."""
    view, p = known.view, known.view.parameters
    wait_us = round(1e6 * p.unseen_wait_s)
    late = [x for x in state.waiting if view.time_us - x.crossing.time_us >= wait_us]
    if not late:
        return state, ()
    others = [*known.found, *(x.fitted for x in known.states.pending if x.fitted is not None)]
    sure: list[Waiting] = []
    for x in sorted(late, key=lambda x: (x.crossing.time_us, x.crossing.track)):
        if (
            known.observed.holds(x.crossing.time_us)
            and (x.in_order or not (_told(x.crossing, known.told, others, p) or _held_up(x, known)))
            and not _same_vehicle(x, (*state.told, *sure), p)
        ):
            crossing = replace(x.crossing, frame=_frame_at(x.crossing, view))
            sure.append(replace(x, crossing=crossing))
            others.append(crossing)
    waiting = tuple(x for x in state.waiting if view.time_us - x.crossing.time_us < wait_us)
    told = tuple(x.crossing for x in sure)
    return replace(state, waiting=waiting, told=(*state.told, *sure)), told


def _frame_at(x: Crossing, view: View) -> int:
    """Return the newest frame at a crossing, as far back as the window goes."""
    return next((scan.frame for scan in reversed(view.window) if scan.time_us <= x.time_us), x.frame)


def _same_vehicle(x: Waiting, others: Iterable[Waiting], p: CountParameters) -> bool:
    """Return whether one lost before a line and one found behind it may be one: both times are guesses."""
    return any(
        (x.lost is None) != (y.lost is None)
        and (x.crossing.line_id, x.crossing.direction) == (y.crossing.line_id, y.crossing.direction)
        and math.hypot(y.crossing.x_m - x.crossing.x_m, y.crossing.y_m - x.crossing.y_m) < p.unseen_across_m
        and abs(y.crossing.time_us - x.crossing.time_us) < 1e6 * p.unseen_guess_s
        for y in others
    )


def _held_up(x: Waiting, known: Known) -> bool:
    """Return whether, between where a vehicle was lost and its line, one was found later or stands."""
    lost, view, vehicles = x.lost, known.view, known.joined.vehicles
    if lost is None:
        return False
    line = view.line(x.crossing.line_id)
    real = vehicles.real
    slow = np.hypot(real[VX], real[VY]) < view.parameters.unseen_least_mps
    away_m = np.hypot(real[X] - x.crossing.x_m, real[Y] - x.crossing.y_m)
    near = (vehicles.last_us > lost.time_us) & (away_m <= lost.ahead_m + SAME_LANE_M)
    near &= (vehicles.first_us > lost.time_us) | slow
    rows = np.flatnonzero(near)
    if line < 0 or not len(rows):
        return False
    there = real[:, rows]
    there[VX, slow[rows]], there[VY, slow[rows]] = lost.vx_mps, lost.vy_mps  # a standing one's lane
    found = stands(there, view.lines, known.ruler)
    way = Way(0.0, x.crossing.x_m, x.crossing.y_m, x.crossing.lane, x.crossing.direction)
    ahead_m = found.ahead_m[:, line]
    between = found.beside(line, way, SAME_LANE_M) & (ahead_m > 0.0) & (ahead_m <= lost.ahead_m)
    return bool(between.any())


def _first_seen(state: UnseenState, known: Known) -> list[Waiting]:
    """Return crossings before their birth of the vehicles that have just been followed for long enough."""
    view, joined, states = known.view, known.joined, known.states
    p, v, found = view.parameters, joined.vehicles, list[Waiting]()
    least_us = round(p.unseen_life_s * 1e6)
    due = (joined.measured >= 0) & (v.last_us - v.first_us >= least_us)
    due &= joined.from_us - v.first_us < least_us
    due &= v.number == v.vehicle  # a vehicle of several pieces was seen before
    rows = np.flatnonzero(due).tolist()
    if not rows:
        return found
    past = view.past
    for row in rows:
        number = int(v.number[row])
        samples = samples_of(past, (number,), view.time_us)
        speeds = np.hypot(samples.real[VX], samples.real[VY])
        speed, existence = float(speeds.mean()), float(samples.real[EXISTENCE].mean())
        if existence < p.least_existence:
            continue
        drove = min(speed, float(speeds[0])) >= p.unseen_least_mps
        pending = {x.line for x in states.pending if x.number == number}
        for line, way in ways(samples.real[:, 0], view.lines, known.ruler):
            if states.counted[row, line] or line in pending or way.ahead_m >= p.travel_m:
                continue
            there = _speed_there(view.lines[line].line_id, way, known, state.told)
            near = drove and way.ahead_m >= -p.unseen_behind_s * speed
            if near:
                passed_s = float(samples.time_s[0]) + way.ahead_m * _slowness(speed, there)
                time_us = view.time_us + 1e6 * passed_s
            else:
                between_us = _in_order(row, line, known, (*state.waiting, *found))
                if between_us is None:
                    continue
                time_us = between_us
            states.counted[row, line] = True
            crossing = _crossing(
                view, line, way, time_us, number, int(samples.frame[0]),
                speed if there is None else there, float(samples.real[LENGTH, -1]),
                existence * (p.unseen_share if near else p.unseen_between_share),
            )  # fmt: skip
            found.append(Waiting(crossing, None, in_order=not near))
    return found


def _in_order(row: int, line: int, known: Known, waiting: Sequence[Waiting]) -> float | None:
    """Return when a vehicle crossed a line far behind it [us], None where its lane's order does not say."""
    for k, way in known.stands.ways(row):
        if k == line and -known.view.parameters.unseen_order_m <= way.ahead_m < 0.0:
            return crossed_between(row, line, way, known, [x.crossing for x in waiting])
    return None


def _last_seen(state: UnseenState, before: Vehicles, stood: LineStates, known: Known) -> Iterator[Waiting]:
    """Yield crossings after their last measurement of the vehicles that are given up in this scan."""
    joined, view = known.joined, known.view
    if stood.counted.shape[1] != len(view.lines):
        return
    p = view.parameters
    least_us = round(p.unseen_life_s * 1e6)
    for row in left(before, joined).tolist():
        if before.last_us[row] - before.first_us[row] < least_us:
            continue
        vx_mps, vy_mps = before.real[[VX, VY], row].tolist()
        speed = math.hypot(vx_mps, vy_mps)
        if speed < p.unseen_least_mps:
            continue
        for line, way in ways(before.real[:, row], view.lines, known.ruler):
            if stood.counted[row, line] or not -p.travel_m < way.ahead_m <= p.unseen_ahead_s * speed:
                continue
            there = _speed_there(view.lines[line].line_id, way, known, state.told)
            lost_us = int(before.last_us[row])
            crossing = _crossing(
                view, line, way, lost_us + 1e6 * way.ahead_m * _slowness(speed, there),
                int(before.number[row]), view.window[0].frame, speed if there is None else there, math.nan,
                p.unseen_share, int(before.vehicle[row]),
            )  # fmt: skip
            yield Waiting(crossing, Lost(lost_us, way.ahead_m, vx_mps, vy_mps))


def _speed_there(line_id: str, way: Way, known: Known, inferred: Sequence[Waiting]) -> float | None:
    """Return the median speed of the last vehicles that were seen crossing there, None without.

    inferred: told crossings that nobody saw; their speeds are copies.
    """
    now_us = known.view.time_us
    copies = [x.crossing.track for x in inferred if x.crossing.line_id == line_id]
    speeds: list[tuple[int, float]] = []
    for block in known.told:
        if block.line_id == line_id and block.minute >= now_us // MINUTE_US - 1:
            table = block.table()
            near = np.hypot(table["x_m"] - way.x_m, table["y_m"] - way.y_m) < SAME_LANE_M
            near &= (table["direction"] == way.direction) & ~np.isin(table["track"], copies)
            rows = table[near]
            times = (block.minute * MINUTE_US + rows["time_us"].astype(np.int64)).tolist()
            speeds += zip(times, rows["speed_mps"].tolist(), strict=True)
    recent = sorted(x for x in speeds if now_us - x[0] <= _RECENT_US)[-_RECENT:]
    return float(np.median([speed for _, speed in recent])) if recent else None


def _slowness(here_mps: float, there_mps: float | None) -> float:
    """Return seconds a metre between two places of known speed."""
    return 1.0 / here_mps if there_mps is None else 0.5 / here_mps + 0.5 / max(there_mps, _SLOW_MPS)


def _crossing(  # noqa: PLR0913, PLR0917 - what is known of it
    view: View, line: int, way: Way, time_us: float, track: int, frame: int, speed_mps: float,
    length_m: float, probability: float, vehicle: int | None = None,
) -> Crossing:  # fmt: skip
    return Crossing(
        line_id=view.lines[line].line_id,
        time_us=round(time_us / 1000) * 1000,  # as it is told
        track=track,
        vehicle=track if vehicle is None else vehicle,
        frame=frame,
        lane=way.lane,
        direction=way.direction,
        x_m=way.x_m,
        y_m=way.y_m,
        speed_mps=speed_mps,
        length_m=length_m,
        probability=probability,
    )


def _told(x: Crossing, told: Sequence[MinuteBlock], also: Sequence[Crossing], p: CountParameters) -> bool:
    """Return whether a vehicle was counted at that place and moment: nearer than their lengths allow."""
    others = [
        (y.time_us, y.length_m)
        for y in also
        if (y.line_id, y.direction) == (x.line_id, x.direction)
        and math.hypot(y.x_m - x.x_m, y.y_m - x.y_m) < p.unseen_across_m
    ]
    for block in told:
        if block.line_id == x.line_id and abs(block.minute - x.time_us // MINUTE_US) <= 1:
            table = block.table()
            near = np.hypot(table["x_m"] - x.x_m, table["y_m"] - x.y_m) < p.unseen_across_m
            rows = table[near & (table["direction"] == x.direction)]
            times_us = block.minute * MINUTE_US + rows["time_us"].astype(np.int64)
            others += zip(times_us.tolist(), rows["length_m"].tolist(), strict=True)
    mine_s, apart_s = passing_s(x.length_m, x.speed_mps, p), p.unseen_apart_m / x.speed_mps
    return any(
        abs(time_us - x.time_us)
        < 1e6 * max(apart_s + (mine_s + passing_s(length_m, x.speed_mps, p)) / 2, p.unseen_apart_s)
        for time_us, length_m in others
    )
