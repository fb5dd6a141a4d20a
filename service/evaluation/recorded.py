"""Read a tracker's output: tracks, crossings, lanes and lane changes as written into files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from service.errors import InvalidInput
from service.evaluation import lines
from service.evaluation.truth import Scene
from service.tracking.model import F64, I64

TrackId = int | str
_COUNTED = frozenset({"confirmed", "coasted", "coasting"})
_SINCE_1970_S = 1e8  # a larger `t` is seconds since 1970, a smaller one since the scene's origin
_NEAR_S = 0.03  # a record without a frame number belongs to the frame this near in time


@dataclass(frozen=True, slots=True)
class RecordedTracks:
    """N track states ordered by frame; the rows of frame f are start[f]:start[f + 1]."""

    ids: tuple[TrackId, ...]  # the track ids of the file, ordered by their text
    start: I64  # (F + 1,)
    track: I64  # (N,) index into `ids`
    x_m: F64
    y_m: F64
    vx_mps: F64
    vy_mps: F64
    length_m: F64  # of the vehicle, NaN: not told


@dataclass(frozen=True, slots=True)
class FoundCrossing:
    """A crossing that the tracker reports; `t_s` after the scene's origin. NaN and None: not reported."""

    line_id: str
    t_s: float
    lane_id: TrackId | None
    x_m: float
    y_m: float
    speed_mps: float


@dataclass(frozen=True, slots=True)
class FoundChange:
    """A lane change that the tracker reports."""

    t_s: float
    track_id: TrackId


@dataclass(frozen=True, slots=True)
class FoundLane:
    """A lane that was learned: its centre line in driving direction, (K, 2) metres."""

    lane_id: TrackId
    points: F64


State = tuple[float, float, float, float]  # x, y [m], vx, vy [m/s]
SizedState = tuple[float, float, float, float, float]  # and the length [m]


def record(frames: Sequence[Mapping[TrackId, State | SizedState]]) -> RecordedTracks:
    """Return the states of all frames, given for each frame by track id, as arrays."""
    names = sorted({name for frame in frames for name in frame}, key=str)
    index = {name: i for i, name in enumerate(names)}
    states = [(*state, math.nan)[:5] for frame in frames for state in frame.values()]
    values = np.array(states, dtype=np.float64).reshape(-1, 5)
    start = np.concatenate([[0], np.cumsum([len(frame) for frame in frames])]).astype(np.int64)
    track = np.array([index[name] for frame in frames for name in frame], dtype=np.int64)
    return RecordedTracks(tuple(names), start, track, *values.T)


def read_tracks(path: Path, scene: Scene, summaries: Path | None = None) -> RecordedTracks:
    """Read tracks as JSON lines: one record for each frame with "tracks", or one for each track and frame.

    A state's `length_m` is read where it is told; else the track's own length, from its summary, if there is
    one.

    The frame number decides to which frame a record belongs, without one (or with an unknown one) the time;
    records of other frames and tracks that are not confirmed are left out. Raises InvalidInput with file
    and line.
    """
    place = {int(n): i for i, n in enumerate(scene.number)}
    lengths = {} if summaries is None else _lengths(summaries)
    frames: list[dict[TrackId, SizedState]] = [{} for _ in scene.number]
    for count, entry in lines.read_records(path):
        try:
            frame = _frame_of(entry, place, scene.time_s)
            if frame is None:
                continue
            for state in lines.items(entry, "tracks") if "tracks" in entry else [entry]:
                if state.get("status", "confirmed") in _COUNTED:
                    name = _name(state["track_id"], "track_id")
                    told = _optional(state, "length_m", "length")
                    length_m = lengths.get(name, math.nan) if math.isnan(told) else told
                    frames[frame][name] = (*_state(state), length_m)
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidInput(f"{path}, line {count}: {lines.describe(error)}") from None
    return record(frames)


def read_crossings(path: Path, scene: Scene) -> list[FoundCrossing]:
    """Read crossings as JSON lines (`line_id`, `timestamp` or `t`, `lane_id`, `x`, `y`, `speed_mps`)."""

    def parse(entry: lines.Record) -> FoundCrossing:
        lane = entry.get("lane_id")
        at = entry.get("x") is not None
        return FoundCrossing(
            line_id=lines.text(entry, "line_id"),
            t_s=_event_time(entry, scene),
            lane_id=None if lane is None else _name(lane, "lane_id"),
            x_m=lines.number(entry, "x") if at else math.nan,
            y_m=lines.number(entry, "y") if at else math.nan,
            speed_mps=_optional(entry, "speed_mps", "speed"),
        )

    return lines.read_each(path, parse)


def read_changes(path: Path, scene: Scene) -> list[FoundChange]:
    """Read lane changes as JSON lines (`timestamp`, `track_id`)."""
    return lines.read_each(
        path, lambda q: FoundChange(_event_time(q, scene), _name(q["track_id"], "track_id"))
    )


def read_lanes(path: Path) -> list[FoundLane]:
    """Read learned lanes: {"lanes": [{"lane_id", "points"}]}; those of less than two points are left out."""
    whole = lines.read_record(path)
    try:
        found = {
            _name(q["lane_id"], "lane_id"): lines.points(q, "points") for q in lines.items(whole, "lanes")
        }
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInput(f"{path}: {lines.describe(error)}") from None
    return [FoundLane(name, np.array(points)) for name, points in found.items() if len(points) > 1]


def _frame_of(entry: lines.Record, place: dict[int, int], time_s: F64) -> int | None:
    if entry.get("frame") is not None:
        known = place.get(int(lines.number(entry, "frame")))
        if known is not None:
            return known
    if "timestamp" not in entry:
        return None
    apart = np.abs(time_s - lines.time_us(entry) / 1e6)
    nearest = int(np.argmin(apart))
    return nearest if apart[nearest] < _NEAR_S else None


def _lengths(path: Path) -> dict[TrackId, float]:
    """Return the length of each track whose summary tells one."""
    pairs = lines.read_each(path, lambda q: (_name(q["track_id"], "track_id"), _optional(q, "length_m")))
    return {name: length_m for name, length_m in pairs if not math.isnan(length_m)}


def _state(state: lines.Record) -> State:
    x, y = lines.number(state, "x", "x_m"), lines.number(state, "y", "y_m")
    vx = lines.number(state, "vx", "vx_mps") if "vx" in state or "vx_mps" in state else 0.0
    vy = lines.number(state, "vy", "vy_mps") if "vy" in state or "vy_mps" in state else 0.0
    return x, y, vx, vy


def _event_time(entry: lines.Record, scene: Scene) -> float:
    if "timestamp" in entry:
        return lines.time_us(entry) / 1e6 - scene.origin_s
    t_s = lines.number(entry, "t")
    return t_s - scene.origin_s if t_s > _SINCE_1970_S else t_s


def _optional(entry: lines.Record, *names: str) -> float:
    return lines.number(entry, *names) if any(entry.get(name) is not None for name in names) else math.nan


def _name(value: object, field: str) -> TrackId:
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise TypeError(f"{field!r} is {value!r}, want text or a whole number")
    return value
