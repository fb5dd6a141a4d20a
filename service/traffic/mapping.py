"""Keep the lane map of a sensor: gather evidence, learn anew on a schedule, and put a map into force.

A map learned from the state at one frame comes into force a fixed number of frames later: it is learned in
steps on the frames between, and every replay meets it at the same frame. While the map is young the vehicles
that have gone are kept, so that they can be traced back when it comes and whenever it gains a lane.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from typing import Protocol
from weakref import WeakKeyDictionary

import numpy as np

from service.traffic.curves import beside_in_steps
from service.traffic.drift import Drift, DriftParameters, judge, no_drift
from service.traffic.evidence import Evidence, EvidenceParameters, add, latest, no_evidence
from service.traffic.identity import IdentityParameters, difference, gone_with, named
from service.traffic.learning import LearningParameters, learn
from service.traffic.model import NO_MAP, Lane, LaneChange, LaneDrift, LaneMap, Moment, Trajectory
from service.traffic.paths import Paths, so_far
from service.traffic.steps import Progress, Steps


@dataclass(frozen=True, slots=True)
class MappingParameters:
    """When lanes are learned, and when a map replaces the one before."""

    every_s: float = 60.0
    young_every_s: float = 10.0  # while the map rests on fewer than `young_paths`
    young_paths: int = 120
    paths_min: int = 8
    view_paths: int = 20  # while fewer are kept, those of the vehicles in view tell, too
    ready_after: int = 40  # frames from the state that is learned from to the map in force
    work_a_frame: int = 400_000  # pairs of a point and a piece of a curve: a millisecond; the rest at the end
    backlog: int = 200  # paths kept while the map is young
    same_change_s: float = 2.0  # changes of one vehicle nearer than this are one
    cover_first: float = 0.85  # of the evidence that must lie in the lanes of a first map ...
    cover_last: float = 0.3  # ... falling to this when there are `young_paths`
    near_m: float = 1.5  # of a lane's middle


class Learning(Protocol):
    """The parameters that tell what is learned from evidence."""

    @property
    def evidence(self) -> EvidenceParameters:
        """Which paths tell of lanes."""
        ...

    @property
    def learning(self) -> LearningParameters:
        """How lanes are learned."""
        ...

    @property
    def identity(self) -> IdentityParameters:
        """When two lanes are the same."""
        ...

    @property
    def mapping(self) -> MappingParameters:
        """When lanes are learned."""
        ...


@dataclass(frozen=True, slots=True)
class Mapping:
    """The map in force, and what the next one will be learned from."""

    map: LaneMap
    gone: tuple[Lane, ...]  # whose numbers were used before and are not given to others
    evidence: Evidence
    backlog: tuple[Trajectory, ...]
    told: tuple[LaneChange, ...]  # changes of lanes, while the map is young
    drift: Drift
    frames: int  # folded
    slot: int  # of the schedule in which lanes were last looked for; -1: look at once
    learned_paths: int  # had come when lanes were last learned ...
    learned_points: int  # ... from so many points, those of vehicles in view too
    given_key: int  # of the user's lanes that were put into force, 0: none
    coming: tuple[Lane, ...] | None  # of the epoch before, for the first frame of this one
    study: Study | None


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Study:
    """What lanes are being learned from. The same object until its answer is due: the steps go with it."""

    evidence: Evidence
    before: tuple[Lane, ...]  # of the map in force
    gone: tuple[Lane, ...]
    digest: str  # of the parameters
    begun: int  # frames
    due: int  # frames


@dataclass(frozen=True, slots=True)
class Given:
    """Lanes that a user put into force; None: they are learned."""

    lanes: tuple[Lane, ...] | None
    key: int  # tells one set of lanes from another; 0: none


# How far each study has come, as long as somebody holds it. It saves work and changes no answer: the steps
# of a study that is not found, such as one read from a snapshot, are taken again.
_UNDER_WAY: WeakKeyDictionary[Study, Progress[tuple[Lane, ...] | None]] = WeakKeyDictionary()


def no_mapping() -> Mapping:
    """Return the state before the first frame."""
    return Mapping(NO_MAP, (), no_evidence(), (), (), no_drift(), 0, -1, 0, 0, 0, None, None)


def young(mapping: Mapping, p: MappingParameters) -> bool:
    """Return whether lanes rest on few paths: then the past is judged again by each new map."""
    return len(mapping.evidence.paths) < p.young_paths


def begun_anew(mapping: Mapping) -> Mapping:
    """Return the state at the start of a new epoch: the same lanes come into force with its first frame."""
    fresh = replace(no_mapping(), gone=mapping.gone, evidence=mapping.evidence, drift=mapping.drift)
    if mapping.map.lanes:
        fresh = replace(fresh, learned_paths=mapping.learned_paths, learned_points=mapping.learned_points)
        return replace(fresh, coming=mapping.map.lanes)
    return replace(fresh, coming=mapping.coming)


def begin(mapping: Mapping, moment: Moment, given: Given, p: Learning, digest: str) -> Mapping:
    """Return the state at a frame, with the map that is in force from it on.

    digest: of the parameters; lanes that are being learned by others are not learned to the end.
    """
    mapping = replace(mapping, frames=mapping.frames + 1)
    if given.key != mapping.given_key:
        gone = gone_with(mapping.gone, mapping.coming or (), ())
        mapping = replace(
            mapping, given_key=given.key, gone=gone, coming=None, study=None, slot=-1, learned_paths=0
        )
        if given.lanes is not None:
            return _in_force(mapping, moment, given.lanes, "user", mapping.evidence)
    if mapping.coming is not None:
        return _in_force(mapping, moment, mapping.coming, "learned", mapping.evidence)
    if mapping.study is None:
        return mapping
    if mapping.study.digest != digest:
        return replace(mapping, study=None, learned_paths=0)
    return _study(mapping, mapping.study, moment, p)


def _study(mapping: Mapping, study: Study, moment: Moment, p: Learning) -> Mapping:
    """Return the state after a few more steps, and with the map that has been learned when it is due."""
    first = not mapping.map.version
    progress = _UNDER_WAY.pop(study, None) or Progress(_new_lanes(study, p, first=first))
    if mapping.frames < study.due:
        progress.go_on((mapping.frames - study.begun) * p.mapping.work_a_frame)
        _UNDER_WAY[study] = progress
        return mapping
    lanes = progress.answer()
    mapping = replace(mapping, study=None)
    return mapping if lanes is None else _in_force(mapping, moment, lanes, "learned", study.evidence)


def _new_lanes(study: Study, p: Learning, *, first: bool) -> Steps[tuple[Lane, ...] | None]:
    """Return the lanes that a study finds; None where they are as before, or too few for a first map."""
    lanes = yield from lanes_in_steps(study.evidence, study.before, study.gone, p)
    if not difference(study.before, lanes, p.identity):
        return None
    if first:
        wanted = _wanted_cover(study.evidence, p.mapping)
        share = yield from covered(study.evidence, lanes, p.mapping.near_m)
        if share < wanted:
            return None
    return lanes


def _in_force(
    mapping: Mapping, moment: Moment, lanes: tuple[Lane, ...], source: str, evidence: Evidence
) -> Mapping:
    new = LaneMap(
        version=mapping.map.version + 1,
        time_us=moment.time_us,
        frame=moment.frame,
        vehicles=len(evidence.paths),
        source="user" if source == "user" else "learned",
        lanes=lanes,
    )
    drift = mapping.drift if source == "learned" else no_drift()
    gone = gone_with(mapping.gone, mapping.map.lanes, lanes)
    return replace(mapping, map=new, gone=gone, coming=None, drift=drift)


def gather(
    mapping: Mapping,
    finished: tuple[Trajectory, ...],
    evidence_p: EvidenceParameters,
    drift_p: DriftParameters,
    p: MappingParameters,
) -> tuple[Mapping, LaneDrift | None]:
    """Return the state with more finished paths, and what they tell of the map in force."""
    told: LaneDrift | None = None
    for path in finished:
        drift, news = judge(mapping.drift, path, mapping.map, drift_p)
        evidence = add(mapping.evidence, path, evidence_p)
        if news is not None and news.opened:
            # the paths before those that do not fit are of the road as it was
            evidence = latest(evidence, round(news.share * news.vehicles))
        backlog, changes = mapping.backlog, mapping.told
        if len(evidence.paths) >= p.young_paths:
            backlog, changes = (), ()
        elif len(path.samples.number):
            backlog = (*backlog, path)[-p.backlog :]
        mapping = replace(mapping, evidence=evidence, backlog=backlog, told=changes, drift=drift)
        told = news or told
    return mapping, told


def told_once(
    mapping: Mapping, changes: tuple[LaneChange, ...], p: MappingParameters
) -> tuple[Mapping, tuple[LaneChange, ...]]:
    """Return the state, and the changes without those that were told of before, by an earlier map."""
    near_us = 1e6 * p.same_change_s
    fresh: list[LaneChange] = []
    for change in changes:
        if not any(
            change.number == other.number and abs(change.time_us - other.time_us) < near_us
            for other in (*mapping.told, *fresh)
        ):
            fresh.append(change)
    if young(mapping, p):
        mapping = replace(mapping, told=(*mapping.told, *fresh)[-p.backlog :])
    return mapping, tuple(fresh)


def look(  # noqa: PLR0913, PLR0917 - the state, the frame, what is seen, the parameters
    mapping: Mapping, moment: Moment, sensor_id: str, paths: Paths, p: Learning, digest: str
) -> Mapping:
    """Return the state with lanes being learned, where that is due and there is something new to tell.

    paths: of the vehicles in view. While few have left, a map is learned from them, too: where a signal holds
    vehicles back, the road is full of paths before many have left it.
    """
    when, evidence, come = p.mapping, mapping.evidence, mapping.evidence.next_path - 1
    fresh = young(mapping, when)
    period_us = round(1e6 * (when.young_every_s if fresh else when.every_s))
    slot = (moment.time_us + zlib.crc32(sensor_id.encode()) % period_us) // period_us
    if slot == mapping.slot:
        return mapping
    first = mapping.slot < 0
    mapping = replace(mapping, slot=slot)
    if first or mapping.given_key or mapping.study is not None:
        return mapping
    if fresh and len(evidence.paths) < when.view_paths:
        evidence = with_paths_in_view(evidence, paths, p.evidence)
    points = len(evidence.x_m)
    new = (come, points) != (mapping.learned_paths, mapping.learned_points)  # who stands tells nothing more
    if len(evidence.paths) < when.paths_min or not new:
        return mapping
    due = mapping.frames + when.ready_after
    study = Study(evidence, mapping.map.lanes, mapping.gone, digest, mapping.frames, due)
    return replace(mapping, learned_paths=come, learned_points=points, study=study)


def with_paths_in_view(evidence: Evidence, paths: Paths, p: EvidenceParameters) -> Evidence:
    """Return the evidence with the paths of the vehicles in view, as far as they have come."""
    for path in so_far(paths):
        evidence = add(evidence, path, p)
    return evidence


def covered(evidence: Evidence, lanes: tuple[Lane, ...], near_m: float) -> Steps[float]:
    """Return the share of the points of the evidence that lie in a lane."""
    points = np.column_stack([evidence.x_m, evidence.y_m]).astype(np.float64)
    inside = np.zeros(len(points), dtype=np.bool_)
    for lane in lanes:
        place = yield from beside_in_steps(points, lane.points_m)
        inside |= np.abs(place.right_m) < near_m
    return float(inside.mean()) if len(inside) else 0.0


def _wanted_cover(evidence: Evidence, p: MappingParameters) -> float:
    """Return how much of the evidence a first map must explain: part of a road would mislead."""
    old = min(len(evidence.paths) / p.young_paths, 1.0)
    return p.cover_first + old * (p.cover_last - p.cover_first)


def lanes_in_steps(
    evidence: Evidence, before: tuple[Lane, ...], gone: tuple[Lane, ...], p: Learning
) -> Steps[tuple[Lane, ...]]:
    """Return the lanes that the evidence tells of, with the numbers that they have in the maps before."""
    learned = yield from learn(evidence, p.learning)
    return (yield from named(learned, before, gone, p.identity))
