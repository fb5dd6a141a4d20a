"""The values that flow through the tracking core: frames of detections in, track estimates out.

Plan frame of the sensor: origin on the road below the radar, x to the right, y forward along the boresight,
metres; azimuth = atan2(x, y), clockwise positive; heading likewise clockwise from +y. Radial velocity is the
range rate: positive when receding. Times are integer microseconds since 1970-01-01T00:00:00Z.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]


class TrackStatus(IntEnum):
    """Where a track stands in its life."""

    TENTATIVE = 0
    CONFIRMED = 1
    COASTING = 2
    DELETED = 3


class MotionState(IntEnum):
    """How a vehicle moves, judged over the last seconds."""

    UNCLASSIFIED = 0
    STATIONARY = 1
    MOVING = 2
    ONCOMING = 3
    START_STOP = 4


MOTION_SHIFT = 4  # stored states keep both in one byte: the status in the low four bits, the motion above


@dataclass(frozen=True, slots=True)
class Frame:
    """One scan of the radar: N point detections as columns, sign conventions and units already ours.

    `sequence` is the frame number on the wire (None: the sensor does not number its frames). Unknown radial
    velocity or SNR is NaN. Columns are float32, as the log stores them, so that a frame read from a file and
    the same frame read back from the log are equal to the bit.
    """

    sensor_id: str
    time_us: int
    sequence: int | None
    boot_id: str | None
    range_m: F32  # (N,) slant range
    azimuth_rad: F32  # (N,)
    radial_velocity_mps: F32  # (N,)
    snr_db: F32  # (N,)

    def __len__(self) -> int:
        return len(self.range_m)


@dataclass(frozen=True, slots=True)
class TrackEstimates:
    """The confirmed and coasting tracks after one frame, T of them, ordered by number.

    Position and velocity are those of the centre of the vehicle's box. float32 throughout: what is stored,
    served and written to files is rendered from these same numbers.
    """

    number: I64  # (T,) counter of the epoch, never reused inside it
    x_m: F32
    y_m: F32
    vx_mps: F32
    vy_mps: F32
    std_x_m: F32
    std_y_m: F32
    cov_xy_m2: F32
    heading_rad: F32
    length_m: F32  # NaN: not known yet
    width_m: F32  # NaN: not known yet
    existence: F32  # probability that the track is a vehicle
    status: U8  # TrackStatus
    lane: U8  # index of the lane, 0: none
    motion: U8  # MotionState
    hits: I64  # frames with an associated measurement
    born_us: I64

    def __len__(self) -> int:
        return len(self.number)


@dataclass(frozen=True, slots=True)
class StepReport:
    """Counts of one step, for metrics and for the bounds that are counts and not wall time."""

    points: int = 0
    points_static: int = 0  # taken for standing clutter
    clusters: int = 0
    tentative: int = 0
    components: int = 0  # connected components of the association
    approximated: int = 0  # components wider than the limit, solved by loopy belief propagation
    born: int = 0
    deleted: int = 0
