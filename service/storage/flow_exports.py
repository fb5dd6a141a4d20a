"""Turn crossings and measures into CSV, lane CSV as of PeMS, and tables for Parquet.

The unit is part of each column's name. In `units=kmh` and `mph` speeds are converted and their columns
renamed; nothing else changes, and stored values stay in metres per second.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final, Literal

from service.formats.local_days import local_text
from service.traffic.flow import (
    DEFINITIONS,
    LOW_SAMPLE,
    SPEED_BIN_MPS,
    SPEED_BINS,
    VIRTUAL_LENGTH_M,
    FlowTable,
)
from service.traffic.flow_fields import FULL_COVERAGE, lane_id

Units = Literal["mps", "kmh", "mph"]

PER_MPS: Final[Mapping[str, float]] = {"mps": 1.0, "kmh": 3.6, "mph": 2.2369362920544025}
DEFINITION_TEXT: Final[Mapping[str, str]] = {
    "definitions": DEFINITIONS,
    "interval": "half-open [start, end), UTC; the time zone only tells where a local day begins",
    "coverage": "frames received of those expected at the sensor's rate, 0 to 1",
    "observed": "share of the interval without stretches of more than 1 s in which no frame came",
    "lane_scope": "lane: of lane_id; all_lanes: of all of them; no_lane: of vehicles in no known lane",
    "n": "vehicles that the row is made of",
    "volume": "N, vehicles whose centre crossed the line in the interval",
    "volume_low, volume_high": "95 % bounds of the true volume, from existence probabilities and lost frames",
    "flow_vph": "q = 3600 N / T, vehicles per hour",
    "time_mean_speed_mps": "sum(v) / N, v the speed of each vehicle at the line",
    "space_mean_speed_mps": "N / sum(1 / v)",
    "p85_speed_mps": f"85th percentile, linear interpolation, one speed each; low_sample: n < {LOW_SAMPLE}",
    "occupancy_percent": "100 / T sum((length + d) / v), d = virtual_length_m",
    "virtual_length_m": f"length of the virtual detector, {VIRTUAL_LENGTH_M} m",
    "density_per_km": "q / space-mean speed, vehicles per kilometre",
    "mean_headway_s": "front bumper to front bumper, mean over vehicles whose leader is known",
    "mean_gap_s": "rear bumper of the leader to front bumper",
    "peak_hour_factor": "hourly volume / (4 x its largest 15-minute volume); null for other intervals",
    "speed_histogram": f"vehicles in {SPEED_BINS} bins of {SPEED_BIN_MPS} m/s from 0, the last one open",
    "quality": f"partial: coverage below {FULL_COVERAGE}; low_sample; length_assumed: a length was not known",
    "null": "not observed; 0 is observed none; an interval without any input is absent",
}


def csv_rows(
    rows: Iterable[Mapping[str, object]], columns: Sequence[str], units: Units = "mps"
) -> Iterator[str]:
    """Yield a header and the rows as CSV (RFC 4180); null is empty, a list is joined by spaces."""
    yield _line(column_names(columns, units))
    for row in rows:
        yield _line([_text(value) for value in converted(row, columns, units)])


def column_names(columns: Sequence[str], units: Units) -> list[str]:
    """Return the names of the columns with their units as exported."""
    return [name.removesuffix("_mps") + f"_{units}" if name.endswith("_mps") else name for name in columns]


def converted(row: Mapping[str, object], columns: Sequence[str], units: Units) -> list[object]:
    """Return the values of a row, speeds in the wanted units."""
    factor = PER_MPS[units]
    values = [row.get(name) for name in columns]
    if factor == 1.0:
        return values
    return [
        round(value * factor, 3) if name.endswith("_mps") and isinstance(value, float) else value
        for name, value in zip(columns, values, strict=True)
    ]


def pems_rows(flow: FlowTable, time_zone: str) -> Iterator[str]:
    """Yield the measures as lane CSV as in PeMS's station files, a row for each line, direction and interval.

    flow: by lane and direction, no classes. Local time, vehicles, occupancy 0 to 1, miles per hour.
    """
    lanes = sorted({group.lane for group in flow.groups if group.lane})
    head = ["Timestamp", "Station", "Direction of Travel", "Samples", "% Observed"]
    head += ["Total Flow", "Avg Occupancy", "Avg Speed"]
    for lane in lanes:
        head += [f"Lane {lane_id(lane)} {name}" for name in ("Flow", "Avg Occ", "Avg Speed")]
    yield _line(head)
    stations: dict[tuple[int, str, int], dict[int | None, int]] = {}
    for i, g in enumerate(flow.group.tolist()):
        group = flow.groups[g]
        key = (int(flow.start_us[i]), group.line_id, group.direction or 0)
        stations.setdefault(key, {})[group.lane] = i
    for (start_us, line_id, direction), rows in sorted(stations.items()):
        yield _line(
            [local_text(start_us, time_zone, "%m/%d/%Y %H:%M:%S"), line_id, str(direction)]
            + _station(flow, list(rows.values()))
            + [text for lane in lanes for text in _lane(flow, rows.get(lane))]
        )


def _station(flow: FlowTable, rows: Sequence[int]) -> list[str]:
    n = [int(flow.n[i]) for i in rows]
    total = sum(n)
    occupancy = sum(float(flow.occupancy_percent[i]) for i in rows) / max(len(rows), 1) / 100
    speed = sum(float(flow.time_mean_speed_mps[i]) * k for i, k in zip(rows, n, strict=True) if k)
    mean = f"{speed / total * PER_MPS['mph']:.1f}" if total else ""
    return [str(total), f"{100 * float(flow.coverage[rows[0]]):.0f}", str(total), f"{occupancy:.4f}", mean]


def _lane(flow: FlowTable, i: int | None) -> list[str]:
    if i is None:
        return ["", "", ""]
    speed = f"{float(flow.time_mean_speed_mps[i]) * PER_MPS['mph']:.1f}" if flow.n[i] else ""
    return [str(int(flow.n[i])), f"{float(flow.occupancy_percent[i]) / 100:.4f}", speed]


def _line(values: Sequence[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\r\n").writerow(values)
    return text.getvalue()


def _text(value: object) -> str:
    if value is None:
        return ""
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)
