"""The state of one sensor's tracker: tracks as arrays, recent points, maps and counters.

A value, never changed in place.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from service.tracking.boxes import POINT_COLUMNS
from service.tracking.clutter import ClutterMap
from service.tracking.model import F64, I64, U8, Bool, TrackStatus
from service.tracking.recovery import TrailBook
from service.tracking.road_map import RoadMap

_TENTATIVE = int(TrackStatus.TENTATIVE)  # numpy compares with a member of an enumeration ten times slower
EXTENT_MEMORY = 30  # hits whose extent along the box is remembered


@dataclass(frozen=True)
class Tracks:
    """T tracks, in order of number. Mean is [x vx ax y vy ay] of the box centre in the plan frame.

    Without slots, so that `_with_columns` may set all at once.
    """

    number: I64
    mean: F64  # (T, 6)
    cov: F64  # (T, 6, 6)
    memory: F64  # (T, k) what the filter remembers
    heading_rad: F64  # of the long axis, clockwise from +y
    heading_var: F64  # rad^2
    turn_rate_radps: F64  # clockwise
    drift: F64  # running mean of the normalised sideways residual
    ahead_m: F64  # running mean of how far ahead its points put it, slow and seen side-on
    crept_m: F64  # way from the radar that its range rates told while it went slowly
    scatter: F64  # running mean of the normalised square of its points' places across it
    length_m: F64
    width_m: F64
    log_odds: F64  # of existence
    status: U8
    hits: I64
    empty: I64  # frames in a row without an associated point
    born_us: I64
    hit_us: I64  # time of the last hit
    born_x_m: F64
    born_y_m: F64
    standing: Bool  # born as a standing object
    detect_rate: F64  # running share of frames with a point
    points_per_hit: F64  # running mean
    echo_db: F64  # running mean echo strength, R^4 taken out
    extent_m: F64  # (T, EXTENT_MEMORY) extents along the box, NaN where not yet
    map_cell: I64  # last cell taught to the road map, -1 none
    way_m: F64  # (T, 4) where it was two cells ago and one cell ago, x and y, NaN where not yet

    def __len__(self) -> int:
        return len(self.number)

    def take(self, index: I64 | Bool) -> Tracks:
        """Return the tracks at `index` (integers or a mask)."""
        where = np.flatnonzero(index) if index.dtype == np.bool_ else index
        return _with_columns({name: column.take(where, axis=0) for name, column in vars(self).items()})

    def join(self, other: Tracks) -> Tracks:
        """Return these tracks followed by the others."""
        theirs = vars(other)
        return _with_columns(
            {name: np.concatenate((column, theirs[name])) for name, column in vars(self).items()}
        )

    def but(self, **columns: F64 | I64 | U8 | Bool) -> Tracks:
        """Return these tracks with some columns exchanged."""
        return _with_columns(vars(self) | columns)

    @property
    def x_m(self) -> F64:
        """Centre to the right of the radar, (T,)."""
        return self.mean[:, 0]

    @property
    def y_m(self) -> F64:
        """Centre ahead of the radar, (T,)."""
        return self.mean[:, 3]

    @property
    def speed_mps(self) -> F64:
        """Length of the velocity, (T,)."""
        return np.hypot(self.mean[:, 1], self.mean[:, 4])

    @property
    def come_m(self) -> F64:
        """Distance from where they were born, (T,)."""
        return np.hypot(self.x_m - self.born_x_m, self.y_m - self.born_y_m)

    @property
    def confirmed(self) -> Bool:
        """Which tracks are confirmed or coasting."""
        return np.asarray(self.status != _TENTATIVE)


_COLUMNS = len(dataclasses.fields(Tracks))


def _with_columns(columns: dict[str, Any]) -> Tracks:
    """Return tracks of these columns, eight times as fast as the constructor of a frozen dataclass."""
    if len(columns) != _COLUMNS:
        raise TypeError(f"want {_COLUMNS} columns of tracks, got {', '.join(columns)}")
    tracks = object.__new__(Tracks)
    object.__setattr__(tracks, "__dict__", columns)
    return tracks


def no_tracks(memory_size: int) -> Tracks:
    """Return zero tracks."""
    f, i = np.zeros(0), np.zeros(0, dtype=np.int64)
    return Tracks(
        number=i, mean=np.zeros((0, 6)), cov=np.zeros((0, 6, 6)), memory=np.zeros((0, memory_size)),
        heading_rad=f, heading_var=f, turn_rate_radps=f, drift=f, ahead_m=f, crept_m=f, scatter=f,
        length_m=f, width_m=f, log_odds=f, status=np.zeros(0, dtype=np.uint8), hits=i, empty=i,
        born_us=i, hit_us=i, born_x_m=f, born_y_m=f, standing=np.zeros(0, dtype=np.bool_), detect_rate=f,
        points_per_hit=f, echo_db=f, extent_m=np.zeros((0, EXTENT_MEMORY)), map_cell=i,
        way_m=np.zeros((0, 4)),
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Window:
    """The points of the last frames, oldest first, and what became of them."""

    points: F64  # (N, POINT_COLUMNS)
    time_us: I64  # (N,)
    owned: Bool  # a track claimed the point when it was new
    standing: Bool  # slower than the Doppler tells from standing


def empty_window() -> Window:
    """Return a window without points."""
    return Window(
        np.zeros((0, POINT_COLUMNS)),
        np.zeros(0, dtype=np.int64),
        np.zeros(0, dtype=np.bool_),
        np.zeros(0, dtype=np.bool_),
    )


class Place(NamedTuple):
    """Where a track is and where it goes."""

    x_m: float
    y_m: float
    speed_mps: float
    heading_rad: float


@dataclass(frozen=True, slots=True)
class Resting:
    """R numbers of vehicles that fell silent in view, and M times one of them had a vehicle in its lane."""

    number: I64  # (R,)
    hit_us: I64  # (R,) time of the track's last hit
    ended_us: I64  # (R,) when its track ended: up to seconds later, it coasted on
    x_m: F64  # (R,) where it was then, and how it went
    y_m: F64
    speed_mps: F64
    heading_rad: F64
    mate_of: I64  # (M,) resting number
    mate: I64  # (M,) number of the vehicle in its lane
    mate_x_m: F64  # (M,) where that one was then
    mate_y_m: F64

    def place(self, k: int) -> Place:
        """Return where vehicle k was."""
        return Place(
            float(self.x_m[k]), float(self.y_m[k]), float(self.speed_mps[k]), float(self.heading_rad[k])
        )

    def take(self, which: Bool) -> Resting:
        """Return the vehicles of a mask (R,), with those in their lanes."""
        if which.all():
            return self
        mates = np.isin(self.mate_of, self.number[which])
        return Resting(
            self.number[which], self.hit_us[which], self.ended_us[which], self.x_m[which], self.y_m[which],
            self.speed_mps[which], self.heading_rad[which], self.mate_of[mates], self.mate[mates],
            self.mate_x_m[mates], self.mate_y_m[mates],
        )  # fmt: skip

    def join(self, other: Resting) -> Resting:
        """Return these vehicles followed by the others."""
        names = [field.name for field in dataclasses.fields(Resting)]
        return Resting(*(np.concatenate((getattr(self, n), getattr(other, n))) for n in names))


def none_resting() -> Resting:
    """Return zero numbers."""
    f, i = np.zeros(0), np.zeros(0, dtype=np.int64)
    return Resting(i, i, i, f, f, f, f, i, i, f, f)


@dataclass(frozen=True, slots=True)
class Tandems:
    """K pairs of tracks that drive as one vehicle would."""

    ahead: I64  # (K,) number
    behind: I64  # (K,) number
    frames: I64  # (K,) in a row in which they have done so


def no_tandems() -> Tandems:
    """Return zero pairs."""
    i = np.zeros(0, dtype=np.int64)
    return Tandems(i, i, i)


@dataclass(frozen=True, slots=True)
class TrackerState:
    """All that the next step needs to know of the past."""

    tracks: Tracks
    window: Window  # frames that clustering joins
    standing_window: Window  # standing points of the last second, claimed or not
    frame_times_us: tuple[int, ...]  # times of the frames in `standing_window`, oldest first
    clutter: ClutterMap
    road: RoadMap
    filter: str
    next_number: int
    frames: int
    time_us: int  # of the newest frame or tick; meaningless while frames == 0
    range_seen_min_m: float
    echo_reference_db: float  # running mean echo of confirmed vehicles
    trails: TrailBook  # where the tracks were measured lately, for the FIR recovery
    resting: Resting
    tandems: Tandems

    @property
    def idle(self) -> bool:
        """True while there is no track at all, and none whose number rests."""
        return len(self.tracks) == 0 and len(self.resting.number) == 0

    @property
    def resting_numbers(self) -> I64:
        """Return the numbers of vehicles that may be seen again, (R,)."""
        return self.resting.number
