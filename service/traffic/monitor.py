"""One step of traffic analysis: the tracks of a frame, and what is known of the traffic before and after it.

tracks -> lane of each vehicle -> motion state -> paths -> lane map, crossings. Each stage has its own state,
parameters and outputs; all is a function of the state and the tracks, the same live and offline.
"""

from __future__ import annotations

from dataclasses import dataclass

from service.tracking.model import TrackEstimates
from service.traffic.counting import CountState, count, nothing_counted, report
from service.traffic.model import NO_MAP, LaneMap, Moment, Outputs
from service.traffic.parameters import TrafficSetup
from service.traffic.paths import Paths, follow, no_paths


@dataclass(frozen=True, slots=True)
class TrafficState:
    """What is remembered of a sensor's traffic; a value, never changed in place."""

    map: LaneMap  # in force
    paths: Paths
    counts: CountState

    @property
    def idle(self) -> bool:
        """True when the passing of time alone gives nothing more out."""
        return self.counts.idle


def initial_state() -> TrafficState:
    """Return the state before the first frame."""
    return TrafficState(map=NO_MAP, paths=no_paths(), counts=nothing_counted())


def step(
    state: TrafficState, moment: Moment, estimates: TrackEstimates, setup: TrafficSetup
) -> tuple[TrafficState, TrackEstimates, Outputs]:
    """Return the state after a frame or a tick, the tracks with lane and motion state, and the outputs."""
    p = setup.parameters
    paths, finished = follow(state.paths, moment, estimates, p.paths)
    counts, counted = count(state.counts, moment, estimates, state.map, setup)
    return TrafficState(state.map, paths, counts), estimates, Outputs(finished=finished, counts=counted)


def last_words(state: TrafficState) -> Outputs:
    """Return what has not been given out yet, where an epoch ends."""
    return Outputs(counts=report(state.counts))


def finish(state: TrafficState) -> TrafficState:
    """Return the state when every track ends at once and a new epoch begins: the map stays."""
    return TrafficState(map=state.map, paths=no_paths(), counts=nothing_counted())
