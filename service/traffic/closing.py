"""What a recording tells when it has ended: its lanes, and by them what was seen before they were known.

A live map waits for more evidence, which does not come any more. In a recording of a minute there may have
been no map at all, and no crossing with a lane.
"""

from __future__ import annotations

from dataclasses import replace

from service.traffic import mapping as lane_mapping
from service.traffic.assignment import chart_of
from service.traffic.cells import ruler_of
from service.traffic.changes import judged
from service.traffic.crossing_lanes import relabelled
from service.traffic.model import LaneMap, Outputs
from service.traffic.monitor import TrafficState, trace_back
from service.traffic.parameters import TrafficSetup
from service.traffic.paths import join
from service.traffic.records import Counts
from service.traffic.steps import at_once


def whole_map(state: TrafficState, setup: TrafficSetup) -> LaneMap:
    """Return the map that all evidence up to now tells of: for the end of a recording."""
    p, mapping = setup.parameters, state.mapping
    identity = replace(p.identity, confidence=p.identity.confidence_at_end)
    p = replace(p, identity=identity)
    if mapping.given_key or len(mapping.evidence.paths) < p.mapping.paths_min:
        return mapping.map
    lanes = at_once(lane_mapping.lanes_in_steps(mapping.evidence, mapping.map.lanes, mapping.gone, p))
    return replace(mapping.map, vehicles=len(mapping.evidence.paths), lanes=lanes)


def told_by(lanes: LaneMap, state: TrafficState, now_us: int, setup: TrafficSetup) -> Outputs:
    """Return the changes of lanes and the crossings of which the map of the whole recording tells otherwise.

    Changes are those of vehicles seen while the map was young, crossings those of minutes that are still
    open; their rows name the version after the one in force. now_us: when the recording ended.
    """
    if lanes is state.map or not lanes.lanes:
        return Outputs()
    before, lanes = state.mapping, replace(lanes, version=state.map.version + 1)
    p, counts = setup.parameters, state.counts
    p = replace(p, changes=replace(p.changes, least_probability=p.changes.least_at_end))
    ruler = ruler_of(lanes, p.counting.cell_m)
    _, blocks, _ = relabelled(counts.blocks, counts.leaders, counts.lines, ruler, p.counting)
    if not lane_mapping.young(before, p.mapping):
        return Outputs(counts=Counts(blocks=blocks))
    as_if = replace(state, mapping=replace(before, map=lanes), chart=chart_of(lanes))
    traced, _, gone, coming = trace_back(as_if, before, now_us, p)
    seen = join((*(path.samples for path in before.backlog), traced.paths.past))
    changes = (*gone, *judged(coming, seen, lanes, now_us, p.changes))
    known = {lane.index for lane in before.map.lanes}  # between these the map in force has judged
    changes = tuple(c for c in changes if not {c.from_lane, c.to_lane} <= known)
    _, changes = lane_mapping.told_once(before, changes, p.mapping)
    return Outputs(changes=changes, counts=Counts(blocks=blocks))
