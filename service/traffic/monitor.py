"""One step of traffic analysis: the tracks of a frame, and what is known of the traffic before and after it.

map in force -> lane of each vehicle -> motion state -> paths -> crossings -> next map. Each stage has its own
state, parameters and outputs; all is a function of the state and the tracks, the same live and offline.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace

import numpy as np

from service.tracking.model import TrackEstimates
from service.traffic import mapping as lane_mapping
from service.traffic.assignment import Chart, assign, chart_of, retrace, unfinished
from service.traffic.changes import Changes, confirm, judged, no_changes
from service.traffic.counting import CountState, count, nothing_counted, report
from service.traffic.mapping import Mapping, no_mapping
from service.traffic.measured import measured_of
from service.traffic.model import NO_MAP, LaneChange, LaneMap, Moment, Outputs, Samples, no_samples
from service.traffic.motion_state import classify
from service.traffic.parameters import TrafficParameters, TrafficSetup
from service.traffic.paths import Paths, follow, join, no_paths, retraced
from service.traffic.vehicles import AHEAD_COLUMNS, MOTION_COLUMNS, Vehicles, aligned, no_vehicles, parted


@dataclass(frozen=True, slots=True)
class TrafficState:
    """What is remembered of a sensor's traffic; a value, never changed in place."""

    mapping: Mapping
    chart: Chart  # of the map in force
    vehicles: Vehicles
    paths: Paths
    changes: Changes
    counts: CountState

    @property
    def idle(self) -> bool:
        """True when the passing of time alone gives nothing more out."""
        return self.counts.idle

    @property
    def map(self) -> LaneMap:
        """Return the lane map in force; its version is 0 while there is none."""
        return self.mapping.map


def initial_state() -> TrafficState:
    """Return the state before the first frame."""
    return TrafficState(
        no_mapping(), chart_of(NO_MAP), no_vehicles(), no_paths(), no_changes(), nothing_counted()
    )


def begun_anew(state: TrafficState) -> TrafficState:
    """Return the state at the start of a new epoch: no vehicles, but the lanes stay those of the road."""
    return replace(initial_state(), mapping=lane_mapping.begun_anew(state.mapping))


def step(
    state: TrafficState, moment: Moment, estimates: TrackEstimates, setup: TrafficSetup
) -> tuple[TrafficState, TrackEstimates, Outputs]:
    """Return the state after a frame or a tick, the tracks with lane and motion state, and the outputs."""
    p = setup.parameters
    state, found, traced, coming = _map_in_force(state, moment, setup)
    version = state.map.version
    vehicles, gone = parted(state.vehicles, estimates.number)
    left = unfinished(gone, moment.time_us, version, p.assignment)
    measured = measured_of(estimates)
    lane, crossed = assign(vehicles, moment, measured, state.chart, version, p.assignment)
    motion = classify(vehicles, moment, measured, state.chart, setup.travel_heading_rad, p.motion)
    estimates = dataclasses.replace(estimates, lane=lane, motion=motion)
    paths, finished = follow(state.paths, moment, estimates, measured.across_std_m, p.paths)
    counts, counted = count(state.counts, moment, estimates, measured, state.map, setup)
    changes, sure = confirm(
        state.changes, (*left, *crossed, *coming), paths, finished, state.map, moment.time_us, p.changes
    )
    mapping, drift = state.mapping, None
    if traced or sure:
        mapping, sure = lane_mapping.told_once(mapping, (*traced, *sure), p.mapping)
    if finished:
        mapping, drift = lane_mapping.gather(mapping, finished, p.evidence, p.drift, p.mapping)
    if not moment.tick:
        mapping = lane_mapping.look(mapping, moment, setup.config.sensor_id, paths, p, setup.digest)
    state = TrafficState(mapping, state.chart, vehicles, paths, changes, counts)
    return state, estimates, Outputs(finished, sure, found, drift, counted)


def last_words(state: TrafficState) -> Outputs:
    """Return what has not been given out yet, where an epoch ends."""
    return Outputs(counts=report(state.counts))


def _map_in_force(
    state: TrafficState, moment: Moment, setup: TrafficSetup
) -> tuple[TrafficState, LaneMap | None, tuple[LaneChange, ...], tuple[LaneChange, ...]]:
    """Return the state at a frame, the map that came into force with it, and what it tells of the past.

    That is the changes of vehicles that have gone, and those of vehicles still there, which are to be judged.
    """
    if moment.tick:
        return state, None, (), ()
    before = state.mapping
    mapping = lane_mapping.begin(before, moment, setup.given, setup.parameters, setup.digest)
    if mapping is before:
        return state, None, (), ()
    state = replace(state, mapping=mapping)
    if mapping.map is before.map:
        return state, None, (), ()
    state = replace(state, chart=chart_of(mapping.map))
    if mapping.map.source != "learned" or not lane_mapping.young(before, setup.parameters.mapping):
        return state, mapping.map, (), ()
    return trace_back(state, before, moment.time_us, setup.parameters)


def trace_back(
    state: TrafficState, before: Mapping, now_us: int, p: TrafficParameters
) -> tuple[TrafficState, LaneMap, tuple[LaneChange, ...], tuple[LaneChange, ...]]:
    """Judge by the map of the state what was seen before it: vehicles that have gone, and those still there.

    Returns the state, its map, the changes of lanes of the former, and those of the latter, to be judged.
    """
    gone = join((no_samples(), *(path.samples for path in before.backlog)))
    past = join((state.paths.past, *state.paths.recent))
    version = state.map.version
    passing = no_vehicles(np.unique(gone.number))
    found = retrace(passing, gone, state.chart, version, p.assignment)[1]
    found += unfinished(passing, now_us, version, p.assignment)
    told = judged(found, join((gone, past)), state.map, now_us, p.changes)
    vehicles = _unjudged(aligned(state.vehicles, state.paths.number))
    here: Samples = retraced(past, state.paths.number)
    lane, coming = retrace(vehicles, here, state.chart, version, p.assignment)
    paths = replace(state.paths, past=replace(here, lane=lane), recent=())
    # what was pending is found again
    waiting = replace(state.changes, pending=())
    state = replace(state, vehicles=vehicles, paths=paths, changes=waiting)
    return state, state.map, tuple(sorted(told, key=lambda c: (c.time_us, c.number))), coming


def _unjudged(vehicles: Vehicles) -> Vehicles:
    """Return the vehicles as if their lanes had never been judged; how they move is known all the same."""
    fresh = no_vehicles(vehicles.number)
    whole, real = fresh.whole.copy(), fresh.real.copy()
    whole[:, MOTION_COLUMNS] = vehicles.whole[:, MOTION_COLUMNS]
    real[:, AHEAD_COLUMNS] = vehicles.real[:, AHEAD_COLUMNS]
    return Vehicles(vehicles.number, whole, real)
