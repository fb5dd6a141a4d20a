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
from service.traffic.lane_places import Way, ways
from service.traffic.measured import VX, VY
from service.traffic.records import Crossing

_US = 1e-6


@dataclass(frozen=True, slots=True)
class Gone:
    """A vehicle that was lost before a line, and the M others of its lane at that moment."""

    track: int
    vehicle: int
    line_id: str
    way: Way
    first_us: int
    last_us: int
    others: I64  # (N,) names of vehicles that were seen while it was: they are not the same
    names: I64  # (2, M) tracks and vehicles of those in its lane
    behind_m: F64  # (M,) how much farther from the line they were; negative: nearer


def watch_lost(gone: tuple[Gone, ...], known: Known) -> tuple[Gone, ...]:
    """Return those that were lost in the last seconds: one more once nobody has measured it for a while."""
    p, v, now_us = known.view.parameters, known.joined.vehicles, known.view.time_us
    late_us = now_us - round(1e6 * p.unseen_lost_s)
    if gone and gone[0].last_us < late_us:
        gone = tuple(x for x in gone if x.last_us >= late_us)
    silent_us, window = round(1e6 * p.unseen_silent_s), known.view.window
    before_us = window[-2].time_us if len(window) > 1 else now_us
    fresh = (now_us - v.last_us >= silent_us) & (before_us - v.last_us < silent_us)
    fresh &= v.last_us - v.first_us >= round(1e6 * p.unseen_life_s)
    for row in np.flatnonzero(fresh).tolist():
        gone = _lost(gone, row, known)
    return gone


def _lost(gone: tuple[Gone, ...], row: int, known: Known) -> tuple[Gone, ...]:
    """Return who is lost, with a vehicle that is silent now: before each line, with those of its lane.

    Where it lies on another one now, or nobody else is seen, what was known when it was lost before stays.
    """
    p, v, view = known.view.parameters, known.joined.vehicles, known.view
    track, vehicle = int(v.number[row]), int(v.vehicle[row])
    mine = [x.track == track or x.vehicle == vehicle for x in gone]
    before = {x.line_id: x for x, same in zip(gone, mine, strict=True) if same}
    found: list[Gone] = []
    for line, way in ways(v.real[:, row], view.lines, known.ruler):
        if way.ahead_m <= 0.0 or known.states.counted[row, line]:
            continue
        age_s = (view.time_us - v.last_us) * _US
        here = known.stands.beside(line, way, SAME_LANE_M) & (age_s < p.unseen_silent_s)
        ahead_m = known.stands.ahead_m[:, line] - np.hypot(v.real[VX], v.real[VY]) * age_s
        behind_m = ahead_m[here] - ahead_m[row]
        line_id = view.lines[line].line_id
        if not len(behind_m) or np.any(np.abs(behind_m) < p.assumed_length_m):
            found += [before[line_id]] if line_id in before else []
            continue
        names = np.array([v.number[here], v.vehicle[here]])
        found.append(
            Gone(
                track, vehicle, line_id, way, int(v.first_us[row]), int(v.last_us[row]),
                _seen_with(row, known), names, behind_m,
            )
        )  # fmt: skip
    return (*(x for x, same in zip(gone, mine, strict=True) if not same), *found)


def _seen_with(row: int, known: Known) -> I64:
    """Return the names of all vehicles that were seen while one was."""
    v = known.joined.vehicles
    listed = v.first_us <= v.last_us[row]
    ended = [(x.number, x.vehicle) for x in known.ended if x.last_us >= v.first_us[row]]
    names = (v.number[listed], v.vehicle[listed], np.array(ended, dtype=np.int64).ravel())
    return np.unique(np.concatenate(names))


def passed_before(
    gone: tuple[Gone, ...], follower: Crossing, known: Known, inferred: Sequence[Crossing]
) -> tuple[tuple[Gone, ...], list[tuple[Gone, float]]]:
    """Return who is still lost once a vehicle has crossed, and who crossed ahead of it, with the times [us].

    inferred: crossings that nobody saw and that are not told yet.
    """
    places_m = {k: _place(x, follower) for k, x in enumerate(gone) if x.line_id == follower.line_id}
    behind = [k for k, place_m in places_m.items() if place_m > 0.0]
    if not behind:
        return gone, []
    line = known.view.line(follower.line_id)
    found, decided = list[tuple[Gone, float]](), set[int]()
    for k in behind:
        x = gone[k]
        sure = known.crossed(line, x.way, ())
        if not any({follower.track, follower.vehicle}.intersection(y.names) for y in sure):
            continue  # it crossed in another lane
        decided.add(k)
        if any({x.track, x.vehicle}.intersection(y.names) for y in sure) or _is_seen(x, known):
            continue
        there = [y for y in known.crossed(line, x.way, inferred) if y.time_us < follower.time_us]
        since_us, since_m = _leader(x, there)
        # whoever was not seen while it was may be the same vehicle, found again
        again = sum(y.time_us > since_us and not np.isin(y.names, x.others).any() for y in there)
        together = sum(gone[i].first_us <= x.last_us and x.first_us <= gone[i].last_us for i in behind)
        if again + len(found) < together:
            share = -since_m / (places_m[k] - since_m)
            found.append((x, since_us + share * (follower.time_us - since_us)))
    return tuple(x for k, x in enumerate(gone) if k not in decided), found


def _is_seen(x: Gone, known: Known) -> bool:
    """Return whether a vehicle that was lost is followed now."""
    v, names = known.joined.vehicles, (x.track, x.vehicle)
    silent_us = round(1e6 * known.view.parameters.unseen_silent_s)
    mine = np.isin(v.number, names) | np.isin(v.vehicle, names)
    return bool(np.any(known.view.time_us - v.last_us[mine] < silent_us))


def _place(x: Gone, follower: Crossing) -> float:
    """Return how far behind a lost vehicle another was, 0 when it was not seen."""
    rows = np.flatnonzero(((x.names == follower.track) | (x.names == follower.vehicle)).any(axis=0))
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
