"""Turn crossings and flow tables into the fields that are served, written and exported."""

from __future__ import annotations

import base64
import binascii
import json
import math
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
_PARTS = 6  # of a row's name


@dataclass(frozen=True, slots=True)
class RowName:
    """What a flow row's public name stands for."""

    group: Group
    start_us: int
    end_us: int


def lane_id(lane: int | None) -> str | None:
    """Return the public name of a lane's index, None for no lane."""
    return f"L{lane}" if lane else None


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
    names = _interval_names(flow)
    columns = {name: plain(getattr(flow, name)) for name in (*_MEASURES, "coverage", "observed")}
    whole = {name: getattr(flow, name).tolist() for name in ("n", "volume_low", "volume_high")}
    bins = flow.histogram.tolist() if histogram else [None] * len(flow.n)
    quality = _quality(flow)
    rows: list[Fields] = []
    for i, g in enumerate(flow.group.tolist()):
        group, (start, end, interval_s, start_s) = flow.groups[g], names[i]
        fields: Fields = {
            "row": row_name(group, start_s, interval_s),
            "sensor_id": sensor_id,
            "line_id": group.line_id,
            "lane_id": lane_id(group.lane),
            "direction": group.direction,
            "length_class": group.length_class,
            "start": start,
            "end": end,
            "interval_s": interval_s,
            "coverage": columns["coverage"][i],
            "observed": columns["observed"][i],
            "n": whole["n"][i],
            "volume": whole["n"][i],
            "volume_low": whole["volume_low"][i],
            "volume_high": whole["volume_high"][i],
        }
        fields.update((name, columns[name][i]) for name in _MEASURES)
        fields["virtual_length_m"] = VIRTUAL_LENGTH_M
        if histogram:
            fields["speed_histogram"] = bins[i]
        fields["quality"] = quality[i]
        fields["definitions"] = DEFINITIONS
        rows.append(fields)
    return rows


def edie_fields(sensor_id: str, edie: EdieTable) -> list[Fields]:
    """Return the fields of each cell and interval."""
    names = _interval_names(edie)
    real = {name: plain(getattr(edie, name)) for name in _EDIE}
    whole = {name: getattr(edie, name).tolist() for name in ("lane", "cell", "map_version")}
    return [
        {
            "sensor_id": sensor_id,
            "lane_id": lane_id(whole["lane"][i]),
            "lane_map_version": whole["map_version"][i],
            "cell": whole["cell"][i],
            "start": names[i][0],
            "end": names[i][1],
            "interval_s": names[i][2],
            **{name: real[name][i] for name in _EDIE},
            "definitions": DEFINITIONS,
        }
        for i in range(len(whole["lane"]))
    ]


def _interval_names(flow: FlowTable | EdieTable) -> list[tuple[str, str, int, int]]:
    """Return start and end as text, the length and the start in seconds of each row's interval."""
    known: dict[tuple[int, int], tuple[str, str, int, int]] = {}
    for start, end in set(zip(flow.start_us.tolist(), flow.end_us.tolist(), strict=True)):
        seconds = (end - start) // _US_PER_S
        known[start, end] = (format_time(start), format_time(end), seconds, start // _US_PER_S)
    return [known[pair] for pair in zip(flow.start_us.tolist(), flow.end_us.tolist(), strict=True)]


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
    parts = [group.line_id, group.lane, group.direction, group.length_class, start_s, interval_s]
    text = json.dumps(parts, separators=(",", ":"))
    return base64.urlsafe_b64encode(text.encode()).decode().rstrip("=")


def parse_row_name(text: str) -> RowName:
    """Return what a row's name stands for; raises NotFound when no row can have it."""
    try:
        padded = text.encode("ascii") + b"=" * (-len(text) % 4)
        parts = json.loads(base64.b64decode(padded, altchars=b"-_", validate=True))
        line_id, lane, direction, length_class, start_s, interval_s = parts
    except (UnicodeError, binascii.Error, ValueError, TypeError) as error:
        raise NotFound(f"no flow row {text!r}") from error
    kinds = zip(
        (line_id, lane, direction, length_class, start_s, interval_s),
        (str, int | None, int | None, str | None, int, int),
        strict=True,
    )
    known = length_class is None or length_class in LENGTH_CLASSES
    if not known or not all(isinstance(part, kind) for part, kind in kinds) or interval_s <= 0:
        raise NotFound(f"no flow row {text!r}")
    if "\0" in line_id or abs(start_s) + interval_s > _US_PER_S * 100_000:
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
    values = (np.round(column.astype(np.float64), _DECIMALS) + 0.0).tolist()
    return [None if math.isnan(value) else value for value in values]
