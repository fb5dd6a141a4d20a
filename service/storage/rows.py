"""The rows that the fold produces and the database keeps; plain values, no SQL."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

STATE_SAMPLE = np.dtype(
    [
        ("x_m", "<f4"),
        ("y_m", "<f4"),
        ("vx_mps", "<f4"),
        ("vy_mps", "<f4"),
        ("std_x_m", "<f2"),
        ("std_y_m", "<f2"),
        ("lane", "u1"),
        ("status", "u1"),  # tracking.model.TrackStatus, and MotionState << MOTION_SHIFT
        ("frame_offset", "<u2"),  # frame number less the block's first
        ("time_offset_ms", "<u2"),  # time less the block's second
    ]
)  # 26 bytes a sample; half precision keeps a standard deviation to three digits


@dataclass(frozen=True, slots=True)
class TrackKey:
    """Identity of a track; the public track_id is "<sensor>-<epoch>-<number>"."""

    sensor_id: str
    epoch: int
    number: int

    def __str__(self) -> str:
        return f"{self.sensor_id}-{self.epoch}-{self.number}"


@dataclass(frozen=True, slots=True)
class StateBlock:
    """The states of one track inside one whole second; written once, a repeat changes nothing."""

    key: TrackKey
    second: int  # seconds since 1970
    first_frame: int
    samples: bytes  # array of STATE_SAMPLE


@dataclass(frozen=True, slots=True)
class TrackSummary:
    """What is known of a track so far; a later `as_of` (log position) replaces an earlier one."""

    key: TrackKey
    as_of: int
    ended: bool
    first_time_us: int
    last_time_us: int
    first_frame: int
    last_frame: int
    states: int
    hits: int
    length_m: float | None
    width_m: float | None
    length_class: str | None  # motorcycle, short, medium, long
    existence: float
    first_x_m: float
    first_y_m: float
    last_x_m: float
    last_y_m: float
    distance_m: float
    mean_speed_mps: float
    max_speed_mps: float


@dataclass(frozen=True, slots=True)
class EventRow:
    """Something that happened at a sensor, such as a restart of its tracker."""

    sensor_id: str
    epoch: int
    number: int  # counter inside the epoch
    as_of: int
    kind: str  # for example "tracker_restarted"
    time_us: int
    detail: dict[str, str | int | float | None]


@dataclass(frozen=True, slots=True)
class LaneChangeRow:
    """A vehicle that went from one lane into another; written once, a repeat changes nothing."""

    key: TrackKey
    time_us: int  # when its centre crossed the boundary
    decided_us: int
    from_lane: int
    to_lane: int
    x_m: float
    y_m: float
    speed_mps: float
    map_version: int


@dataclass(frozen=True, slots=True)
class LaneMapRow:
    """The lanes of a sensor from a moment on; written once, a repeat changes nothing."""

    sensor_id: str
    epoch: int
    version: int  # inside the epoch
    time_us: int
    frame: int
    vehicles: int
    source: str  # learned, user
    lanes: str  # canonical JSON: service.formats.lanes


@dataclass(frozen=True, slots=True)
class CrossingBlock:
    """The crossings of one line in one minute; a later `as_of` replaces an earlier one."""

    sensor_id: str
    epoch: int
    line_id: str
    minute: int  # since 1970
    part: int  # 0; of crossings that became certain long after their minute, a number of their own
    as_of: int
    records: bytes  # array of traffic.records.CROSSING

    @property
    def key(self) -> tuple[object, ...]:
        """Return what names the row."""
        return self.sensor_id, self.epoch, self.line_id, self.minute, self.part


@dataclass(frozen=True, slots=True)
class MinuteRow:
    """The frames of one minute; a later `as_of` replaces an earlier one."""

    sensor_id: str
    epoch: int
    minute: int  # since 1970
    as_of: int
    frames: int
    expected: int  # of a whole minute
    observed_us: int

    @property
    def key(self) -> tuple[object, ...]:
        """Return what names the row."""
        return self.sensor_id, self.epoch, self.minute


@dataclass(frozen=True, slots=True)
class CellRow:
    """Edie's sums of one minute over the cells of one lane map; a later `as_of` replaces an earlier one."""

    sensor_id: str
    epoch: int
    minute: int  # since 1970
    map_version: int
    as_of: int
    cells: bytes  # array of traffic.cells.CELL

    @property
    def key(self) -> tuple[object, ...]:
        """Return what names the row."""
        return self.sensor_id, self.epoch, self.minute, self.map_version


@dataclass(frozen=True, slots=True)
class Rows:
    """What one or more folded records add to the database."""

    blocks: tuple[StateBlock, ...] = ()
    tracks: tuple[TrackSummary, ...] = ()
    events: tuple[EventRow, ...] = ()
    lane_changes: tuple[LaneChangeRow, ...] = ()
    lane_maps: tuple[LaneMapRow, ...] = ()
    crossings: tuple[CrossingBlock, ...] = ()
    minutes: tuple[MinuteRow, ...] = ()
    cells: tuple[CellRow, ...] = ()

    def __bool__(self) -> bool:
        return any(getattr(self, item.name) for item in dataclasses.fields(self))


_ADVANCING = frozenset({"tracks", "crossings", "minutes", "cells"})  # rows of which only the newest counts


def merge_rows(parts: Iterable[Rows]) -> Rows:
    """Return the rows of several records as one; of a row that advances only the newest remains."""
    parts = list(parts)
    joined = {}
    for name in (item.name for item in dataclasses.fields(Rows)):
        rows = [row for part in parts for row in getattr(part, name)]
        joined[name] = tuple({row.key: row for row in rows}.values() if name in _ADVANCING else rows)
    return Rows(**joined)
