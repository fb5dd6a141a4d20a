"""Turn track estimates, fresh or stored, into the lines of tracks.jsonl and the tracks of the live view.

Numbers are rendered from float32 (standard deviations from float16) and rounded to the millimetre, so that
the line of a frame is the same bytes whether it comes from the tracker or from the database.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import orjson
from numpy.typing import NDArray

from service.formats.georeference import Pose, to_wgs84
from service.formats.length_class import LENGTH_BOUNDS_M, length_class
from service.formats.rfc3339 import format_time
from service.tracking.model import F32, I64, MOTION_SHIFT, U8, MotionState, TrackEstimates, TrackStatus

STATUS_TEXT = tuple(status.name.lower() for status in TrackStatus)
MOTION_TEXT = tuple(motion.name.lower() for motion in MotionState)

_MILLIMETRE = 3  # decimals
_STATE_FIELDS = ("x_m", "y_m", "vx_mps", "vy_mps", "std_x_m", "std_y_m")


@dataclass(frozen=True, slots=True)
class StoredStates:
    """The stored states of all tracks (T) after one frame, by number."""

    number: I64  # (T,)
    samples: NDArray[np.void]  # (T,) of storage.rows.STATE_SAMPLE


def track_id(sensor_id: str, epoch: int, number: int) -> str:
    """Return the public name of a track."""
    return f"{sensor_id}-{epoch}-{number}"


def frame_line(
    sensor_id: str, epoch: int, frame_number: int, time_us: int, estimates: TrackEstimates
) -> bytes:
    """Return the line of one frame in tracks.jsonl, without the line break."""
    columns = [
        rounded(estimates.x_m),
        rounded(estimates.y_m),
        rounded(estimates.vx_mps),
        rounded(estimates.vy_mps),
        rounded(estimates.std_x_m.astype(np.float16)),
        rounded(estimates.std_y_m.astype(np.float16)),
    ]
    ids = [track_id(sensor_id, epoch, number) for number in estimates.number.tolist()]
    judged = (estimates.lane.tolist(), estimates.motion.tolist())
    states = _states(ids, estimates.status.tolist(), columns, *judged)
    return _line(frame_number, format_time(time_us), states)


def stored_line(sensor_id: str, epoch: int, frame_number: int, time_us: int, stored: StoredStates) -> bytes:
    """Return the line that `frame_line` gave for the frame when its tracks were new."""
    columns = [rounded(stored.samples[name]) for name in _STATE_FIELDS]
    ids = [track_id(sensor_id, epoch, number) for number in stored.number.tolist()]
    status, motion = status_and_motion(stored.samples["status"])
    states = _states(ids, status.tolist(), columns, stored.samples["lane"].tolist(), motion.tolist())
    return _line(frame_number, format_time(time_us), states)


def _states(
    ids: Sequence[str],
    status: Sequence[int],
    columns: Sequence[Sequence[float | None]],
    lane: Sequence[int],
    motion: Sequence[int],
) -> list[dict[str, object]]:
    return [
        {
            "track_id": ids[i],
            "status": STATUS_TEXT[status[i]],
            **{name: column[i] for name, column in zip(_STATE_FIELDS, columns, strict=True)},
            "lane": lane[i] or None,
            "motion": MOTION_TEXT[motion[i]],
        }
        for i in range(len(ids))
    ]


def status_and_motion(stored: U8) -> tuple[U8, U8]:
    """Return the status and the motion state that share a byte of a stored state."""
    status, motion = stored & np.uint8((1 << MOTION_SHIFT) - 1), stored >> np.uint8(MOTION_SHIFT)
    return status.astype(np.uint8), motion.astype(np.uint8)


def _line(frame_number: int, timestamp: str, states: list[dict[str, object]]) -> bytes:
    return orjson.dumps({"frame": frame_number, "timestamp": timestamp, "tracks": states})


def rounded(column: NDArray[np.floating], decimals: int = _MILLIMETRE) -> list[float | None]:
    """Return the values as rounded Python numbers, without negative zero; NaN becomes None."""
    values = (np.round(column.astype(np.float64), decimals) + 0.0).tolist()
    return [None if math.isnan(value) else value for value in values]


@dataclass(frozen=True, slots=True)
class LiveContext:
    """What the live view of a sensor adds to its estimates."""

    sensor_id: str
    epoch: int
    pose: Pose | None = None  # None: places are null
    length_bounds_m: tuple[float, ...] = LENGTH_BOUNDS_M


def live_tracks(context: LiveContext, time_us: int, estimates: TrackEstimates) -> list[dict[str, object]]:
    """Return the tracks of the live view after the frame at `time_us`, ordered by number."""
    count = len(estimates)
    if count == 0:
        return []
    places: list[tuple[float | None, float | None]] = [(None, None)] * count
    if context.pose is not None:
        x_m, y_m = estimates.x_m.astype(np.float64), estimates.y_m.astype(np.float64)
        longitude, latitude = to_wgs84(context.pose, x_m, y_m)
        places = list(zip(longitude.tolist(), latitude.tolist(), strict=True))
    columns = {name: rounded(column) for name, column in _live_columns(estimates).items()}
    heading_deg = np.round(np.degrees(estimates.heading_rad.astype(np.float64)), 1)
    headings = rounded(np.mod(heading_deg, 360.0), 1)
    numbers, hits = estimates.number.tolist(), estimates.hits.tolist()
    ages_s = ((time_us - estimates.born_us) / 1e6).tolist()
    status, lanes, motion = estimates.status.tolist(), estimates.lane.tolist(), estimates.motion.tolist()
    return [
        {
            "track_id": track_id(context.sensor_id, context.epoch, numbers[i]),
            "status": STATUS_TEXT[status[i]],
            **{name: column[i] for name, column in columns.items()},
            "heading_deg": headings[i],
            "length_class": length_class(columns["length_m"][i], context.length_bounds_m),
            "age_s": round(ages_s[i], 3),
            "hits": hits[i],
            "lane": lanes[i] or None,
            "motion": MOTION_TEXT[motion[i]],
            "longitude_deg": places[i][0],
            "latitude_deg": places[i][1],
        }
        for i in range(count)
    ]


def _live_columns(estimates: TrackEstimates) -> dict[str, F32]:
    return {
        "x_m": estimates.x_m,
        "y_m": estimates.y_m,
        "vx_mps": estimates.vx_mps,
        "vy_mps": estimates.vy_mps,
        "speed_mps": np.hypot(estimates.vx_mps, estimates.vy_mps),
        "std_x_m": estimates.std_x_m,
        "std_y_m": estimates.std_y_m,
        "cov_xy_m2": estimates.cov_xy_m2,
        "length_m": estimates.length_m,
        "width_m": estimates.width_m,
        "existence": estimates.existence,
    }
