"""Turn track estimates, fresh or stored, into the lines of tracks.jsonl and the tracks of the live view.

Numbers are rendered from float32 (standard deviations from float16) and rounded to the millimetre, so that
the line of a frame is the same bytes whether it comes from the tracker or from the database.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
import orjson
from numpy.typing import NDArray

from service.formats.georeference import Pose, to_wgs84
from service.formats.length_class import LENGTH_BOUNDS_M, length_class
from service.formats.rfc3339 import format_time
from service.tracking.model import F32, TrackEstimates, TrackStatus

STATUS_TEXT = tuple(status.name.lower() for status in TrackStatus)

_MILLIMETRE = 3  # decimals
_STATE_FIELDS = ("x_m", "y_m", "vx_mps", "vy_mps", "std_x_m", "std_y_m")


@dataclass(frozen=True, slots=True)
class StoredStates:
    """The stored states of one track inside one second: N samples as storage.rows.STATE_SAMPLE."""

    epoch: int
    number: int
    second: int
    first_frame: int
    samples: NDArray[np.void]


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
    states = _states(ids, estimates.status.tolist(), columns, estimates.lane.tolist())
    return _line(frame_number, format_time(time_us), states)


def stored_lines(sensor_id: str, blocks: Iterable[StoredStates]) -> list[bytes]:
    """Return the lines of every frame in the blocks of one sensor, ordered by time.

    Whole seconds give whole lines: hand over all blocks of a second together.
    """
    rows = sorted((row for block in blocks for row in _rows(sensor_id, block)), key=lambda row: row[:2])
    return [
        _line(frame, format_time(time_ms * 1000), [row[2] for row in group])
        for (time_ms, _, frame), group in groupby(rows, key=lambda row: row[0])
    ]


_Order = tuple[int, int, int]  # time in milliseconds, epoch, frame


def _rows(sensor_id: str, block: StoredStates) -> list[tuple[_Order, int, dict[str, object]]]:
    samples = block.samples
    columns = [rounded(samples[name]) for name in _STATE_FIELDS]
    ids = [track_id(sensor_id, block.epoch, block.number)] * len(samples)
    states = _states(ids, samples["status"].tolist(), columns, samples["lane"].tolist())
    return [
        ((block.second * 1000 + offset_ms, block.epoch, block.first_frame + offset), block.number, state)
        for offset_ms, offset, state in zip(
            samples["time_offset_ms"].tolist(), samples["frame_offset"].tolist(), states, strict=True
        )
    ]


def _states(
    ids: Sequence[str],
    status: Sequence[int],
    columns: Sequence[Sequence[float | None]],
    lane: Sequence[int],
) -> list[dict[str, object]]:
    return [
        {
            "track_id": ids[i],
            "status": STATUS_TEXT[status[i]],
            **{name: column[i] for name, column in zip(_STATE_FIELDS, columns, strict=True)},
            "lane": lane[i] or None,
        }
        for i in range(len(ids))
    ]


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
    status, lanes = estimates.status.tolist(), estimates.lane.tolist()
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
