"""Tell the changes of lanes that were made: what seems to be one is looked at again a moment later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.traffic.change_evidence import AFTER_S, BEFORE_S, ChangeParameters, probability, traits_of
from service.traffic.model import LaneChange, LaneMap, Samples, Trajectory
from service.traffic.paths import Paths, join

_KEEP_US = round(1e6 * (BEFORE_S + AFTER_S))


@dataclass(frozen=True, slots=True)
class Changes:
    """What waits for its judgement, and whom a vehicle may have been taken for."""

    pending: tuple[LaneChange, ...]
    ended: tuple[Trajectory, ...]  # of the last seconds; older ones go when one comes or the last is old


def no_changes() -> Changes:
    """Return the state before the first frame."""
    return Changes((), ())


def confirm(  # noqa: PLR0913, PLR0917 - the state, what is new, and what it is judged by
    changes: Changes,
    found: Sequence[LaneChange],
    paths: Paths,
    finished: tuple[Trajectory, ...],
    lanes: LaneMap,
    now_us: int,
    p: ChangeParameters,
) -> tuple[Changes, tuple[LaneChange, ...]]:
    """Return the state after a frame, and the changes that are sure: seen for long enough, or to the end."""
    waiting = (*changes.pending, *found)
    late_us = now_us - _KEEP_US
    if not waiting and not finished and (not changes.ended or changes.ended[-1].ended_us >= late_us):
        return changes, ()
    ended = tuple(x for x in (*changes.ended, *finished) if x.ended_us >= late_us)
    if not waiting:
        return Changes((), ended), ()
    live = set(paths.number.tolist())
    due = [x for x in waiting if now_us - x.time_us >= 1e6 * p.wait_s or x.number not in live]
    if not due:
        return Changes(waiting, ended), ()
    everybody = join((paths.past, *paths.recent, *(x.samples for x in ended)))
    told = judged(due, everybody, lanes, now_us, p)
    return Changes(tuple(x for x in waiting if x not in due), ended), told


def judged(
    found: Sequence[LaneChange], everybody: Samples, lanes: LaneMap, now_us: int, p: ChangeParameters
) -> tuple[LaneChange, ...]:
    """Return those of the changes found that are likely; everybody: samples of all tracks at their times.

    From and to ways through a junction there are none: those lie upon one another and part, and each vehicle
    that turns would seem to change where they do.
    """
    told = []
    for change in found:
        if any((lane := lanes.lane(k)) and lane.kind == "turn" for k in (change.from_lane, change.to_lane)):
            continue
        traits = traits_of(change, lanes, everybody)
        if traits is not None and probability(traits) >= p.least_probability:
            speed = traits.speed_mps if np.isnan(change.speed_mps) else change.speed_mps
            told.append(replace(change, decided_us=now_us, speed_mps=speed))
    return tuple(told)
