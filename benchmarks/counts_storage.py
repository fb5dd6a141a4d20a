"""How large a busy sensor's counts become, and how fast a day of one-minute lane rows is read.

    python benchmarks/counts_storage.py [--days N] [--database URL] [--json]

A day has 40,000 vehicles on six lanes over three lines, most of them between 6 and 20 o'clock, with their
track summaries, the frames received and Edie's sums of seven cells a lane; no track states.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import orjson
from sqlalchemy import Engine, text

from service.api.flow_json import rows_json
from service.formats.sensor import CountLine, SensorConfig
from service.storage.counts import save_counts
from service.storage.database import connection, open_database, session_scope
from service.storage.flow import FlowQuery, read_flow
from service.storage.migrate import upgrade
from service.storage.rows import CellRow, CrossingBlock, MinuteRow, TrackKey, TrackSummary
from service.storage.sites import create_sensor
from service.storage.tracks import save_summaries
from service.traffic.cells import CELL
from service.traffic.flow_fields import flow_columns
from service.traffic.records import CROSSING, MINUTE_US

VEHICLES, LANES, CELLS = 40_000, 6, 7
LINES = ("C40", "C80", "C120")
START_MINUTE = 29_117_160
READS = 25
MONTH_DAYS = 30


def save_day(engine: Engine, day: int, rng: np.random.Generator) -> None:
    hours = np.full(24, 0.3) + np.where((np.arange(24) >= 6) & (np.arange(24) < 20), 1.0, 0.0)
    count = rng.multinomial(VEHICLES, np.repeat(hours, 60) / (60 * hours.sum()))
    number = day * VEHICLES
    for hour in range(24):
        blocks, minutes, cells, tracks = [], [], [], []
        for k in range(hour * 60, hour * 60 + 60):
            minute, n = START_MINUTE + day * 1440 + k, int(count[k])
            for line in LINES:
                records = np.zeros(n, CROSSING)
                records["time_us"] = np.sort(rng.integers(0, MINUTE_US, n))
                records["number"] = records["track"] = records["vehicle"] = number + np.arange(n)
                records["lane"] = rng.integers(1, LANES + 1, n)
                records["direction"] = np.where(records["lane"] <= LANES // 2, 1, -1)
                for name, mean in (
                    ("speed_mps", 20.0),
                    ("length_m", 5.0),
                    ("headway_s", 5.0),
                    ("gap_s", 4.5),
                ):
                    records[name] = np.round(rng.normal(mean, mean / 8, n), 3)
                records["probability"] = 0.998
                blocks.append(CrossingBlock("radar-1", 1, line, minute, 0, 1, records.tobytes()))
            table = np.zeros(LANES * CELLS, CELL)
            table["lane"], table["cell"] = np.divmod(np.arange(LANES * CELLS), CELLS)
            table["distance_m"] = rng.uniform(0, 100, len(table))
            cells.append(CellRow("radar-1", 1, minute, 1, 1, table.tobytes()))
            minutes.append(MinuteRow("radar-1", 1, minute, 1, 1200, 1200, MINUTE_US))
            tracks += [_track(number + i, minute, rng) for i in range(n)]
            number += n
        with session_scope(engine) as writer:
            save_counts(writer, blocks, minutes, cells, now_us=START_MINUTE * MINUTE_US)
            save_summaries(writer, tracks, now_us=START_MINUTE * MINUTE_US)


def _track(number: int, minute: int, rng: np.random.Generator) -> TrackSummary:
    place = rng.normal(0, 30, 9).tolist()
    return TrackSummary(
        TrackKey("radar-1", 1, number), number, True, minute * MINUTE_US, minute * MINUTE_US + 7_000_000,
        number, number + 140, 140, 138, 4.5, 1.8, "short", 0.998, *place[:7],
    )  # fmt: skip


def size_bytes(engine: Engine) -> int:
    with connection(engine) as reader:
        if engine.dialect.name == "postgresql":
            return int(
                reader.scalar(
                    text(
                        "SELECT sum(pg_total_relation_size(c.oid)) FROM pg_class c "
                        "WHERE c.relkind = 'r' AND c.relnamespace = current_schema()::regnamespace"
                    )
                )
            )
        pages, page = reader.scalar(text("PRAGMA page_count")), reader.scalar(text("PRAGMA page_size"))
        return int(pages) * int(page)


def read_day(engine: Engine, day: int) -> tuple[float, float, int]:
    """Return seconds, CPU seconds of this process, and how many rows."""
    start_us = (START_MINUTE + day * 1440) * MINUTE_US
    query = FlowQuery("radar-1", start_us, start_us + 1440 * MINUTE_US, "1min", "UTC", line_id="C40")
    started, begun = time.perf_counter(), time.process_time()
    with connection(engine) as reader:
        flow = read_flow(reader, query)
    body = orjson.dumps({"items": rows_json(flow_columns("radar-1", flow, histogram=False))})
    taken = time.perf_counter() - started, time.process_time() - begun
    return *taken, len(orjson.loads(body)["items"])


def measure(url: str, days: int) -> dict[str, object]:
    engine = open_database(url)
    upgrade(engine)
    rng = np.random.default_rng(4)
    lines = tuple(CountLine(line_id=name, p0=(-9.0, 40.0), p1=(9.0, 40.0)) for name in LINES)
    with session_scope(engine) as writer:
        create_sensor(writer, SensorConfig(sensor_id="radar-1", count_lines=lines), now_us=1)
    empty = size_bytes(engine)
    for day in range(days):
        save_day(engine, day, rng)
    grown = size_bytes(engine) - empty
    taken = [read_day(engine, k % days) for k in range(READS)]
    engine.dispose()
    seconds, busy = np.array([row[:2] for row in taken]).T
    return {
        "days": days,
        "vehicles_a_day": VEHICLES,
        "rows_of_a_day": taken[0][2],
        "read_ms_median": round(1e3 * float(np.median(seconds)), 1),
        "read_ms_p95": round(1e3 * float(np.percentile(seconds, 95)), 1),
        "read_cpu_ms_median": round(1e3 * float(np.median(busy)), 1),
        "bytes_a_day": grown // days,
        "month_mb": round(MONTH_DAYS * grown / days / 1e6, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--days", type=int, default=2)
    parser.add_argument("--database", help="an empty one [default: SQLite in a temporary folder]")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        result = measure(given.database or f"sqlite:///{folder}/rows.sqlite", given.days)
    print(json.dumps(result, indent=1) if given.json else result)


if __name__ == "__main__":
    main()
