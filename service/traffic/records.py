"""Crossings as records of one minute and line, as the fold collects and the database keeps them.

Numbers are rounded to the millimetre (and millisecond) before they are put away, so that whoever computes a
figure from exported crossings has the very numbers that it was computed from here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.tracking.model import U8

MINUTE_US = 60_000_000
DECIMALS = 3

CROSSING = np.dtype(
    [
        ("time_us", "<u4"),  # after the start of the minute
        ("number", "<u4"),  # counter of the epoch
        ("track", "<u4"),
        ("vehicle", "<u4"),  # number of the vehicle's first track
        ("frame", "<u4"),  # newest frame at the crossing
        ("map_version", "<u4"),
        ("lane", "u1"),  # 0: none
        ("direction", "i1"),
        ("x_m", "<f4"),
        ("y_m", "<f4"),
        ("speed_mps", "<f4"),
        ("length_m", "<f4"),  # NaN: not known
        ("headway_s", "<f4"),  # NaN: not known
        ("gap_s", "<f4"),
        ("probability", "<f4"),
    ]
)


@dataclass(frozen=True, slots=True)
class MinuteBlock:
    """The crossings of one line inside one minute, in the order in which they became certain."""

    line_id: str
    minute: int  # since 1970
    part: int  # 0; of crossings that became certain after the minute was closed, the time of that
    records: U8  # (N, CROSSING.itemsize)

    def table(self) -> NDArray[np.void]:
        """Return the records as an array of CROSSING."""
        return self.records.reshape(-1).view(CROSSING)


@dataclass(frozen=True, slots=True)
class Crossing:
    """One vehicle over one line."""

    line_id: str
    time_us: int  # of the centre of the vehicle's box
    track: int  # number of the track that went over the line
    vehicle: int  # number of the first track of the same vehicle
    frame: int  # newest frame at the crossing
    lane: int  # index in the lane map, 0: none
    direction: int  # +1: to the left of the way from p0 to p1, -1: to the right
    x_m: float
    y_m: float
    speed_mps: float
    length_m: float  # NaN: not known
    probability: float  # that the crossing is real
    map_version: int = 0  # of the lane map, 0: none
    headway_s: float = math.nan  # bumper to bumper, after the vehicle before in lane and direction
    gap_s: float = math.nan
    number: int = 0  # counter of the epoch


def record_of(crossing: Crossing) -> U8:
    """Return one crossing as a record (1, CROSSING.itemsize)."""
    x = crossing
    reals = (x.x_m, x.y_m, x.speed_mps, x.length_m, x.headway_s, x.gap_s, x.probability)
    whole = (x.time_us % MINUTE_US, x.number, x.track, x.vehicle, x.frame, x.map_version, x.lane, x.direction)
    record = np.array([(*whole, *(round(value, DECIMALS) for value in reals))], CROSSING)
    return record.view(np.uint8).reshape(1, -1)


@dataclass(frozen=True, slots=True)
class Leader:
    """The newest vehicle over a line in one lane and direction, which the next one's headway refers to."""

    line_id: str
    lane: int
    direction: int
    front_us: int  # when its front bumper crossed
    passing_s: float  # from its front to its rear bumper


@dataclass(frozen=True, slots=True)
class Received:
    """What came in one minute."""

    minute: int  # since 1970
    frames: int
    expected: int  # frames that a whole minute has at the sensor's rate
    observed_us: int  # without the stretches in which no frame came for longer than the tracker bridges


@dataclass(frozen=True, slots=True)
class CellSums:
    """Edie's sums of one minute on one lane map."""

    minute: int
    map_version: int
    records: U8  # (N, CELL.itemsize)


@dataclass(frozen=True, slots=True)
class Counts:
    """What one step gives out; all but the crossings again and again until they are final."""

    crossings: tuple[Crossing, ...] = ()
    blocks: tuple[MinuteBlock, ...] = ()
    received: tuple[Received, ...] = ()
    cells: tuple[CellSums, ...] = ()
