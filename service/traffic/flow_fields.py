"""Turn crossings and flow tables into the fields that are served, written and exported."""

from __future__ import annotations

import base64
import binascii
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.errors import NotFound
from service.formats.length_class import LENGTH_CLASSES
from service.formats.rfc3339 import format_time
from service.formats.tracks import track_id
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
_DECIMALS = 3
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
    """Return the fields of each row of a flow table.

    Column by column, for a day of minutes has thousands of rows.
    """
    count, order = len(flow.n), flow.group.tolist()
    starts, ends, spans, starts_s = _interval_columns(flow)
    codes = [_group_code(group) for group in flow.groups]
    lanes = [lane_id(group.lane) for group in flow.groups]
    scopes = [lane_scope(group.lane) for group in flow.groups]
    volumes = flow.n.tolist()
    columns: dict[str, Sequence[object]] = {
        "row": [f"{codes[g]}-{at}-{span}" for g, at, span in zip(order, starts_s, spans, strict=True)],
        "sensor_id": [sensor_id] * count,
        "line_id": [flow.groups[g].line_id for g in order],
        "lane_id": [lanes[g] for g in order],
        "lane_scope": [scopes[g] for g in order],
        "direction": [flow.groups[g].direction for g in order],
        "length_class": [flow.groups[g].length_class for g in order],
        "start": starts,
        "end": ends,
        "interval_s": spans,
        "coverage": plain(flow.coverage),
        "observed": plain(flow.observed),
        "n": volumes,
        "volume": volumes,
        "volume_low": flow.volume_low.tolist(),
        "volume_high": flow.volume_high.tolist(),
        **{name: plain(getattr(flow, name)) for name in _MEASURES},
        "virtual_length_m": [VIRTUAL_LENGTH_M] * count,
    }
    if histogram:
        columns["speed_histogram"] = flow.histogram.tolist()
    columns |= {"quality": _quality(flow), "definitions": [DEFINITIONS] * count}
    names = tuple(columns)
    return [dict(zip(names, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def edie_fields(sensor_id: str, edie: EdieTable) -> list[Fields]:
    """Return the fields of each cell and interval."""
    starts, ends, spans, _ = _interval_columns(edie)
    real = {name: plain(getattr(edie, name)) for name in _EDIE}
    whole = {name: getattr(edie, name).tolist() for name in ("lane", "cell", "map_version")}
    return [
        {
            "sensor_id": sensor_id,
            "lane_id": lane_id(whole["lane"][i]),
            "lane_map_version": whole["map_version"][i],
            "cell": whole["cell"][i],
            "start": starts[i],
            "end": ends[i],
            "interval_s": spans[i],
            **{name: real[name][i] for name in _EDIE},
            "definitions": DEFINITIONS,
        }
        for i in range(len(whole["lane"]))
    ]


def _interval_columns(
    table: FlowTable | EdieTable,
) -> tuple[Sequence[str], Sequence[str], Sequence[int], Sequence[int]]:
    """Return start and end as text, the length and the start in seconds of each row's interval."""
    pairs = np.stack([table.start_us, table.end_us], axis=1)
    known, index = np.unique(pairs, axis=0, return_inverse=True)
    place = index.reshape(-1).tolist()
    start = [format_time(value) for value in known[:, 0].tolist()]
    end = [format_time(value) for value in known[:, 1].tolist()]
    span = ((known[:, 1] - known[:, 0]) // _US_PER_S).tolist()
    start_s = (known[:, 0] // _US_PER_S).tolist()
    return (
        [start[k] for k in place],
        [end[k] for k in place],
        [span[k] for k in place],
        [start_s[k] for k in place],
    )


def _quality(flow: FlowTable) -> list[list[str]]:
    """Return the flags of each row."""
    flags = (
        ("partial", flow.coverage < FULL_COVERAGE),
        ("low_sample", flow.n < LOW_SAMPLE),
        ("length_assumed", flow.lengths_known < flow.n),
    )
    marks = [(name, mask.tolist()) for name, mask in flags]
    return [[name for name, mask in marks if mask[i]] for i in range(len(flow.n))]


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
    seen = {
        (line, lane if "lane" in by else None, direction if "direction" in by else None)
        for line, lane, direction in zip(
            crossings.line_id.tolist(), crossings.lane.tolist(), crossings.direction.tolist(), strict=True
        )
    }
    if not by & {"lane", "direction"}:
        seen |= {(line, None, None) for line in line_ids}
    elif "direction" not in by:
        seen |= {(line, lane, None) for line in line_ids for lane in lanes}
    kinds = LENGTH_CLASSES if "length_class" in by else (None,)
    ordered = sorted(seen, key=lambda key: (key[0], key[1] or 0, key[2] or 0))
    return tuple(Group(*key, kind) for key in ordered for kind in kinds)


def plain(column: NDArray[np.floating]) -> list[float | None]:
    """Return the values as Python numbers rounded to three decimals, NaN as None."""
    values = np.round(column.astype(np.float64), _DECIMALS) + 0.0
    missing = np.isnan(values)
    if not missing.any():
        return list(values.tolist())
    known = values.astype(object)
    known[missing] = None
    return list(known.tolist())
