"""Turn the `detections` of a JSON frame, in any of their forms, into checked columns with the same messages.

Row-wise:  `[{"range_m": 20.6, "azimuth_deg": 17.3}, ...]`.
Columnar:  `{"range_m": [20.6, ...], "azimuth_deg": [17.3, ...]}`.
Polar: `range_m`, `azimuth_deg`. Cartesian: `x_m`, `y_m`, optional `z_m`. A frame has one shape and one kind.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from types import NoneType
from typing import cast

import numpy as np

from service.errors import FieldError
from service.tracking.model import F64

MAX_ERRORS = 20  # more help nobody and cost time


@dataclass(frozen=True, slots=True)
class _Field:
    """One number of a detection: its name on the wire and the values that are not absurd."""

    name: str
    low: float
    high: float
    required: bool = False


RANGE_LIMIT_M = 10_000.0  # beyond any roadside radar
VELOCITY_LIMIT_MPS = 300.0  # above 1,000 km/h
SNR_LIMIT_DB = 200.0

_POLAR = (
    _Field("range_m", 0.0, RANGE_LIMIT_M, required=True),
    _Field("azimuth_deg", -180.0, 180.0, required=True),
)
_CARTESIAN = (
    _Field("x_m", -RANGE_LIMIT_M, RANGE_LIMIT_M, required=True),
    _Field("y_m", -RANGE_LIMIT_M, RANGE_LIMIT_M, required=True),
    _Field("z_m", -RANGE_LIMIT_M, RANGE_LIMIT_M),
)
_COMMON = (
    _Field("radial_velocity_mps", -VELOCITY_LIMIT_MPS, VELOCITY_LIMIT_MPS),
    _Field("snr_db", -SNR_LIMIT_DB, SNR_LIMIT_DB),
)
_POLAR_NAMES = frozenset(field.name for field in _POLAR)
_CARTESIAN_NAMES = frozenset(field.name for field in _CARTESIAN)
_NUMBER: frozenset[type] = frozenset((float, int))
_NUMBER_OR_NULL: frozenset[type] = frozenset((float, int, NoneType))


_WHOLE = (*_POLAR, *_COMMON)
_WHOLE_NAMES = tuple(field.name for field in _WHOLE)
_WHOLE_LOW = np.array([[field.low] for field in _WHOLE])
_WHOLE_HIGH = np.array([[field.high] for field in _WHOLE])
_WHOLE_DIMENSIONS = 2  # columns, points


@dataclass(frozen=True, slots=True)
class Columns:
    """N detections as the sensor gave them: degrees or metres, the sensor's signs; unknown is NaN."""

    polar: bool
    first: F64  # (N,) range_m or x_m
    second: F64  # (N,) azimuth_deg or y_m
    third: F64  # (N,) zero or z_m
    radial_velocity_mps: F64  # (N,)
    snr_db: F64  # (N,)


def read_detections(
    obj: dict[str, object], max_points: int, errors: list[FieldError], *, booleans: bool = True
) -> Columns | None:
    """Return the detections of a frame; on any fault append to `errors` and return None.

    booleans: there may be some among the numbers, so that they are looked for.
    """
    detections = obj.get("detections")
    if isinstance(detections, list):
        return _read_rows(detections, max_points, errors)
    if isinstance(detections, dict):
        if not booleans and (whole := _whole(detections, max_points)) is not None:
            return whole
        return _read_columns(detections, max_points, errors)
    reason = "is missing" if "detections" not in obj else "want an array of objects or an object of arrays"
    errors.append(FieldError("/detections", reason))
    return None


def _read_rows(rows: list[object], max_points: int, errors: list[FieldError]) -> Columns | None:
    if _too_many("/detections", len(rows), max_points, errors):
        return None
    if not set(map(type, rows)) <= {dict}:
        wrong = (i for i, row in enumerate(rows) if type(row) is not dict)
        errors.extend(FieldError(f"/detections/{i}", "want an object") for i in islice(wrong, MAX_ERRORS))
        return None
    checked = cast("list[dict[str, object]]", rows)
    first = checked[0] if checked else {}
    polar = not _POLAR_NAMES.isdisjoint(first) or _CARTESIAN_NAMES.isdisjoint(first)
    other = _CARTESIAN_NAMES if polar else _POLAR_NAMES
    mixed = next((i for i, row in enumerate(checked) if not other.isdisjoint(row)), None)
    if mixed is not None:
        errors.append(FieldError(f"/detections/{mixed}", _one_kind(polar=polar)))
        return None
    return _assemble(
        polar,
        len(rows),
        lambda name: [row.get(name) for row in checked],
        lambda name, i: f"/detections/{i}/{name}",
        errors,
    )


def _read_columns(detections: dict[str, object], max_points: int, errors: list[FieldError]) -> Columns | None:
    polar = _CARTESIAN_NAMES.isdisjoint(detections)
    if not polar and not _POLAR_NAMES.isdisjoint(detections):
        errors.append(FieldError("/detections", _one_kind(polar=True)))
        return None
    fields = (_POLAR if polar else _CARTESIAN) + _COMMON
    lead = detections.get(fields[0].name)
    count = len(lead) if isinstance(lead, list) else 0
    known = len(errors)
    for field in fields:
        column = detections.get(field.name)
        pointer = f"/detections/{field.name}"
        if column is None and not field.required:
            continue
        if not isinstance(column, list):
            reason = "is missing" if field.name not in detections else "want an array of numbers"
            errors.append(FieldError(pointer, reason))
        elif isinstance(lead, list) and len(column) != count:
            reason = f"has {len(column)} values, {fields[0].name} has {count}"
            errors.append(FieldError(pointer, reason))
        elif _too_many(pointer, len(column), max_points, errors):
            break
    if len(errors) > known:
        return None
    return _assemble(
        polar,
        count,
        lambda name: cast("list[object] | None", detections.get(name)),
        lambda name, i: f"/detections/{name}/{i}",
        errors,
    )


def _whole(detections: dict[str, object], max_points: int) -> Columns | None:
    """Return the columns where all four are there and right, as they mostly are; None: look closer.

    For a frame without booleans, which numpy takes for numbers; it tells all else by the type of the array.
    One array for all columns takes a third of the time that one for each does, and looking at the type of
    each value as long again.
    """
    columns = [detections.get(name) for name in _WHOLE_NAMES]
    if not (_CARTESIAN_NAMES.isdisjoint(detections) and all(type(column) is list for column in columns)):
        return None
    lists = cast("list[list[float]]", columns)
    if len({len(column) for column in lists}) != 1 or len(lists[0]) > max_points:
        return None
    try:
        found = np.array(lists)
    except ValueError:  # arrays among the numbers
        return None
    if found.ndim != _WHOLE_DIMENSIONS or found.dtype.kind not in "fi":  # text, null, huge integers
        return None
    values = found.astype(np.float64, copy=False)
    first, second, velocity, snr = values
    right = bool(((values >= _WHOLE_LOW) & (values <= _WHOLE_HIGH)).all())
    return Columns(True, first, second, np.zeros(len(first)), velocity, snr) if right else None


def _assemble(
    polar: bool,  # noqa: FBT001 - read only by the two functions above
    count: int,
    column_of: Callable[[str], Sequence[object] | None],
    pointer_of: Callable[[str, int], str],
    errors: list[FieldError],
) -> Columns | None:
    known = len(errors)
    fields = (_POLAR if polar else _CARTESIAN) + _COMMON
    values = {
        field.name: _numbers(field, count, column_of(field.name), pointer_of, errors) for field in fields
    }
    if len(errors) > known:
        return None
    return Columns(
        polar=polar,
        first=values[fields[0].name],
        second=values[fields[1].name],
        third=np.zeros(count) if polar else np.nan_to_num(values["z_m"], nan=0.0),
        radial_velocity_mps=values["radial_velocity_mps"],
        snr_db=values["snr_db"],
    )


def _numbers(
    field: _Field,
    count: int,
    column: Sequence[object] | None,
    pointer_of: Callable[[str, int], str],
    errors: list[FieldError],
) -> F64:
    """Return one column as float64, or append what is wrong with its values."""
    if column is None:
        return np.full(count, np.nan)
    kinds = set(map(type, column))
    if kinds <= _NUMBER:
        values = _to_array(column)
        if values is not None and bool(((values >= field.low) & (values <= field.high)).all()):
            return values
    elif kinds <= _NUMBER_OR_NULL and not field.required:
        known = [value for value in column if value is not None]
        present = _to_array(known)
        if present is not None and bool(((present >= field.low) & (present <= field.high)).all()):
            values = np.full(count, np.nan)
            values[[value is not None for value in column]] = present
            return values
    wrong = (
        FieldError(pointer_of(field.name, i), reason)
        for i, value in enumerate(column)
        if (reason := _fault(field, value)) is not None
    )
    errors.extend(islice(wrong, max(MAX_ERRORS - len(errors), 1)))
    return np.zeros(count)


def _to_array(column: Sequence[object]) -> F64 | None:
    try:
        return np.array(column, dtype=np.float64)
    except OverflowError:  # an integer beyond float64, which only a caller in Python can hand over
        return None


def _fault(field: _Field, value: object) -> str | None:
    if value is None:
        return "is missing" if field.required else None
    if type(value) not in _NUMBER:
        return "want a number"
    number = cast("float", value)
    if not field.low <= number <= field.high:
        return f"want a number from {field.low:g} to {field.high:g}, got {_short(number)}"
    return None


def _short(number: float) -> str:
    try:
        return f"{number:g}"
    except OverflowError:
        return "one far larger"


def _too_many(pointer: str, count: int, max_points: int, errors: list[FieldError]) -> bool:
    if count <= max_points:
        return False
    errors.append(FieldError(pointer, f"has {count} points, at most {max_points} are taken"))
    return True


def _one_kind(*, polar: bool) -> str:
    kinds = ("polar (range_m, azimuth_deg)", "Cartesian (x_m, y_m, z_m)")
    first, other = kinds if polar else reversed(kinds)
    return f"a frame is {first} or {other}, not both"
