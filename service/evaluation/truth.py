"""Read a scene's directory: site, numbers and times of the frames, all vehicles in them, the true events.

Files: site.json, frames.jsonl.gz, truth.csv.gz, road_truth.json (the last three plain or with .gz).
"""

from __future__ import annotations

import csv
import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from service.errors import InvalidInput
from service.evaluation import lines
from service.formats.sensor import SensorConfig
from service.tracking.model import F64, I64

_DAY_US = 86_400_000_000
_ORIGIN_US = 6 * 3_600_000_000  # `t` of the true events counts from 06:00 of the scene's day
_COLUMNS = ("x", "y", "vx", "vy", "heading_deg", "length", "width")


@dataclass(frozen=True, slots=True)
class TruthRows:
    """N boxes of vehicles ordered by frame; the rows of frame f are start[f]:start[f + 1]."""

    start: I64  # (F + 1,)
    vehicle: I64  # (N,) id as written in the file
    x_m: F64  # (N,) centre of the box
    y_m: F64
    vx_mps: F64
    vy_mps: F64
    heading_rad: F64
    length_m: F64
    width_m: F64
    detections: I64  # points of this frame that came from the vehicle


@dataclass(frozen=True, slots=True)
class TruthLane:
    """A true lane: its centre line in driving direction, (K, 2) metres."""

    lane_id: str
    points: F64


@dataclass(frozen=True, slots=True)
class TruthCrossing:
    """The centre of a vehicle crosses a count line, `t_s` after the scene's origin."""

    line_id: str
    t_s: float
    vehicle: int
    lane_id: str
    speed_mps: float


@dataclass(frozen=True, slots=True)
class TruthChange:
    """A vehicle changes lane: the moment of crossing the boundary, and the manoeuvre around it."""

    vehicle: int
    t_s: float
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Scene:
    """A recording with its truth; times are seconds since 1970, t = 0 of the true events is `origin_s`."""

    name: str
    site: SensorConfig
    number: I64  # (F,) frame numbers in the order of time
    time_s: F64  # (F,)
    origin_s: float
    rows: TruthRows
    lanes: tuple[TruthLane, ...]
    crossings: tuple[TruthCrossing, ...]
    changes: tuple[TruthChange, ...]
    lane_users: dict[str, int]  # vehicles that crossed a count line in the lane, over the whole recording

    def until(self, seconds: float) -> Scene:
        """Return the first `seconds` of the scene; which lanes count is still judged from the whole of it.

        Raises InvalidInput when nothing would be left.
        """
        if seconds <= 0:
            raise InvalidInput.at("/until", f"want more than 0 seconds, got {seconds:g}")
        frames = int(np.count_nonzero(self.time_s < self.time_s[0] + seconds))
        end = self.rows.start[frames]
        columns = {
            field.name: getattr(self.rows, field.name)[:end]
            for field in dataclasses.fields(TruthRows)
            if field.name != "start"
        }
        return dataclasses.replace(
            self,
            number=self.number[:frames],
            time_s=self.time_s[:frames],
            rows=TruthRows(start=self.rows.start[: frames + 1], **columns),
            crossings=tuple(c for c in self.crossings if c.t_s < seconds),
            changes=tuple(c for c in self.changes if c.t_s < seconds),
        )


def read_scene(directory: Path) -> Scene:
    """Read a scene with its truth; raises InvalidInput naming file and line of what is missing or wrong."""
    site = lines.read_record(directory / "site.json")
    try:
        config = SensorConfig.model_validate(site)
    except ValidationError as error:
        raise InvalidInput(f"{directory / 'site.json'}: {error}") from None
    numbers, times_us = _read_frames(_find(directory, "frames.jsonl"))
    road_path = _find(directory, "road_truth.json")
    road = lines.read_record(road_path)
    try:
        lanes, crossings, changes = _lanes(road), _crossings(road), _changes(road)
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInput(f"{road_path}: {lines.describe(error)}") from None
    users = {lane.lane_id: {c.vehicle for c in crossings if c.lane_id == lane.lane_id} for lane in lanes}
    return Scene(
        name=str(site.get("scene", directory.name)),
        site=config,
        number=numbers,
        time_s=times_us / 1e6,
        origin_s=(int(times_us[0]) // _DAY_US * _DAY_US + _ORIGIN_US) / 1e6,
        rows=_read_rows(_find(directory, "truth.csv"), numbers),
        lanes=lanes,
        crossings=crossings,
        changes=changes,
        lane_users={name: len(vehicles) for name, vehicles in users.items()},
    )


def _find(directory: Path, name: str) -> Path:
    for path in (directory / f"{name}.gz", directory / name):
        if path.is_file():
            return path
    raise InvalidInput(f"{directory}: there is no {name} or {name}.gz")


def _read_frames(path: Path) -> tuple[I64, I64]:
    """Return numbers and times (us) of the frames."""
    pairs = lines.read_each(path, lambda q: (int(lines.number(q, "frame")), lines.time_us(q)))
    if not pairs:
        raise InvalidInput(f"{path}: holds no frames")
    numbers, times = (np.array(column, dtype=np.int64) for column in zip(*pairs, strict=True))
    if len(np.unique(numbers)) < len(numbers):
        raise InvalidInput(f"{path}: a frame number stands there twice")
    return numbers, times


def _read_rows(path: Path, numbers: I64) -> TruthRows:
    place = {int(n): index for index, n in enumerate(numbers)}
    table = csv.reader(lines.read_text(path).splitlines())
    head = {name: column for column, name in enumerate(next(table, ()))}
    try:
        at_frame, at_id, at_seen = (head[name] for name in ("frame", "id", "n_det"))
        at_real = [head[name] for name in _COLUMNS]
    except KeyError as error:
        raise InvalidInput(f"{path}, line 1: {lines.describe(error)}") from None
    frame: list[int] = []
    whole: list[tuple[int, int]] = []
    real: list[list[float]] = []
    for count, row in enumerate(table, start=2):
        try:
            frame.append(place[int(row[at_frame])])
            whole.append((int(row[at_id]), int(row[at_seen])))
            real.append([float(row[column]) for column in at_real])
        except KeyError:
            raise InvalidInput(f"{path}, line {count}: there is no frame {row[at_frame]}") from None
        except (IndexError, ValueError) as error:
            raise InvalidInput(f"{path}, line {count}: {error}") from None
    order = np.argsort(np.array(frame, dtype=np.int64), kind="stable")
    ids = np.array(whole, dtype=np.int64).reshape(-1, 2)[order]
    values = np.array(real, dtype=np.float64).reshape(-1, len(_COLUMNS))[order]
    values[:, 4] = np.array([math.radians(v) for v in values[:, 4]])
    counts = np.bincount(np.array(frame, dtype=np.int64), minlength=len(numbers))
    start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    x, y, vx, vy, heading, length, width = values.T
    return TruthRows(start, ids[:, 0], x, y, vx, vy, heading, length, width, ids[:, 1])


def _lanes(road: lines.Record) -> tuple[TruthLane, ...]:
    lanes = [(lines.text(q, "lane_id"), lines.points(q, "points")) for q in lines.items(road, "lanes")]
    for name, points in lanes:
        if len(points) < 2:  # noqa: PLR2004 - a line has two ends
            raise ValueError(f"lane {name!r} has {len(points)} points, want two or more")
    return tuple(TruthLane(name, np.array(points)) for name, points in lanes)


def _crossings(road: lines.Record) -> tuple[TruthCrossing, ...]:
    return tuple(
        TruthCrossing(
            line_id=lines.text(q, "line_id"),
            t_s=lines.number(q, "t"),
            vehicle=int(lines.number(q, "id")),
            lane_id=lines.text(q, "lane_id"),
            speed_mps=lines.number(q, "speed_mps"),
        )
        for q in lines.items(road, "crossings")
    )


def _changes(road: lines.Record) -> tuple[TruthChange, ...]:
    return tuple(
        TruthChange(
            int(lines.number(q, "id")),
            lines.number(q, "t"),
            lines.number(q, "t_start"),
            lines.number(q, "t_end"),
        )
        for q in lines.items(road, "lane_changes")
    )
