"""The vehicles on a simulated road as columns, and who drives ahead of and behind whom in each lane."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from service.simulation.car_following import FAR_M, Driver
from service.simulation.vehicles import KINDS, VehicleKind
from service.tracking.model import F64, I64, U8, Bool

TWO_SIGMA = 2.0  # where the lateral place and the speed factor are cut off
LANE_SPAN_M = 1e7  # key offset between lanes, longer than any road
WANDER_M: dict[VehicleKind, float] = {  # amplitude of the slow swing inside the lane
    VehicleKind.CAR: 0.10,
    VehicleKind.TRUCK: 0.06,
    VehicleKind.BUS: 0.06,
    VehicleKind.MOTORCYCLE: 0.20,
}


@dataclass(slots=True)
class Fleet:
    """V vehicles; `travel_m` grows in driving direction and is that of the box's centre."""

    vehicle_id: I64
    kind: U8
    lane: I64  # the lane driven in, or moved to
    old_lane: I64  # the lane moved from; equal to `lane` when not changing
    progress: F64  # of the lane change, 0 to 1
    change_s: F64  # how long the change takes at road speed
    travel_m: F64
    speed_mps: F64
    acceleration_mps2: F64
    length_m: F64
    width_m: F64
    height_m: F64
    speed_factor: F64
    mood: F64  # slow fluctuation of the wanted speed, relative
    wanted_acceleration_mps2: F64
    wanted_deceleration_mps2: F64
    headway_s: F64
    headway_share: (
        F64  # of the headway that is asked for now; small after a lane change, then growing back to 1
    )
    standstill_gap_m: F64
    lateral_m: F64  # place in the lane
    wander_phase_rad: F64
    next_thought_s: F64  # when the driver next thinks of changing lanes
    passes_signal: Bool  # too near to stop when it turned
    stop_at_m: F64  # travel at which to stand still, inf: nowhere
    stop_for_s: F64  # how long it shall stand
    stop_until_s: F64  # inf until it stands

    def __len__(self) -> int:
        return len(self.vehicle_id)

    @classmethod
    def empty(cls) -> Fleet:
        """Return a fleet without vehicles."""
        integer = {"vehicle_id", "lane", "old_lane"}
        kinds = {"kind": np.uint8, "passes_signal": np.bool_} | dict.fromkeys(integer, np.int64)
        return cls(**{f.name: np.zeros(0, kinds.get(f.name, np.float64)) for f in dataclasses.fields(cls)})

    def keep(self, mask: Bool) -> None:
        """Drop the vehicles outside the mask."""
        for f in dataclasses.fields(self):
            setattr(self, f.name, getattr(self, f.name)[mask])

    def append(self, other: Fleet) -> None:
        """Add the vehicles of another fleet behind ours."""
        for f in dataclasses.fields(self):
            setattr(self, f.name, np.concatenate([getattr(self, f.name), getattr(other, f.name)]))

    def driver(self, limit_mps: F64) -> Driver:
        """Return the drivers' values where the speed limit is `limit_mps` (V,)."""
        return Driver(
            limit_mps * self.speed_factor * (1 + self.mood),
            self.wanted_acceleration_mps2,
            self.wanted_deceleration_mps2,
            self.headway_s * self.headway_share,
            self.standstill_gap_m,
        )


def draw_vehicle(  # noqa: PLR0913 - one keyword for each given value
    kind: VehicleKind, *, vehicle_id: int, lane: int, travel_m: float, time_s: float, rng: np.random.Generator
) -> Fleet:
    """Return a fleet of one vehicle with size and driver drawn at random; its speed is still zero."""
    p = KINDS[kind]
    cut = np.clip(rng.normal(size=2), -TWO_SIGMA, TWO_SIGMA)
    vary = rng.uniform(0.85, 1.15, size=2)  # drivers differ by about a seventh in headway and acceleration
    values: dict[str, float] = {
        "vehicle_id": vehicle_id,
        "kind": kind,
        "lane": lane,
        "old_lane": lane,
        "progress": 1.0,
        "change_s": 1.0,
        "travel_m": travel_m,
        "speed_mps": 0.0,
        "acceleration_mps2": 0.0,
        "length_m": round(rng.uniform(*p.length_m), 2),
        "width_m": round(rng.uniform(*p.width_m), 2),
        "height_m": round(rng.uniform(*p.height_m), 2),
        "speed_factor": p.speed_factor + p.speed_factor_std * cut[0],
        "mood": 0.0,
        "wanted_acceleration_mps2": p.acceleration_mps2 * vary[0],
        "wanted_deceleration_mps2": p.deceleration_mps2,
        "headway_s": p.headway_s * vary[1],
        "headway_share": 1.0,
        "standstill_gap_m": p.standstill_gap_m,
        "lateral_m": p.lateral_std_m * cut[1],
        "wander_phase_rad": rng.uniform(0, 2 * np.pi),
        "next_thought_s": time_s + rng.uniform(0, 1),
        "passes_signal": False,
        "stop_at_m": np.inf,
        "stop_for_s": 0.0,
        "stop_until_s": -np.inf,
    }
    template = Fleet.empty()
    return Fleet(**{k: np.array([v], dtype=getattr(template, k).dtype) for k, v in values.items()})


@dataclass(frozen=True, slots=True)
class LaneOrder:
    """The vehicles of every lane sorted by travel; one that changes lanes stands in both.

    owner: (E,) index into the fleet. key: (E,) lane and travel in one ascending number.
    """

    owner: I64
    lane: I64
    key: F64

    @classmethod
    def of(cls, fleet: Fleet) -> LaneOrder:
        """Sort the fleet."""
        both = np.flatnonzero(fleet.old_lane != fleet.lane)
        owner = np.concatenate([np.arange(len(fleet)), both])
        lane = np.concatenate([fleet.lane, fleet.old_lane[both]])
        key = lane * LANE_SPAN_M + fleet.travel_m[owner]
        order = np.argsort(key, kind="stable")
        return cls(owner[order], lane[order], key[order])

    def leaders(self) -> I64:
        """Return for each entry the fleet index of the next vehicle ahead in its lane, -1: none."""
        ahead = np.full(len(self.owner), -1)
        same = self.lane[1:] == self.lane[:-1]
        ahead[:-1][same] = self.owner[1:][same]
        return ahead

    def around(self, lane: I64, travel_m: F64) -> tuple[I64, I64]:
        """Return the fleet indices of the nearest vehicles ahead and behind at places in lanes, -1: none."""
        place = np.searchsorted(self.key, lane * LANE_SPAN_M + travel_m)
        padded_owner = np.concatenate([[-1], self.owner, [-1]])
        padded_lane = np.concatenate([[-1], self.lane, [-1]])
        ahead = np.where(padded_lane[place + 1] == lane, padded_owner[place + 1], -1)
        behind = np.where(padded_lane[place] == lane, padded_owner[place], -1)
        return ahead, behind


def gap_m(fleet: Fleet, follower: I64, leader: I64) -> F64:
    """Return the bumper-to-bumper gaps of pairs of fleet indices; far where either is -1."""
    centre = fleet.travel_m[leader] - fleet.travel_m[follower]
    gap = centre - (fleet.length_m[leader] + fleet.length_m[follower]) / 2
    return np.where((leader < 0) | (follower < 0), FAR_M, gap)
