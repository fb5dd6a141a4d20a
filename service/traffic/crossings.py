"""Turn the vehicles of each scan into crossings of count lines: once per vehicle and line.

A vehicle crosses when it was seen a minimum travel before the line, went over it inside its ends, and was
seen the same travel behind it; standing on the line, creeping and trembling change nothing. The time is
where a straight fit of the distance over half a second on either side is zero. A piece that goes along
inside an older track is its ghost and does not count.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, U8, Bool
from service.traffic.count_parameters import CountParameters
from service.traffic.ghosts import is_bounce, is_ghost
from service.traffic.lines import Line, directions, sides
from service.traffic.measured import EXISTENCE, LENGTH, VX, VY, X, Y
from service.traffic.records import Crossing
from service.traffic.stitching import Joined, Vehicles
from service.traffic.window import Past, Scan, past_of, samples_of

_FIT_LEAST = 4  # samples of a fit; fewer: the step over the line alone


@dataclass(frozen=True, slots=True)
class Pending:
    """A way over a line that is not far enough behind it yet, or whose fit wants later samples."""

    line: int
    number: int  # of the track that carries the vehicle now
    vehicle: int
    pieces: tuple[int, ...]  # numbers of the tracks before and behind the line
    direction: int
    time_us: int  # of the step over the line
    x_m: float
    y_m: float
    passed: bool  # far enough behind the line
    fitted: Crossing | None


@dataclass(frozen=True, slots=True)
class LineStates:
    """Where vehicles stand to lines: (V, L) each, rows as in Vehicles, and what is pending."""

    distance_m: F64  # at the last measurement, NaN before the first
    side: I64  # -1, +1: where it was seen far enough away; 0: not yet
    counted: Bool
    pending: tuple[Pending, ...]


def no_line_states(vehicles: int, lines: int) -> LineStates:
    """Return that nothing is known of so many vehicles."""
    shape = (vehicles, lines)
    return LineStates(np.full(shape, np.nan), np.zeros(shape, np.int64), np.zeros(shape, np.bool_), ())


@dataclass(frozen=True)  # without slots: a cached property wants a place
class View:
    """What a crossing is judged by: the newest scan last, the lines, and the constants."""

    window: tuple[Scan, ...]
    lines: tuple[Line, ...]
    parameters: CountParameters

    @property
    def time_us(self) -> int:
        """Return the time of the newest scan."""
        return self.window[-1].time_us

    def line(self, line_id: str) -> int:
        """Return the place of a line among the lines, -1 where there is none of that name."""
        return next((k for k, line in enumerate(self.lines) if line.line_id == line_id), -1)

    @cached_property
    def past(self) -> Past:
        """The samples of the window, as a table."""
        return past_of(self.window)


def cross(before: LineStates, joined: Joined, view: View) -> tuple[LineStates, tuple[Crossing, ...]]:
    """Return the states after a scan and the crossings that are certain now, by time."""
    p, v = view.parameters, joined.vehicles
    if not view.lines or not len(v):
        return no_line_states(len(v), len(view.lines)), ()
    was = _aligned(before, joined, view)
    distance_m, side, events = _stand(
        was.distance_m, was.side, joined.measured, v.real, directions(view.lines), p.travel_m
    )
    states = LineStates(distance_m, side, was.counted, ())
    pending = _follow(was.pending, joined)
    for row, line in _places(events & _OVER):
        number = int(v.number[row])
        pending = [x for x in pending if x.passed or (x.number, x.line) != (number, line)]
        now = distance_m[row, line]
        if was.side[row, line] == (-1 if now >= 0 else 1) and not was.counted[row, line]:
            step = _step_over(joined, row, line, was.distance_m[row, line], now, view)
            pending += [step] if step is not None else []
    if not pending:
        return states, ()
    for row, line in _places(events & _BEHIND):
        on = (int(v.number[row]), line, int(side[row, line]))
        pending = [replace(x, passed=True) if (x.number, x.line, x.direction) == on else x for x in pending]
    return _emit(states, joined, pending, view)


_OVER, _BEHIND = 1, 2  # bits of what happened to a vehicle at a line


@kernel
def _stand(  # noqa: PLR0913, PLR0917 - one pass over vehicles and lines
    was_m: F64, was_side: I64, measured: I64, real: F64, lines: F64, travel_m: float
) -> tuple[F64, I64, U8]:
    """Return (V, L) distances, sides and events of the vehicles that were measured; others stay as they were.

    real (4, V) as in `Vehicles`, lines (4, L) as `directions` gives them.
    """
    distance_m, side = was_m.copy(), was_side.copy()
    events = np.zeros(side.shape, np.uint8)
    for i in range(len(measured)):
        if measured[i] < 0:
            continue
        for k in range(side.shape[1]):
            dx, dy = real[0, i] - lines[0, k], real[1, i] - lines[1, k]
            now = lines[2, k] * dy - lines[3, k] * dx
            here = 1 if now >= 0.0 else -1
            if not math.isnan(was_m[i, k]) and (was_m[i, k] >= 0.0) != (now >= 0.0):
                events[i, k] |= _OVER
            if abs(now) >= travel_m:
                if was_side[i, k] == -here:
                    events[i, k] |= _BEHIND
                side[i, k] = here
            distance_m[i, k] = now
    return distance_m, side, events


def _places(events: NDArray[np.integer]) -> Iterator[tuple[int, int]]:
    """Yield row and column of each place that is not zero, row by row."""
    rows, columns = np.nonzero(events)
    return zip(rows.tolist(), columns.tolist(), strict=True)


def _aligned(before: LineStates, joined: Joined, view: View) -> LineStates:
    """Return the rows of the vehicles as they stand now; those of `counted` may be written to.

    A new one has been followed since its birth, though not listed: it starts on the side where it was then.
    """
    known = before.distance_m.shape[1] == len(view.lines)
    if joined.origin is None and known:
        return LineStates(before.distance_m, before.side, before.counted.copy(), before.pending)
    blank = no_line_states(len(joined.vehicles), len(view.lines))
    if joined.origin is None or not known:
        return blank
    old = joined.origin >= 0
    origin = joined.origin[old]
    blank.distance_m[old], blank.side[old] = before.distance_m[origin], before.side[origin]
    blank.counted[old] = before.counted[origin]
    if len(origin) < len(old):
        born, _ = sides(view.lines, joined.from_x_m[~old], joined.from_y_m[~old])
        blank.distance_m[~old] = born
        blank.side[~old] = np.where(np.abs(born) >= view.parameters.travel_m, np.where(born >= 0, 1, -1), 0)
    return replace(blank, pending=before.pending)


def _follow(pending: tuple[Pending, ...], joined: Joined) -> list[Pending]:
    """Return what is pending of vehicles that are still known, carried over to their newest tracks."""
    if joined.origin is None or not pending:
        return list(pending)
    number, vehicle = joined.vehicles.number, joined.vehicles.vehicle
    listed = set(number.tolist())
    kept = []
    for x in pending:
        if x.number in listed:
            kept.append(x)
            continue
        heirs = number[vehicle == x.vehicle]
        if len(heirs):
            kept.append(replace(x, number=int(heirs[-1]), pieces=(*x.pieces, int(heirs[-1]))))
        elif x.passed:
            kept.append(x)
    return kept


def _step_over(  # noqa: PLR0913, PLR0917 - one step, its two ends and what it is seen in
    joined: Joined, row: int, line: int, was: float, now: float, view: View
) -> Pending | None:
    """Return the pending crossing of a step over a line, None when it passes beside its ends."""
    v, share = joined.vehicles, was / (was - now)
    x = joined.from_x_m[row] + share * (v.real[X, row] - joined.from_x_m[row])
    y = joined.from_y_m[row] + share * (v.real[Y, row] - joined.from_y_m[row])
    _, along = sides(view.lines[line : line + 1], np.array([x]), np.array([y]))
    edge = view.parameters.edge_m
    if not -edge <= along[0, 0] <= view.lines[line].length_m + edge:
        return None
    before_us = int(joined.from_us[row])
    pieces = {int(joined.from_number[row]): None, int(v.number[row]): None}
    return Pending(
        line=line,
        number=int(v.number[row]),
        vehicle=int(v.vehicle[row]),
        pieces=tuple(pieces),
        direction=1 if now >= 0 else -1,
        time_us=before_us + round(share * (view.time_us - before_us)),
        x_m=float(x),
        y_m=float(y),
        passed=False,
        fitted=None,
    )


def _emit(
    states: LineStates, joined: Joined, pending: Sequence[Pending], view: View
) -> tuple[LineStates, tuple[Crossing, ...]]:
    """Return what stays pending, and the crossings that are behind their line, fitted and no ghost's."""
    p, v = view.parameters, joined.vehicles
    rows = dict(zip(v.number.tolist(), range(len(v)), strict=True))
    last_us, first_us, fit_us = v.last_us, v.first_us, round(p.fit_s * 1e6)
    kept, done = [], []
    for x in pending:
        row = rows.get(x.number)
        if row is None:
            continue  # lost before it was certain
        if x.passed:
            states.counted[row, x.line] = True
        if x.fitted is None and view.time_us - x.time_us >= fit_us:
            x = replace(x, fitted=_fit(x, view))  # noqa: PLW2901 - the same one, further on
        if x.fitted is None or not x.passed or int(last_us[row] - first_us[row]) / 1e6 < p.least_life_s:
            kept.append(x)
        elif x.fitted.probability >= p.least_existence:
            older, nearer = _older(v, row, p), _nearer(v, row, p)
            if older and is_ghost(view.past, x.number, older, p):
                continue
            if nearer and is_bounce(view.past, x.number, nearer, p):
                continue
            done.append(x.fitted)
    done.sort(key=lambda crossing: (crossing.time_us, crossing.track))
    return replace(states, pending=tuple(kept)), tuple(done)


def _older(v: Vehicles, row: int, p: CountParameters) -> list[int]:
    """Return the tracks of which this vehicle's may be the ghost: older ones that are near."""
    track_us = v.track_us[row]
    older = (v.track_us < track_us) | ((v.track_us == track_us) & (v.number < v.number[row]))
    dx, dy = v.real[:2] - v.real[:2, row, None]
    older &= np.hypot(dx, dy) < 2 * p.ghost_along_m
    numbers: list[int] = v.number[older].tolist()
    return numbers


def _nearer(v: Vehicles, row: int, p: CountParameters) -> list[int]:
    """Return the tracks that this one may be a late echo of: older ones before it, on its bearing."""
    older = v.track_us < v.track_us[row]
    x, y = v.real[:2]
    range_m = np.hypot(x, y)
    behind_m = range_m[row] - range_m
    across_m = np.abs(x[row] * y - y[row] * x) / np.maximum(range_m, 1.0)
    older &= (behind_m > p.bounce_from_m) & (behind_m < p.bounce_to_m) & (across_m < 2 * p.bounce_across_m)
    numbers: list[int] = v.number[older].tolist()
    return numbers


def _fit(x: Pending, view: View) -> Crossing:
    """Return the crossing as the samples on both sides of the line have it."""
    p, line = view.parameters, view.lines[x.line]
    samples = samples_of(view.past, x.pieces, x.time_us)
    apart_s = np.abs(samples.time_s)
    near = apart_s <= p.fit_s
    if np.count_nonzero(near) < _FIT_LEAST:
        near = apart_s <= max(p.fit_s, float(np.sort(apart_s)[:_FIT_LEAST][-1]))
    time_s, real = samples.time_s[near], samples.real[:, near]
    distance, _ = sides([line], real[X], real[Y])
    delay_s = _zero(time_s, distance[:, 0], x.direction)
    speed = np.hypot(real[VX], real[VY])
    nearest = int(np.argmin(apart_s))
    return Crossing(
        line_id=line.line_id,
        time_us=round(x.time_us / 1e3 + delay_s * 1e3) * 1000,  # to the millisecond, as it is told
        track=x.number,
        vehicle=x.vehicle,
        frame=int(samples.frame[nearest]),
        lane=int(samples.lane[nearest]),
        direction=x.direction,
        x_m=x.x_m,
        y_m=x.y_m,
        speed_mps=max(float(_at_zero(time_s - delay_s, speed)), p.least_speed_mps),
        length_m=float(samples.real[LENGTH, -1]),
        probability=_mean(real[EXISTENCE]) * p.real_share,
    )


def _zero(time_s: F64, distance_m: F64, direction: int) -> float:
    """Return when a straight fit of the distance is zero; 0 where it does not go over the line in time."""
    mean_s, mean_m = _mean(time_s), _mean(distance_m)
    away_s = time_s - mean_s
    spread = float((away_s**2).sum())
    if spread <= 0:
        return 0.0
    slope = float((away_s * (distance_m - mean_m)).sum()) / spread
    if slope * direction <= 0:
        return 0.0
    zero = mean_s - mean_m / slope
    return zero if abs(zero) <= float(np.abs(time_s).max()) else 0.0


def _at_zero(time_s: F64, values: F64) -> float:
    """Return the value of a straight fit at time zero."""
    mean_s, mean = _mean(time_s), _mean(values)
    away_s = time_s - mean_s
    spread = float((away_s**2).sum())
    if spread <= 0:
        return mean
    slope = float((away_s * (values - mean)).sum()) / spread
    return mean - slope * mean_s


def _mean(values: F64) -> float:
    """Return the mean; numpy's own takes three times as long."""
    return float(values.sum()) / len(values)
