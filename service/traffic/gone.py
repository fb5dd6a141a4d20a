"""Tell when a vehicle crossed a line that was lost far before it: ahead of the one that drove behind it.

Nobody overtakes within a lane. Once somebody crosses the line who was seen behind a vehicle when that was
lost, it has crossed, too, unless others were counted since who may be the same vehicle, found again. That
holds however far before the line it was lost, which its own speed does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, I64
from service.traffic.known import SAME_LANE_M, Crossed, Known
from service.traffic.lane_places import Way
from service.traffic.records import Crossing


@dataclass(frozen=True, slots=True)
class Gone:
    """A vehicle that was lost before a line, and the M others of its lane at that moment."""

    track: int
    vehicle: int
    line_id: str
    way: Way
    first_us: int
    last_us: int
    newest: int  # of the tracks that were listed while it was seen: their vehicles are others
    names: I64  # (2, M) tracks and vehicles of the others
    behind_m: F64  # (M,) how much farther from the line they were; negative: nearer


def watch_lost(gone: tuple[Gone, ...], known: Known) -> tuple[Gone, ...]:
    """Return those that were lost in the last seconds: one more once nobody has measured it for a while."""
    p, v, now_us = known.view.parameters, known.joined.vehicles, known.view.time_us
    if gone and gone[0].last_us < now_us - round(1e6 * p.unseen_lost_s):
        gone = gone[1:]
    silent_us, window = round(1e6 * p.unseen_silent_s), known.view.window
    before_us = window[-2].time_us if len(window) > 1 else now_us
    fresh = (now_us - v.last_us >= silent_us) & (before_us - v.last_us < silent_us)
    fresh &= v.last_us - v.first_us >= round(1e6 * p.unseen_life_s)
    for row in np.flatnonzero(fresh).tolist():
        lost = _lost(row, known)
        again = {(x.line_id, x.vehicle) for x in lost}
        gone = (*(x for x in gone if (x.line_id, x.vehicle) not in again), *lost)
    return gone


def _lost(row: int, known: Known) -> list[Gone]:
    """Return the lines that a vehicle was lost before, with those who drive in its lane."""
    p, v, found = known.view.parameters, known.joined.vehicles, list[Gone]()
    driven_m = float(np.hypot(*v.real[2:4, row])) * (known.view.time_us - int(v.last_us[row])) / 1e6
    for line, way in known.stands.ways(row):
        if way.ahead_m <= 0.0 or known.states.counted[row, line]:
            continue
        here = known.stands.beside(line, way, SAME_LANE_M) & (known.joined.measured >= 0)
        behind_m = known.stands.ahead_m[:, line] - (way.ahead_m - driven_m)
        if np.any(np.abs(behind_m[here]) < p.assumed_length_m):
            continue  # one vehicle that was followed twice
        others = v.number[v.first_us <= v.last_us[row]]
        found.append(
            Gone(
                int(v.number[row]), int(v.vehicle[row]), known.view.lines[line].line_id, way,
                int(v.first_us[row]), int(v.last_us[row]), int(others.max()),
                np.array([v.number[here], v.vehicle[here]]), behind_m[here],
            )
        )  # fmt: skip
    return found


def passed_before(
    gone: tuple[Gone, ...], follower: Crossing, known: Known, inferred: Sequence[Crossing]
) -> tuple[tuple[Gone, ...], list[tuple[Gone, float]]]:
    """Return who is still lost once a vehicle has crossed, and who crossed ahead of it, with the times [us].

    inferred: crossings that nobody saw and that are not told yet.
    """
    behind = [follower.track, follower.vehicle]
    places_m = {k: _place(x, behind) for k, x in enumerate(gone) if x.line_id == follower.line_id}
    mine = [k for k, place_m in places_m.items() if place_m > 0.0]
    if not mine:
        return gone, []
    line = next(k for k, line in enumerate(known.view.lines) if line.line_id == follower.line_id)
    found = list[tuple[Gone, float]]()
    for k in mine:
        x = gone[k]
        there = known.crossed(line, x.way, inferred)
        followed = any(set(behind).intersection(y.names) for y in there)  # it crossed in the same lane
        counted = any({x.track, x.vehicle}.intersection(y.names) for y in there)
        if counted or not followed or _is_seen(x, known):
            continue
        since_us, since_m = _leader(x, there)
        # whoever was listed later may be the same vehicle, found again
        later = sum(since_us < y.time_us < follower.time_us and min(y.names) > x.newest for y in there)
        together = sum(gone[i].first_us <= x.last_us and x.first_us <= gone[i].last_us for i in mine)
        if later + len(found) < together:
            share = -since_m / (places_m[k] - since_m)
            found.append((x, since_us + share * (follower.time_us - since_us)))
    return tuple(x for k, x in enumerate(gone) if k not in mine), found


def _is_seen(x: Gone, known: Known) -> bool:
    """Return whether a vehicle that was lost is followed now."""
    v = known.joined.vehicles
    silent_us = round(1e6 * known.view.parameters.unseen_silent_s)
    return bool(np.any((v.vehicle == x.vehicle) & (known.view.time_us - v.last_us < silent_us)))


def _place(x: Gone, names: Sequence[int]) -> float:
    """Return how far behind a lost vehicle another was, 0 when it was not seen."""
    rows = np.flatnonzero(np.isin(x.names, names).any(axis=0))
    return float(x.behind_m[rows[0]]) if len(rows) else 0.0


def _leader(x: Gone, there: Sequence[Crossed]) -> tuple[int, float]:
    """Return when the nearest ahead of a lost vehicle crossed that did, and where it was; else the loss."""
    when_us = {name: y.time_us for y in there for name in y.names}
    crossed = [
        (behind_m, when_us[name])
        for behind_m, *names in zip(x.behind_m.tolist(), *x.names.tolist(), strict=True)
        for name in names if behind_m < 0.0 and name in when_us
    ]  # fmt: skip
    if not crossed:
        return x.last_us, -x.way.ahead_m
    behind_m, time_us = max(crossed)
    return time_us, behind_m
