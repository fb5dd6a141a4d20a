"""Keep the lane map of a sensor: gather evidence, learn anew on a schedule, and put a map into force.

A map learned from the state at one frame comes into force a fixed number of frames later, so that the
learning may take its time and every replay meets it at the same frame. While the map is young the vehicles
that have gone are kept, so that they can be traced back when it comes and whenever it gains a lane.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace

import numpy as np

from service.traffic.curves import beside
from service.traffic.drift import Drift, DriftParameters, judge, no_drift
from service.traffic.evidence import Evidence, EvidenceParameters, add, latest, no_evidence
from service.traffic.identity import IdentityParameters, difference, named
from service.traffic.learning import LearningParameters, learn
from service.traffic.model import NO_MAP, Lane, LaneChange, LaneDrift, LaneMap, Moment, Trajectory


@dataclass(frozen=True, slots=True)
class MappingParameters:
    """When lanes are learned, and when a map replaces the one before."""

    every_s: float = 60.0
    young_every_s: float = 10.0  # while the map rests on fewer than `young_paths`
    young_paths: int = 120
    paths_min: int = 8
    ready_after: int = 40  # frames from the state that is learned from to the map in force
    backlog: int = 200  # paths kept while the map is young
    same_change_s: float = 2.0  # changes of one vehicle nearer than this are one
    cover_first: float = 0.85  # of the evidence that must lie in the lanes of a first map ...
    cover_last: float = 0.3  # ... falling to this when there are `young_paths`
    near_m: float = 1.5  # of a lane's middle
    confidence: float = 0.6  # of a lane that is new; one that the map has stays down to learning.confidence


@dataclass(frozen=True, slots=True)
class Mapping:
    """The map in force, and what the next one will be learned from."""

    map: LaneMap
    evidence: Evidence
    backlog: tuple[Trajectory, ...]
    told: tuple[LaneChange, ...]  # changes of lanes, while the map is young
    drift: Drift
    frames: int  # folded
    slot: int  # of the schedule in which lanes were last looked for; -1: look at once
    learned_paths: int  # had come when lanes were last learned
    given_key: int  # of the user's lanes that were put into force, 0: none
    coming: LaneMap | None
    coming_at: int  # frames


@dataclass(frozen=True, slots=True)
class Given:
    """Lanes that a user put into force; None: they are learned."""

    lanes: tuple[Lane, ...] | None
    key: int  # tells one set of lanes from another; 0: none


def no_mapping() -> Mapping:
    """Return the state before the first frame."""
    return Mapping(NO_MAP, no_evidence(), (), (), no_drift(), 0, -1, 0, 0, None, 0)


def begun_anew(mapping: Mapping) -> Mapping:
    """Return the state at the start of a new epoch: the same lanes come into force with its first frame."""
    coming = mapping.map if mapping.map.lanes else mapping.coming
    fresh = replace(no_mapping(), evidence=mapping.evidence, learned_paths=mapping.learned_paths)
    return replace(fresh, coming=coming, drift=mapping.drift)


def begin(mapping: Mapping, moment: Moment, given: Given) -> Mapping:
    """Return the state at a frame, with the map that is in force from it on."""
    mapping = replace(mapping, frames=mapping.frames + 1)
    if given.key != mapping.given_key:
        mapping = replace(mapping, given_key=given.key, coming=None, slot=-1, learned_paths=0)
        if given.lanes is not None:
            return _in_force(mapping, moment, given.lanes, "user")
    if mapping.coming is None or mapping.frames < mapping.coming_at:
        return mapping
    return _in_force(mapping, moment, mapping.coming.lanes, "learned")


def _in_force(mapping: Mapping, moment: Moment, lanes: tuple[Lane, ...], source: str) -> Mapping:
    new = LaneMap(
        version=mapping.map.version + 1,
        time_us=moment.time_us,
        frame=moment.frame,
        vehicles=len(mapping.evidence.paths),
        source="user" if source == "user" else "learned",
        lanes=lanes,
    )
    drift = mapping.drift if source == "learned" else no_drift()
    return replace(mapping, map=new, coming=None, drift=drift)


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
    fresh = tuple(
        change
        for change in changes
        if not any(
            change.number == other.number and abs(change.time_us - other.time_us) < near_us
            for other in mapping.told
        )
    )
    if len(mapping.evidence.paths) < p.young_paths:
        mapping = replace(mapping, told=(*mapping.told, *fresh)[-p.backlog :])
    return mapping, fresh


def look(  # noqa: PLR0913, PLR0917 - one group of parameters a stage
    mapping: Mapping,
    moment: Moment,
    sensor_id: str,
    learning_p: LearningParameters,
    identity_p: IdentityParameters,
    p: MappingParameters,
) -> Mapping:
    """Return the state with a map on its way when lanes are due to be learned and have become others."""
    come = mapping.evidence.next_path - 1
    young = len(mapping.evidence.paths) < p.young_paths
    period_us = round(1e6 * (p.young_every_s if young else p.every_s))
    slot = (moment.time_us + zlib.crc32(sensor_id.encode()) % period_us) // period_us
    due = slot != mapping.slot and mapping.slot >= 0
    mapping = replace(mapping, slot=slot)
    if not due or mapping.given_key or mapping.coming is not None:
        return mapping
    if len(mapping.evidence.paths) < p.paths_min or come == mapping.learned_paths:
        return mapping
    lanes = lanes_now(mapping, learning_p, identity_p, p)
    mapping = replace(mapping, learned_paths=come)
    if not difference(mapping.map.lanes, lanes, identity_p):
        return mapping
    if not mapping.map.version and covered(mapping.evidence, lanes, p.near_m) < _wanted_cover(mapping, p):
        return mapping
    coming = LaneMap(0, moment.time_us, moment.frame, len(mapping.evidence.paths), "learned", lanes)
    return replace(mapping, coming=coming, coming_at=mapping.frames + p.ready_after)


def covered(evidence: Evidence, lanes: tuple[Lane, ...], near_m: float) -> float:
    """Return the share of the points of the evidence that lie in a lane."""
    points = np.column_stack([evidence.x_m, evidence.y_m]).astype(np.float64)
    inside = np.zeros(len(points), dtype=np.bool_)
    for lane in lanes:
        place = beside(points, lane.points_m)
        inside |= np.abs(place.right_m) < near_m
    return float(inside.mean()) if len(inside) else 0.0


def _wanted_cover(mapping: Mapping, p: MappingParameters) -> float:
    """Return how much of the evidence a first map must explain: part of a road would mislead."""
    old = min(len(mapping.evidence.paths) / p.young_paths, 1.0)
    return p.cover_first + old * (p.cover_last - p.cover_first)


def lanes_now(
    mapping: Mapping, learning_p: LearningParameters, identity_p: IdentityParameters, p: MappingParameters
) -> tuple[Lane, ...]:
    """Return the lanes that the evidence of now tells of, with the numbers that they have in the map."""
    before = mapping.map.lanes
    known = {lane.index for lane in before}
    found = named(learn(mapping.evidence, learning_p), before, identity_p)
    kept = [lane for lane in found if lane.index in known or lane.confidence >= p.confidence]
    return _numbered_again(kept, known)


def _numbered_again(lanes: list[Lane], known: set[int]) -> tuple[Lane, ...]:
    """Return the lanes; new ones are numbered without the gaps that those left which were not sure enough."""
    highest = max(known, default=0)
    fresh = (k for k in range(highest + 1, highest + 1 + len(lanes)))
    return tuple(
        lane
        if lane.index in known or lane.index <= highest
        else replace(lane, index=(k := next(fresh)), lane_id=f"L{k}")
        for lane in lanes
    )
