"""Compute traffic measures again from exported crossings, in plain Python, and compare.

    python benchmarks/recompute_flow.py DIR        what `wayside track` or `wayside export` wrote

Shares no code with the service: it reads crossings.jsonl and flow.jsonl and follows docs/counts.md. Prints
the largest difference of each figure and fails when one is above the rounding of the export.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from datetime import datetime
from pathlib import Path

ROUNDING = 0.00051  # exports have three decimals
VIRTUAL_LENGTH_M, ASSUMED_LENGTH_M = 2.0, 4.5
BIN_MPS, BINS = 2.5, 24
Row = Mapping[str, object]


def seconds(text: str) -> float:
    return datetime.fromisoformat(text).timestamp()


def belongs(crossing: Row, row: Row) -> bool:
    same = crossing["line_id"] == row["line_id"]
    same &= seconds(row["start"]) <= seconds(crossing["timestamp"]) < seconds(row["end"])
    if row["direction"] is not None:
        same &= crossing["direction"] == row["direction"]
    if row["length_class"] is not None:
        same &= crossing["length_class"] == row["length_class"]
    return bool(same)


def mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def percentile_85(speeds: list[float]) -> float | None:
    if not speeds:
        return None
    ranked, place = sorted(speeds), 0.85 * (len(speeds) - 1)
    low = int(place)
    high = min(low + 1, len(ranked) - 1)
    return ranked[low] + (place - low) * (ranked[high] - ranked[low])


def peak_hour_factor(crossings: list[Row], row: Row) -> float | None:
    if row["interval_s"] != 3600 or not crossings:
        return None
    quarters = [0] * 4
    for crossing in crossings:
        quarters[int((seconds(crossing["timestamp"]) - seconds(row["start"])) // 900)] += 1
    return len(crossings) / (4 * max(quarters))


def measures(crossings: list[Row], row: Row) -> dict[str, object]:
    speeds = [c["speed_mps"] for c in crossings]
    n, span_s = len(speeds), row["interval_s"]
    flow = 3600 * n / span_s
    space = n / sum(1 / v for v in speeds) if n else None
    lengths = [ASSUMED_LENGTH_M if c["length_m"] is None else c["length_m"] for c in crossings]
    histogram = [0] * BINS
    for v in speeds:
        histogram[min(int(v / BIN_MPS), BINS - 1)] += 1
    return {
        "n": n,
        "volume": n,
        "flow_vph": flow,
        "time_mean_speed_mps": mean(speeds),
        "space_mean_speed_mps": space,
        "p85_speed_mps": percentile_85(speeds),
        "occupancy_percent": 100
        / span_s
        * sum((length + VIRTUAL_LENGTH_M) / v for length, v in zip(lengths, speeds, strict=True)),
        "density_per_km": flow / (space * 3.6) if space else 0.0,
        "mean_length_m": mean(c["length_m"] for c in crossings),
        "mean_headway_s": mean(c["headway_s"] for c in crossings),
        "mean_gap_s": mean(c["gap_s"] for c in crossings),
        "peak_hour_factor": peak_hour_factor(crossings, row),
        "speed_histogram": histogram,
    }


def differences(crossings: list[Row], rows: list[Row], *, lanes: bool = True) -> dict[str, float]:
    """The largest difference of each figure; infinite where one is known and the other is not."""
    worst: dict[str, float] = {}
    for row in rows:
        mine = [c for c in crossings if belongs(c, row) and (not lanes or c["lane_id"] == row["lane_id"])]
        for name, value in measures(mine, row).items():
            told = row[name]
            if isinstance(value, list) or value is None or told is None:
                apart = 0.0 if value == told else float("inf")
            else:
                apart = abs(value - told)
            worst[name] = max(worst.get(name, 0.0), apart)
    return worst


def read(path: Path) -> list[Row]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def main(folder: Path) -> int:
    rows = read(folder / "flow.jsonl")
    worst = differences(read(folder / "crossings.jsonl"), rows)
    print(f"{len(rows)} rows")
    for name, apart in worst.items():
        print(f"{name:24s} {apart:.6f}{'' if apart <= ROUNDING else '  DIFFERS'}")
    return 0 if all(apart <= ROUNDING for apart in worst.values()) else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
