"""Named scenarios: a road, its traffic and a radar; `simulate` turns one into frames with truth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from service.errors import NotFound
from service.simulation.frames import US, SimulatedFrame, simulate_frames
from service.simulation.ghosts import GhostParameters
from service.simulation.lane_changes import LaneChangeParameters
from service.simulation.radar import Radar, RadarParameters
from service.simulation.roads import Road, bend, one_way, two_way
from service.simulation.scenery import Scenery, draw_scenery
from service.simulation.traffic import Signal, SlowZone, Stop, Traffic, TrafficParameters
from service.simulation.trajectories import Trajectories, TrajectorySampler
from service.simulation.vehicles import VehicleKind, VehicleStates
from service.tracking.model import Frame

START_US = 1_747_029_600 * US  # 2025-05-12T06:00:00Z
SENSOR_ID = "radar-1"
WARM_UP_STEP_S = 0.1
BUSY = LaneChangeParameters(advantage_mps2=0.15, without_need=0.05, rest_s=4.0)
HEAVY = {VehicleKind.CAR: 0.70, VehicleKind.TRUCK: 0.16, VehicleKind.BUS: 0.07, VehicleKind.MOTORCYCLE: 0.07}


@dataclass(frozen=True, slots=True)
class Scenario:
    """A site with its traffic, ready to be simulated."""

    name: str
    about: str
    kind: str
    road: Road
    traffic: TrafficParameters
    radar: RadarParameters = field(default_factory=RadarParameters)
    duration_s: float = 60.0
    warm_up_s: float = 60.0  # until the road is full
    pole_spacing_m: float = 35.0


def _motorway() -> Scenario:
    return Scenario(
        "motorway",
        "3 lanes one way, free flow, approaching",
        "one_way",
        one_way(3, approaching=True),
        TrafficParameters(approaching_vph=3000, speed_limit_mps=25.0),
        duration_s=90.0,
    )


def _dense() -> Scenario:
    return Scenario(
        "dense",
        "3 lanes one way near capacity, receding, slow-downs and many lane changes",
        "one_way",
        one_way(3, approaching=False, x_m=-0.5),
        TrafficParameters(
            receding_vph=5000,
            speed_limit_mps=16.7,
            lane_change=BUSY,
            slow_zones=(SlowZone(95.0, 125.0, 8.0, start_s=70.0, duration_s=18.0, period_s=45.0),),
        ),
    )


def _queue() -> Scenario:
    return Scenario(
        "queue",
        "3 lanes approaching a signal at 8 m: queues and start-up waves",
        "one_way",
        one_way(3, approaching=True),
        TrafficParameters(
            approaching_vph=2400,
            speed_limit_mps=15.0,
            signals=(Signal(8.0, -1, green_s=20.0, amber_s=3.0, red_s=18.0),),
        ),
        duration_s=90.0,
        warm_up_s=90.0,
    )


def _two_way() -> Scenario:
    return Scenario(
        "two_way",
        "2 + 2 lanes with a rail in the median",
        "two_way",
        two_way(2, x_m=-1.0),
        TrafficParameters(receding_vph=1700, approaching_vph=1900, speed_limit_mps=16.7, lane_change=BUSY),
        duration_s=75.0,
    )


def _curve() -> Scenario:
    heading = math.radians(-6.0)
    return Scenario(
        "curve",
        "3 lanes approaching round a bend of radius 250 m to the right",
        "one_way",
        bend(one_way(3, approaching=True), radius_m=250.0, straight_to_m=15.0, heading_rad=heading),
        TrafficParameters(approaching_vph=3000, speed_limit_mps=19.4),
        duration_s=75.0,
    )


def _wide() -> Scenario:
    return Scenario(
        "wide",
        "6 lanes approaching, many trucks, heavy clutter, ghosts, dropped frames, jitter",
        "one_way",
        one_way(6, approaching=True, x_m=4.0),
        TrafficParameters(approaching_vph=6500, speed_limit_mps=19.4, mix=HEAVY),
        radar=RadarParameters(
            false_alarms=14.0,
            clutter_db=5.0,
            azimuth_std_rad=math.radians(0.4),
            ghost=GhostParameters(rate_per_s=0.2, loss_db=11.0),
            drop_probability=0.02,
            jitter_s=0.004,
        ),
        pole_spacing_m=14.0,
    )


def _demo() -> Scenario:
    return Scenario(
        "demo",
        "2 + 2 lanes with lane changes, a slow-down every two minutes and a breakdown every four",
        "two_way",
        two_way(2, x_m=-1.0),
        TrafficParameters(
            receding_vph=2200,
            approaching_vph=2200,
            speed_limit_mps=16.7,
            lane_change=BUSY,
            slow_zones=(SlowZone(30.0, 60.0, 3.0, start_s=90.0, duration_s=20.0, period_s=120.0),),
            stops=(Stop("R1", 95.0, start_s=120.0, duration_s=25.0, period_s=240.0),),
        ),
        duration_s=120.0,
        warm_up_s=50.0,
    )


SCENARIOS: dict[str, Scenario] = {
    s.name: s for s in (_motorway(), _dense(), _queue(), _two_way(), _curve(), _wide(), _demo())
}


def scenario_named(name: str) -> Scenario:
    """Return the scenario; raises NotFound naming those that exist."""
    if name not in SCENARIOS:
        raise NotFound(f"no scenario {name!r}; there are {', '.join(SCENARIOS)}")
    return SCENARIOS[name]


def simulate(
    scenario: Scenario | str,
    *,
    seed: int,
    duration_s: float | None = None,
    start_us: int = START_US,
    sensor_id: str = SENSOR_ID,
) -> Iterator[SimulatedFrame]:
    """Yield the frames of a scenario, without end when `duration_s` is None; equal for equal seeds.

    Traffic, radar and frame timing draw from independent generators: another radar sees the same traffic.
    """
    chosen = scenario_named(scenario) if isinstance(scenario, str) else scenario
    traffic_rng, radar_rng, timing_rng = _generators(seed)
    traffic = Traffic(chosen.road, chosen.traffic, traffic_rng)
    traffic.run(chosen.warm_up_s, WARM_UP_STEP_S)
    scenery = draw_scenery(chosen.road, radar_rng, pole_spacing_m=chosen.pole_spacing_m)
    radar = Radar(chosen.radar, scenery, radar_rng)
    start_s = traffic.time_s

    def states_after(time_s: float) -> VehicleStates | None:
        if duration_s is not None and time_s >= duration_s:
            return None
        traffic.step(start_s + time_s - traffic.time_s)
        return traffic.states()

    return simulate_frames(states_after, radar, timing_rng, start_us=start_us, sensor_id=sensor_id)


def endless_frames(
    scenario: Scenario | str = "demo", *, seed: int, start_us: int = START_US, sensor_id: str = SENSOR_ID
) -> Iterator[Frame]:
    """Yield the frames of a scenario alone, without end, for a live demonstration."""
    return (s.frame for s in simulate(scenario, seed=seed, start_us=start_us, sensor_id=sensor_id))


def from_trajectories(  # noqa: PLR0913 - one keyword for each option
    trajectories: Trajectories,
    *,
    seed: int,
    radar: RadarParameters | None = None,
    scenery: Scenery | None = None,
    start_us: int = START_US,
    sensor_id: str = SENSOR_ID,
) -> Iterator[SimulatedFrame]:
    """Yield the frames of a radar at the origin of given trajectories, which look along +y.

    Use `Trajectories.moved` first to put the radar elsewhere. Time runs from the first row to the last.
    """
    _, radar_rng, timing_rng = _generators(seed)
    sampler = TrajectorySampler(trajectories)
    first_s, last_s = sampler.span_s()
    instrument = Radar(radar or RadarParameters(), scenery or Scenery.empty(), radar_rng)

    def states_after(time_s: float) -> VehicleStates | None:
        return sampler.states_at(first_s + time_s) if first_s + time_s <= last_s else None

    return simulate_frames(states_after, instrument, timing_rng, start_us=start_us, sensor_id=sensor_id)


def _generators(seed: int) -> tuple[np.random.Generator, np.random.Generator, np.random.Generator]:
    traffic, radar, timing = np.random.default_rng(seed).spawn(3)
    return traffic, radar, timing
