"""Turn stored tracks and their states into plain records, CSV lines and GeoJSON features (RFC 7946).

GeoJSON places are WGS84, longitude first; the geometry is null where the sensor's place is not known.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.formats.georeference import Pose, to_wgs84
from service.formats.rfc3339 import format_time
from service.formats.tracks import MOTION_TEXT, STATUS_TEXT, rounded, status_and_motion, track_id
from service.tracking.model import F64, I64

STATE_COLUMNS = (
    "track_id",
    "frame",
    "timestamp",
    "status",
    "x_m",
    "y_m",
    "vx_mps",
    "vy_mps",
    "speed_mps",
    "std_x_m",
    "std_y_m",
    "lane",
    "motion",
    "longitude_deg",
    "latitude_deg",
)
TRACK_COLUMNS = (
    "track_id",
    "sensor_id",
    "ended",
    "start",
    "end",
    "duration_s",
    "states",
    "hits",
    "length_m",
    "width_m",
    "length_class",
    "existence",
    "first_x_m",
    "first_y_m",
    "last_x_m",
    "last_y_m",
    "distance_m",
    "mean_speed_mps",
    "max_speed_mps",
)


@dataclass(frozen=True, slots=True)
class StateTable:
    """N stored states of one sensor and epoch."""

    sensor_id: str
    epoch: int
    number: I64  # (N,)
    frame: I64  # (N,)
    time_us: I64  # (N,)
    samples: NDArray[np.void]  # (N,) of storage.rows.STATE_SAMPLE


def state_records(table: StateTable, pose: Pose | None) -> list[dict[str, object]]:
    """Return the states as records with the fields STATE_COLUMNS, in the order given."""
    s = table.samples
    columns = {name: rounded(s[name]) for name in ("x_m", "y_m", "vx_mps", "vy_mps", "std_x_m", "std_y_m")}
    speeds = rounded(np.hypot(s["vx_mps"], s["vy_mps"]))
    places = _places(pose, s["x_m"].astype(np.float64), s["y_m"].astype(np.float64))
    lanes, numbers = s["lane"].tolist(), table.number.tolist()
    status, motion = (column.tolist() for column in status_and_motion(s["status"]))
    frames, times_us = table.frame.tolist(), table.time_us.tolist()
    return [
        {
            "track_id": track_id(table.sensor_id, table.epoch, numbers[i]),
            "frame": frames[i],
            "timestamp": format_time(times_us[i]),
            "status": STATUS_TEXT[status[i]],
            "x_m": columns["x_m"][i],
            "y_m": columns["y_m"][i],
            "vx_mps": columns["vx_mps"][i],
            "vy_mps": columns["vy_mps"][i],
            "speed_mps": speeds[i],
            "std_x_m": columns["std_x_m"][i],
            "std_y_m": columns["std_y_m"][i],
            "lane": lanes[i] or None,
            "motion": MOTION_TEXT[motion[i]],
            "longitude_deg": places[i][0],
            "latitude_deg": places[i][1],
        }
        for i in range(len(s))
    ]


def csv_header(columns: Sequence[str]) -> str:
    """Return the header line; the unit is part of each name."""
    return ",".join(columns) + "\r\n"


def csv_lines(columns: Sequence[str], records: Iterable[Mapping[str, object]]) -> str:
    """Return records as CSV lines (RFC 4180); null is an empty field."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerows(["" if record[name] is None else record[name] for name in columns] for record in records)
    return text.getvalue()


def path_feature(
    properties: Mapping[str, object], pose: Pose | None, x_m: F64, y_m: F64
) -> dict[str, object]:
    """Return the path through N positions: a line, a point for N = 1, null where the place is not known."""
    places = [[longitude, latitude] for longitude, latitude in _places(pose, x_m, y_m)]
    geometry: dict[str, object] | None = None
    if pose is not None and len(places) == 1:
        geometry = {"type": "Point", "coordinates": places[0]}
    elif pose is not None and places:
        geometry = {"type": "LineString", "coordinates": places}
    return {"type": "Feature", "geometry": geometry, "properties": dict(properties)}


def _places(pose: Pose | None, x_m: F64, y_m: F64) -> list[tuple[float | None, float | None]]:
    if pose is None:
        return [(None, None)] * len(x_m)
    longitude, latitude = to_wgs84(pose, x_m, y_m)
    return list(zip(longitude.tolist(), latitude.tolist(), strict=True))
