"""Turn JSON frames of detections (row-wise or columnar, polar or Cartesian) into `Frame` values, and back.

The schema is in docs/architecture.md, "A frame on the wire". The sign conventions of the sensor are applied
here: `azimuth_positive` to polar frames (Cartesian axes are x right, y forward, z up by definition),
`radial_velocity_positive` to both.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import orjson

from service.errors import FieldError, InvalidFrame, InvalidInput
from service.formats.detections import Columns, read_detections
from service.formats.json_lines import numbered_lines
from service.formats.rfc3339 import format_time_exact, parse_time_us
from service.formats.sensor import SensorConfig
from service.formats.strict_json import strict_json
from service.tracking.model import F32, Frame

MAX_POINTS = 4096  # a 4D automotive radar gives about 1,000 a scan
MAX_FRAME_NUMBER = 2**53 - 1  # the largest integer that every JSON reader keeps (RFC 7493, section 2.2)

_SENSOR_ID = re.compile(r"[A-Za-z0-9_-]{1,64}", re.ASCII)
_BOOT_ID = re.compile(r"[A-Za-z0-9._:-]{1,64}", re.ASCII)


@dataclass(frozen=True, slots=True)
class _Head:
    """What a frame says of itself beside its detections."""

    time_us: int
    sequence: int | None
    boot_id: str | None


def parse_bytes(body: bytes, config: SensorConfig, max_points: int = MAX_POINTS) -> Frame:
    """Return the frame in one JSON text; raises InvalidFrame naming each wrong field."""
    booleans = b"true" in body or b"false" in body
    return parse_frame(load_json(body), config, max_points, booleans=booleans)


def load_json(body: bytes) -> object:
    """Return the value of one JSON text; raises InvalidFrame when it is none, or not a clear one."""
    try:
        return strict_json(body)
    except InvalidInput as error:
        raise InvalidFrame(str(error), error.errors) from None


def parse_frame(
    obj: object, config: SensorConfig, max_points: int = MAX_POINTS, *, booleans: bool = True
) -> Frame:
    """Return the frame in a parsed JSON value; raises InvalidFrame with a JSON Pointer for each fault.

    booleans: the value may hold some, so that they are looked for.
    """
    if not isinstance(obj, dict):
        raise InvalidFrame.at("", f"want an object, got {json_kind(obj)}")
    errors: list[FieldError] = []
    head = _read_head(obj, config, errors)
    columns = read_detections(obj, max_points, errors, booleans=booleans)
    if errors or columns is None or head is None:
        first = errors[0]
        raise InvalidFrame(f"{first.pointer}: {first.reason}", errors)
    return _to_frame(head, columns, config)


def json_kind(value: object) -> str:
    """Return what JSON calls the type of a parsed value."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "a boolean"
    if isinstance(value, int | float):
        return "a number"
    if isinstance(value, str):
        return "a string"
    return "an array" if isinstance(value, list) else "an object"


def _read_head(obj: dict[str, object], config: SensorConfig, errors: list[FieldError]) -> _Head | None:
    known = len(errors)
    sensor_id = obj.get("sensor_id", config.sensor_id)
    if sensor_id != config.sensor_id:
        errors.append(FieldError("/sensor_id", _wrong_sensor(sensor_id, config.sensor_id)))
    time_us = _read_time(obj, errors)
    sequence = obj.get("frame")
    if sequence is not None and (type(sequence) is not int or not 0 <= sequence <= MAX_FRAME_NUMBER):
        errors.append(FieldError("/frame", f"want an integer from 0 to {MAX_FRAME_NUMBER}"))
    boot_id = obj.get("boot_id")
    if boot_id is not None and not (isinstance(boot_id, str) and _BOOT_ID.fullmatch(boot_id)):
        errors.append(FieldError("/boot_id", "want 1 to 64 of the characters A-Z a-z 0-9 . _ : -"))
    if len(errors) > known:
        return None
    return _Head(time_us, cast("int | None", sequence), cast("str | None", boot_id))


def _wrong_sensor(sensor_id: object, wanted: str) -> str:
    if not isinstance(sensor_id, str) or not _SENSOR_ID.fullmatch(sensor_id):
        return "want 1 to 64 of the characters A-Z a-z 0-9 _ -"
    return f"the frame is of {sensor_id}, the configuration of {wanted}"


def _read_time(obj: dict[str, object], errors: list[FieldError]) -> int:
    timestamp = obj.get("timestamp")
    if not isinstance(timestamp, str):
        reason = "is missing" if "timestamp" not in obj else f"want a string, got {json_kind(timestamp)}"
        errors.append(FieldError("/timestamp", reason))
        return 0
    try:
        return parse_time_us(timestamp)
    except ValueError as error:
        errors.append(FieldError("/timestamp", str(error)))
        return 0


def _to_frame(head: _Head, columns: Columns, config: SensorConfig) -> Frame:
    """Convert checked columns (degrees or metres, the sensor's signs) to ours; float32 is the last step."""
    if columns.polar:
        range_m = columns.first
        sign = 1.0 if config.azimuth_positive == "right" else -1.0
        azimuth_rad = np.radians(sign * columns.second)
    else:
        range_m = np.sqrt(columns.first**2 + columns.second**2 + columns.third**2)
        azimuth_rad = np.arctan2(columns.first, columns.second)
    velocity_sign = 1.0 if config.radial_velocity_positive == "receding" else -1.0
    return Frame(
        sensor_id=config.sensor_id,
        time_us=head.time_us,
        sequence=head.sequence,
        boot_id=head.boot_id,
        range_m=range_m.astype(np.float32),
        azimuth_rad=azimuth_rad.astype(np.float32),
        radial_velocity_mps=(velocity_sign * columns.radial_velocity_mps).astype(np.float32),
        snr_db=columns.snr_db.astype(np.float32),
    )


def read_frames(paths: Iterable[Path], config: SensorConfig, max_points: int = MAX_POINTS) -> Iterator[Frame]:
    """Yield the frames of JSON lines files, gzip or not, one after the other; blank lines are skipped.

    Raises InvalidInput naming file and line.
    """
    for path in paths:
        for number, line in numbered_lines(path):
            try:
                yield parse_bytes(line, config, max_points)
            except InvalidFrame as error:
                raise InvalidFrame(f"{path}, line {number}: {error}", error.errors) from None


def frame_to_wire(frame: Frame) -> dict[str, object]:
    """Return the frame as a columnar polar JSON object, in our conventions (right, receding) and degrees.

    Parsing it again under those conventions gives the same float32 values to the bit. A column without any
    known value is left out.
    """
    detections: dict[str, object] = {
        "range_m": _shortest(frame.range_m),
        "azimuth_deg": [_degrees(a) for a in frame.azimuth_rad.tolist()],
    }
    optional: Mapping[str, F32] = {
        "radial_velocity_mps": frame.radial_velocity_mps,
        "snr_db": frame.snr_db,
    }
    for name, column in optional.items():
        if not np.isnan(column).all():
            detections[name] = _shortest(column)
    wire: dict[str, object] = {
        "sensor_id": frame.sensor_id,
        "timestamp": format_time_exact(frame.time_us),
    }
    if frame.sequence is not None:
        wire["frame"] = frame.sequence
    if frame.boot_id is not None:
        wire["boot_id"] = frame.boot_id
    return wire | {"detections": detections}


def _degrees(azimuth_rad: float) -> float:
    """Return the angle with the nine significant digits that tell any two float32 apart, at most 180."""
    return min(max(float(f"{math.degrees(azimuth_rad):.9g}"), -180.0), 180.0)


def _shortest(column: F32) -> list[float | None]:
    """Return the values with the fewest digits that tell them apart in float32; NaN becomes None."""
    text = orjson.dumps(np.ascontiguousarray(column), option=orjson.OPT_SERIALIZE_NUMPY)
    return cast("list[float | None]", orjson.loads(text))
