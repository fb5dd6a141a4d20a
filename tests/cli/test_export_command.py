from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet
from typer.testing import CliRunner

from service.cli.main import app
from service.formats.sensor import CountLine, SensorConfig
from service.storage.counts import save_counts
from service.storage.database import open_database, session_scope
from service.storage.migrate import upgrade
from service.storage.rows import CrossingBlock, MinuteRow
from service.storage.sites import create_sensor
from service.traffic.records import MINUTE_US, Crossing, record_of

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
import recompute_flow

START_US = 1_747_029_600_000_000  # 2025-05-12T06:00:00Z
WINDOW = ("--start", "2025-05-12T06:00:00Z", "--end", "2025-05-12T06:10:00Z", "--interval", "5min")


@pytest.fixture(scope="module")
def data_dir(tmp_path_factory):
    """A database with forty crossings in ten minutes."""
    folder = tmp_path_factory.mktemp("data")
    engine = open_database(f"sqlite:///{folder / 'rows.sqlite'}")
    upgrade(engine)
    rng = np.random.default_rng(3)
    blocks, minutes = [], []
    for k in range(10):
        minute = START_US // MINUTE_US + k
        crossed = [
            Crossing(
                line_id="C40", time_us=minute * MINUTE_US + 10_000_000 * i + 1000, track=4 * k + i,
                vehicle=4 * k + i, frame=1, lane=1 + i % 2, direction=-1, x_m=0.0, y_m=40.0,
                speed_mps=rng.uniform(10, 20), length_m=4.5, probability=0.99, map_version=1, headway_s=5.0,
                gap_s=4.7, number=4 * k + i + 1,
            )
            for i in range(4)
        ]  # fmt: skip
        records = b"".join(record_of(crossing).tobytes() for crossing in crossed)
        blocks.append(CrossingBlock("radar-1", 1, "C40", minute, 0, 1, records))
        minutes.append(MinuteRow("radar-1", 1, minute, 1, 1200, 1200, MINUTE_US))
    line = CountLine(line_id="C40", p0=(-6.0, 40.0), p1=(6.0, 40.0))
    with session_scope(engine) as connection:
        create_sensor(connection, SensorConfig(sensor_id="radar-1", count_lines=(line,)), now_us=START_US)
        save_counts(connection, blocks, minutes, [], now_us=START_US)
    engine.dispose()
    return folder


def run(*arguments):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result.output


def test_the_exported_figures_are_those_of_the_exported_crossings(data_dir, tmp_path):
    run("export", "radar-1", *WINDOW, "--out", tmp_path / "out", "--data-dir", data_dir, "--format", "jsonl")

    rows = recompute_flow.read(tmp_path / "out" / "flow.jsonl")
    crossings = recompute_flow.read(tmp_path / "out" / "crossings.jsonl")
    assert (len(rows), len(crossings)) == (4, 40)
    worst = recompute_flow.differences(crossings, rows)
    assert max(worst.values()) <= recompute_flow.ROUNDING
    assert recompute_flow.main(tmp_path / "out") == 0


def test_csv_has_units_in_its_headers_and_definitions_beside_it(data_dir, tmp_path):
    told = json.loads(
        run(
            "export", "radar-1", *WINDOW, "--out", tmp_path / "out", "--data-dir", data_dir,
            "--units", "mph", "--json",
        )
    )  # fmt: skip

    assert told["flow_rows"] == 4
    with (tmp_path / "out" / "flow.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {"time_mean_speed_mph", "mean_headway_s", "occupancy_percent"} <= rows[0].keys()
    assert 10 * 2.23 < float(rows[0]["p85_speed_mph"]) < 20 * 2.24
    definitions = json.loads((tmp_path / "out" / "definitions.json").read_text())["columns"]
    assert "sum(1 / v)" in definitions["space_mean_speed_mps"]
    pems = (tmp_path / "out" / "pems_lanes.csv").read_text().splitlines()
    assert len(pems) == 3
    assert pems[1].startswith("05/12/2025 06:00:00,C40,-1,20,100,20")


def test_parquet_holds_the_same_rows(data_dir, tmp_path):
    run(
        "export", "radar-1", *WINDOW, "--out", tmp_path / "out", "--data-dir", data_dir, "--format", "parquet"
    )

    table = parquet.read_table(tmp_path / "out" / "crossings.parquet")
    assert table.num_rows == 40
    assert table.schema.field("speed_mps").type == "double"


def test_a_count_by_hand_is_held_against_the_measured_volume(data_dir, tmp_path):
    counts = tmp_path / "counts.csv"
    counts.write_text(
        "line_id,start,interval_s,lane_id,counted\r\n"
        "C40,2025-05-12T06:00:00Z,300,,21\r\n"
        "C40,2025-05-12T06:05:00Z,300,L1,10\r\n"
        "C40,2025-05-12T09:00:00Z,300,,3\r\n"
    )

    told = json.loads(run("count-check", "radar-1", counts, "--data-dir", data_dir, "--json"))["checks"]
    text = run("count-check", "radar-1", counts, "--data-dir", data_dir)

    assert [(row["counted"], row["measured"], row["difference"]) for row in told] == [
        (21, 20, -1), (10, 10, 0), (3, None, None),
    ]  # fmt: skip
    assert told[0]["geh"] == pytest.approx(np.sqrt(2 * 12**2 / (240 + 252)), abs=1e-3)
    assert "2 of 2 with GEH below 5; 1 without measurement" in text


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("C40,yesterday,5", "/0/start"),
        ("C40,2025-05-12T06:00:00Z,-1", "counted"),
        ("C40,2025-05-12T06:00:30Z,1", "minute"),
    ],
)
def test_a_wrong_count_is_named(data_dir, tmp_path, line, reason):
    counts = tmp_path / "counts.csv"
    counts.write_text(f"line_id,start,counted\n{line}\n")

    result = CliRunner().invoke(app, ["count-check", "radar-1", str(counts), "--data-dir", str(data_dir)])

    assert result.exit_code != 0
    assert reason in result.output + (result.stderr if result.stderr_bytes else "")
