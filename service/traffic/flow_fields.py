"""Turn crossings and flow tables into the fields that are served, written and exported."""

from __future__ import annotations

import base64
import binascii
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.errors import NotFound
from service.formats.length_class import LENGTH_CLASSES
from service.formats.rfc3339 import format_time, format_times
from service.formats.tracks import track_id
from service.tracking.model import I64
from service.traffic.edie import EdieTable
from service.traffic.flow import (
    DEFINITIONS,
    LOW_SAMPLE,
    VIRTUAL_LENGTH_M,
    CrossingTable,
    FlowTable,
    Group,
)

Fields = dict[str, object]

FULL_COVERAGE = 0.95  # of the frames, below which a row is flagged as partial
DECIMALS = 3  # of every real number that is told
_MEASURES = (
    "flow_vph",
    "time_mean_speed_mps",
    "space_mean_speed_mps",
    "p85_speed_mps",
    "occupancy_percent",
    "density_per_km",
    "mean_length_m",
    "mean_headway_s",
    "mean_gap_s",
    "peak_hour_factor",
)
_EDIE = (
    "coverage",
    "observed",
    "length_m",
    "distance_m",
    "time_s",
    "flow_vph",
    "density_per_km",
    "speed_mps",
)
_US_PER_S = 1_000_000
_ROW = re.compile(r"([A-Za-z0-9_-]+)-(\d{1,11})-(\d{1,11})", re.ASCII)  # group, start and interval in seconds


@dataclass(frozen=True, slots=True)
class Coded:
    """A column of N rows with few values: the values, and for each row the place of its own."""

    values: Sequence[object]
    index: I64  # (N,); the same object in columns that go together


Column = Coded | NDArray[Any] | list[str]


@dataclass(frozen=True, slots=True)
class RowName:
    """What a flow row's public name stands for."""

    group: Group
    start_us: int
    end_us: int


def lane_id(lane: int | None) -> str | None:
    """Return the public name of a lane's index, None for no lane."""
    return f"L{lane}" if lane else None


def lane_scope(lane: int | None) -> str:
    """Return what a group of a lane's index stands for: None is all lanes, 0 the vehicles in none."""
    if lane is None:
        return "all_lanes"
    return "lane" if lane else "no_lane"


def crossing_fields(sensor_id: str, crossings: CrossingTable) -> list[Fields]:
    """Return the fields of each crossing."""
    kinds = crossings.length_class.tolist()
    real = {
        name: plain(getattr(crossings, name))
        for name in ("x_m", "y_m", "speed_mps", "length_m", "headway_s", "gap_s", "probability")
    }
    signed = plain(crossings.speed_mps * crossings.direction)
    whole = {
        name: getattr(crossings, name).tolist()
        for name in ("time_us", "epoch", "number", "line_id", "lane", "map_version", "direction", "track")
    }
    vehicles, frames = crossings.vehicle.tolist(), crossings.frame.tolist()
    return [
        {
            "crossing_id": f"{sensor_id}-{whole['epoch'][i]}-c{whole['number'][i]}",
            "sensor_id": sensor_id,
            "line_id": whole["line_id"][i],
            "timestamp": format_time(whole["time_us"][i]),
            "lane_id": lane_id(whole["lane"][i]),
            "lane_map_version": whole["map_version"][i] or None,
            "direction": whole["direction"][i],
            "track_id": track_id(sensor_id, whole["epoch"][i], whole["track"][i]),
            "vehicle_id": track_id(sensor_id, whole["epoch"][i], vehicles[i]),
            "frame": frames[i],
            "x_m": real["x_m"][i],
            "y_m": real["y_m"][i],
            "speed_mps": real["speed_mps"][i],
            "signed_speed_mps": signed[i],
            "length_m": real["length_m"][i],
            "length_class": LENGTH_CLASSES[kinds[i]] if kinds[i] >= 0 else None,
            "headway_s": real["headway_s"][i],
            "gap_s": real["gap_s"][i],
            "probability": real["probability"][i],
        }
        for i in range(len(crossings))
    ]


def flow_fields(sensor_id: str, flow: FlowTable, *, histogram: bool = True) -> list[Fields]:
    """Return the fields of each row of a flow table."""
    return rows_of(flow_columns(sensor_id, flow, histogram=histogram))


def flow_columns(sensor_id: str, flow: FlowTable, *, histogram: bool = True) -> dict[str, Column]:
    """Return the columns of a flow table, for a day of minutes has thousands of rows."""
    groups, starts, ends, spans = flow.groups, *_intervals(flow)
    codes, from_s = [_group_code(group) for group in groups], flow.start_us // _US_PER_S
    alike = np.zeros(len(flow.n), np.int64)
    columns: dict[str, Column] = {
        "row": [
            f"{codes[g]}-{at}-{spans.values[k]}"
            for g, at, k in zip(flow.group.tolist(), from_s.tolist(), spans.index.tolist(), strict=True)
        ],
        "sensor_id": Coded([sensor_id] * len(groups), flow.group),
        "line_id": Coded([group.line_id for group in groups], flow.group),
        "lane_id": Coded([lane_id(group.lane) for group in groups], flow.group),
        "lane_scope": Coded([lane_scope(group.lane) for group in groups], flow.group),
        "direction": Coded([group.direction for group in groups], flow.group),
        "length_class": Coded([group.length_class for group in groups], flow.group),
        "start": starts,
        "end": ends,
        "interval_s": spans,
        "coverage": flow.coverage,
        "observed": flow.observed,
        "n": flow.n,
        "volume": flow.n,
        "volume_low": flow.volume_low,
        "volume_high": flow.volume_high,
        **{name: getattr(flow, name) for name in _MEASURES},
        "virtual_length_m": Coded([VIRTUAL_LENGTH_M], alike),
    }
    if histogram:
        columns["speed_histogram"] = flow.histogram
    return columns | {"quality": _quality(flow), "definitions": Coded([DEFINITIONS], alike)}


def rows_of(columns: Mapping[str, Column]) -> list[Fields]:
    """Return each row of some columns by the names of these."""
    names = tuple(columns)
    values = [_listed(column) for column in columns.values()]
    return [dict(zip(names, row, strict=True)) for row in zip(*values, strict=True)]


def _listed(column: Column) -> Sequence[object]:
    if isinstance(column, Coded):
        values = column.values
        return [values[k] for k in column.index.tolist()]
    if isinstance(column, list):
        return column
    return plain(column) if column.dtype.kind == "f" else list(column.tolist())


def edie_fields(sensor_id: str, edie: EdieTable) -> list[Fields]:
    """Return the fields of each cell and interval."""
    count = len(edie.lane)
    alike = np.zeros(count, np.int64)
    starts, ends, spans = _intervals(edie)
    lanes, index = np.unique(edie.lane, return_inverse=True)
    return rows_of(
        {
            "sensor_id": Coded([sensor_id], alike),
            "lane_id": Coded([lane_id(lane) for lane in lanes.tolist()], index),
            "lane_map_version": edie.map_version,
            "cell": edie.cell,
            "start": starts,
            "end": ends,
            "interval_s": spans,
            **{name: getattr(edie, name) for name in _EDIE},
            "definitions": Coded([DEFINITIONS], alike),
        }
    )


def _intervals(table: FlowTable | EdieTable) -> tuple[Coded, Coded, Coded]:
    """Return start and end as text and the length in seconds of each row's interval."""
    start_us, end_us = table.start_us, table.end_us
    new = np.ones(len(start_us), np.bool_)
    new[1:] = (np.diff(start_us) != 0) | (np.diff(end_us) != 0)
    index = np.cumsum(new) - 1
    return (
        Coded(format_times(start_us[new]), index),
        Coded(format_times(end_us[new]), index),
        Coded(((end_us - start_us)[new] // _US_PER_S).tolist(), index),
    )


def _quality(flow: FlowTable) -> Coded:
    """Return the flags of each row."""
    flags = (
        ("partial", flow.coverage < FULL_COVERAGE),
        ("low_sample", flow.n < LOW_SAMPLE),
        ("length_assumed", flow.lengths_known < flow.n),
    )
    code = np.zeros(len(flow.n), np.int64)
    for k, (_, mask) in enumerate(flags):
        code |= mask.astype(np.int64) << k
    names = [
        [name for k, (name, _) in enumerate(flags) if value >> k & 1] for value in range(1 << len(flags))
    ]
    return Coded(names, code)


def row_name(group: Group, start_s: int, interval_s: int) -> str:
    """Return the public name of a flow row, from which `/evidence` finds its crossings again."""
    return f"{_group_code(group)}-{start_s}-{interval_s}"


def _group_code(group: Group) -> str:
    parts = [group.line_id, group.lane, group.direction, group.length_class]
    text = json.dumps(parts, separators=(",", ":"))
    return base64.urlsafe_b64encode(text.encode()).decode().rstrip("=")


def parse_row_name(text: str) -> RowName:
    """Return what a row's name stands for; raises NotFound when no row can have it."""
    match = _ROW.fullmatch(text)
    if match is None:
        raise NotFound(f"no flow row {text!r}")
    code, *numbers = match.groups()
    start_s, interval_s = int(numbers[0]), int(numbers[1])
    try:
        padded = code.encode("ascii") + b"=" * (-len(code) % 4)
        line_id, lane, direction, length_class = json.loads(
            base64.b64decode(padded, altchars=b"-_", validate=True)
        )
    except (UnicodeError, binascii.Error, ValueError, TypeError) as error:
        raise NotFound(f"no flow row {text!r}") from error
    fits = isinstance(line_id, str) and "\0" not in line_id and (length_class in {None, *LENGTH_CLASSES})
    fits = fits and all(part is None or isinstance(part, int) for part in (lane, direction))
    if not fits or interval_s <= 0:
        raise NotFound(f"no flow row {text!r}")
    group = Group(line_id, lane, direction, length_class)
    return RowName(group, start_s * _US_PER_S, (start_s + interval_s) * _US_PER_S)


def groups_of(
    crossings: CrossingTable, line_ids: Sequence[str], lanes: Sequence[int], by: frozenset[str]
) -> tuple[Group, ...]:
    """Return the groups that rows are given for: all seen in the crossings, and the known lines and lanes.

    by: any of "lane", "direction", "length_class".
    """
    seen: set[tuple[str, int | None, int | None]] = set()
    way = 4 * crossings.lane + crossings.direction + 1  # both in one number
    for line in set(crossings.line_id.tolist()):
        for lane, sign in (divmod(k, 4) for k in np.unique(way[crossings.line_id == line]).tolist()):
            seen.add((line, lane if "lane" in by else None, sign - 1 if "direction" in by else None))
    if not by & {"lane", "direction"}:
        seen |= {(line, None, None) for line in line_ids}
    elif "direction" not in by:
        seen |= {(line, lane, None) for line in line_ids for lane in lanes}
    kinds = LENGTH_CLASSES if "length_class" in by else (None,)
    ordered = sorted(seen, key=lambda key: (key[0], key[1] or 0, key[2] or 0))
    return tuple(Group(*key, kind) for key in ordered for kind in kinds)


def plain(column: NDArray[np.floating]) -> list[float | None]:
    """Return the values as Python numbers rounded to three decimals, NaN as None."""
    values = np.round(column.astype(np.float64), DECIMALS) + 0.0
    missing = np.isnan(values)
    if not missing.any():
        return list(values.tolist())
    known = values.astype(object)
    known[missing] = None
    return list(known.tolist())
