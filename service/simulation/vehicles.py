"""Road vehicles: their kinds, sizes and drivers, and their states at one instant as columns."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from service.tracking.model import F64, I64, U8, Bool


class VehicleKind(IntEnum):
    """The kinds of vehicle that the simulator knows."""

    CAR = 0
    TRUCK = 1
    BUS = 2
    MOTORCYCLE = 3

    @property
    def label(self) -> str:
        """Return the name used in files."""
        return self.name.lower()


Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class KindParameters:
    """Sizes of one kind (drawn evenly from the intervals) and how its drivers follow a leader.

    Sizes: European type approval limits (12 m rigid, 16.5 m articulated, 2.55 m wide, 4 m high) and the span
    of current cars. Driver values: after Treiber, Kesting 2013, "Traffic Flow Dynamics", chapter 11.
    """

    length_m: Interval
    width_m: Interval
    height_m: Interval
    acceleration_mps2: float  # the most a driver asks for
    deceleration_mps2: float  # the comfortable braking
    headway_s: float  # wanted time gap
    standstill_gap_m: float
    speed_factor: float  # wanted speed over the limit, mean
    speed_factor_std: float
    lateral_std_m: float  # of the place in the lane
    restlessness: float  # share of the lane changes without need that a car makes


KINDS: dict[VehicleKind, KindParameters] = {
    VehicleKind.CAR: KindParameters(
        (3.9, 5.1), (1.70, 1.95), (1.42, 1.85), 1.8, 2.2, 1.1, 2.0, 1.02, 0.12, 0.18, 1.0
    ),
    VehicleKind.TRUCK: KindParameters(
        (7.5, 16.0), (2.35, 2.55), (3.0, 4.0), 0.9, 1.8, 1.5, 2.5, 0.82, 0.05, 0.08, 0.2
    ),
    VehicleKind.BUS: KindParameters(
        (10.5, 12.5), (2.50, 2.55), (3.0, 3.3), 0.9, 1.8, 1.4, 2.5, 0.86, 0.04, 0.08, 0.2
    ),
    VehicleKind.MOTORCYCLE: KindParameters(
        (2.0, 2.3), (0.75, 0.90), (1.40, 1.60), 2.4, 2.5, 1.0, 1.8, 1.05, 0.14, 0.35, 1.5
    ),
}

MIX: dict[VehicleKind, float] = {
    VehicleKind.CAR: 0.80,
    VehicleKind.TRUCK: 0.10,
    VehicleKind.BUS: 0.04,
    VehicleKind.MOTORCYCLE: 0.06,
}


@dataclass(frozen=True, slots=True)
class VehicleStates:
    """V vehicles at one instant in the plan frame; the position is the centre of the box on the road."""

    vehicle_id: I64  # (V,) above 0, never used twice in one simulation
    kind: U8  # VehicleKind
    x_m: F64
    y_m: F64
    vx_mps: F64
    vy_mps: F64
    heading_rad: F64  # clockwise from +y
    length_m: F64
    width_m: F64
    height_m: F64
    lane: I64  # index into the lanes of the road, -1: in none

    def __len__(self) -> int:
        return len(self.vehicle_id)

    def take(self, index: I64 | Bool) -> VehicleStates:
        """Return the vehicles that an index or a mask picks."""
        return VehicleStates(**{f.name: getattr(self, f.name)[index] for f in dataclasses.fields(self)})

    def ground_range_m(self) -> F64:
        """Return the distance of each centre from the point below the radar."""
        return np.hypot(self.x_m, self.y_m)

    def azimuth_rad(self) -> F64:
        """Return the bearing of each centre, positive to the right."""
        return np.arctan2(self.x_m, self.y_m)


def typical_height_m(kind: U8, share: F64) -> F64:
    """Return heights `share` (0 to 1) of the way through each kind's interval, for want of known ones."""
    low, high = np.array([KINDS[k].height_m for k in VehicleKind]).T
    return np.asarray(low[kind] + share * (high - low)[kind])
