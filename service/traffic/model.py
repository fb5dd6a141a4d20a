"""The values of traffic analysis: lanes, maps of lanes, paths of vehicles, and what a step gives out.

Plan frame of the sensor as everywhere: x to the right, y forward, metres; headings clockwise from +y. Times
are integer microseconds since 1970.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from service.tracking.model import F32, F64, I64, U8, Bool
from service.traffic.records import Counts

NO_LANE = 0  # in every column of lane indices
MOST_LANES = 255  # an index is one byte

Direction = Literal["approaching", "receding", "crossing"]
LaneKind = Literal["lane", "turn"]  # a turn is a way through a junction


@dataclass(frozen=True, slots=True)
class Lane:
    """One lane: P points of its centre line, in driving direction."""

    index: int  # 1..MOST_LANES, as in the `lane` column of states; stays with the lane from map to map
    lane_id: str
    kind: LaneKind
    direction: Direction
    points_m: F64  # (P, 2)
    width_m: F64  # (P,)
    confidence: float  # 0..1
    vehicles: int  # that the lane was learned from
    name: str = ""  # given by a user

    @property
    def length_m(self) -> float:
        """Return the length of the centre line."""
        return float(np.hypot(*np.diff(self.points_m, axis=0).T).sum())


@dataclass(frozen=True, slots=True)
class LaneMap:
    """The lanes of a sensor's road from a frame on."""

    version: int  # 1, 2, ... inside the epoch; 0: there is no map yet
    time_us: int  # of the frame from which it is in force
    frame: int
    vehicles: int  # whose paths it was learned from
    source: Literal["learned", "user"]
    lanes: tuple[Lane, ...]  # by index

    def lane(self, index: int) -> Lane | None:
        """Return the lane of an index."""
        return next((lane for lane in self.lanes if lane.index == index), None)


NO_MAP = LaneMap(version=0, time_us=0, frame=0, vehicles=0, source="learned", lanes=())


@dataclass(frozen=True, slots=True)
class Samples:
    """S samples of tracks in order of time, a metre of travel or more apart."""

    number: I64  # (S,) of the track
    time_us: I64
    x_m: F32  # centre of the vehicle's box
    y_m: F32
    vx_mps: F32
    vy_mps: F32
    lane: U8  # as judged at the time
    across_std_m: F32  # standard deviation of the place across the vehicle's heading


@dataclass(frozen=True, slots=True)
class Trajectory:
    """The path of one track that has ended."""

    number: int
    samples: Samples
    length_m: float  # NaN: not known
    width_m: float
    existence: float

    @property
    def ended_us(self) -> int:
        """Return the time of the last sample, 0 when there is none."""
        return int(self.samples.time_us[-1]) if len(self.samples.time_us) else 0


@dataclass(frozen=True, slots=True)
class LaneChange:
    """A vehicle that went from one lane into another."""

    number: int  # of the track
    time_us: int  # when its centre crossed the boundary
    decided_us: int  # when that was sure
    from_lane: int
    to_lane: int
    x_m: float  # where it crossed
    y_m: float
    speed_mps: float
    map_version: int


@dataclass(frozen=True, slots=True)
class LaneDrift:
    """Traffic has stopped fitting the map, or fits it again."""

    opened: bool
    share: float  # of the latest vehicles that drove outside every lane
    vehicles: int
    map_version: int


@dataclass(frozen=True, slots=True)
class Moment:
    """The frame or tick that is being analysed."""

    time_us: int
    frame: int  # number of the newest frame
    tick: bool  # time passed without a frame: the tracks only coasted


@dataclass(frozen=True, slots=True)
class Outputs:
    """What one step of the analysis gives out, beside the lane and motion state of each vehicle."""

    finished: tuple[Trajectory, ...] = ()
    changes: tuple[LaneChange, ...] = ()
    map: LaneMap | None = None  # that came into force
    drift: LaneDrift | None = None
    counts: Counts = field(default_factory=Counts)


def no_samples() -> Samples:
    """Return samples of nothing."""
    i, f = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.float32)
    return Samples(i, i, f, f, f, f, np.zeros(0, dtype=np.uint8), f)


def take(samples: Samples, index: I64 | Bool) -> Samples:
    """Return the samples at `index` (integers or a mask)."""
    return Samples(
        samples.number[index], samples.time_us[index], samples.x_m[index], samples.y_m[index],
        samples.vx_mps[index], samples.vy_mps[index], samples.lane[index], samples.across_std_m[index],
    )  # fmt: skip
