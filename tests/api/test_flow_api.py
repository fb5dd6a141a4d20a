from __future__ import annotations

import csv
import io
import json
import sys
from pathlib import Path

import pytest
from pyarrow import parquet

from service.api import flow_schemas
from service.api.schemas import Page
from service.formats.rfc3339 import format_time, parse_time_us
from tests.api.serving import problem, recording, until

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
import recompute_flow

LINES = [
    {"line_id": "near", "p0": [0.0, 45.0], "p1": [30.0, 45.0]},
    {"line_id": "far", "p0": [0.0, 60.0], "p1": [30.0, 60.0]},
]
MINUTE_US = 60_000_000


@pytest.fixture(scope="module")
def counted(service):
    """Four vehicles have driven away over two lines; the window that holds them, in whole minutes."""
    sensor = {"sensor_id": "counted", "count_lines": LINES}
    assert service.post("/sensors", json=sensor).status_code == 201
    sent = recording("counted", 100, vehicles=4)
    assert service.post("/sensors/counted/frames:batch", json=sent).json()["accepted"] == 100
    until(lambda: len(crossings(service)) == 6)
    until(lambda: service.get("/tracks?sensor_id=counted").json()["items"][-1]["ended"])
    start_us = parse_time_us(sent[0]["timestamp"]) // MINUTE_US * MINUTE_US
    end_us = parse_time_us(sent[-1]["timestamp"]) // MINUTE_US * MINUTE_US + MINUTE_US
    return {"start": format_time(start_us), "end": format_time(end_us)}


def crossings(service, **given):
    return service.get("/sensors/counted/crossings", params=given).json()["items"]


def read(service, what, **params):
    reply = service.get(f"/sensors/counted/{what}", params=params)
    assert reply.status_code == 200, reply.text
    return reply.json()


def test_every_vehicle_crosses_every_line_once(service, counted):
    found = (
        Page[flow_schemas.CrossingReply]
        .model_validate(service.get("/sensors/counted/crossings", params=counted).json())
        .items
    )

    assert [(row.line_id, row.track_id) for row in found if row.line_id == "near"] == [
        ("near", f"counted-1-{n}") for n in (2, 1)
    ]  # the others began on it and behind it
    assert {row.direction for row in found} == {1}
    assert all(row.speed_mps == pytest.approx(10, abs=1) for row in found)
    assert [row.timestamp for row in found] == sorted(row.timestamp for row in found)
    assert len(crossings(service, line_id="far")) == 4


def test_pages_of_crossings_neither_repeat_nor_leave_out(service, counted):
    seen, path = [], "/api/v1/sensors/counted/crossings?limit=2"
    while path:
        reply = service.client.get(path)
        seen += reply.json()["items"]
        path = reply.links["next"]["url"] if "next" in reply.links else None

    assert seen == crossings(service)
    assert len(seen) == 6


def test_the_measures_are_those_that_the_crossings_give(service, counted):
    reply = flow_schemas.FlowReply.model_validate(read(service, "flow", **counted, interval="1min"))

    rows = [row.model_dump() for row in reply.items]
    assert sum(row["volume"] for row in rows) == 6
    assert all(0 < row["coverage"] <= 1 for row in rows)
    worst = recompute_flow.differences(crossings(service), rows)
    assert {name for name, apart in worst.items() if apart > recompute_flow.ROUNDING} == set()


def test_a_number_opens_into_its_crossings_tracks_and_frames(service, counted):
    rows = read(service, "flow", **counted, by="direction", interval="60min")["items"]
    row = next(row for row in rows if row["line_id"] == "near")

    evidence = flow_schemas.EvidenceReply.model_validate(read(service, f"flow/{row['row']}/evidence"))

    assert evidence.flow.model_dump() == row
    assert len(evidence.crossings) == row["volume"] == 2
    assert {track.track_id for track in evidence.tracks} == {c.track_id for c in evidence.crossings}
    assert evidence.frames.first < evidence.frames.last <= 100
    problem(service.get("/sensors/counted/flow/nonsense/evidence"), 404)


def test_an_interval_without_input_is_absent_and_told_as_not_covered(service, counted):
    before = {"start": "2025-05-12T06:00:00Z", "end": "2025-05-12T06:15:00Z", "interval": "5min"}

    assert read(service, "flow", **before)["items"] == []
    covered = flow_schemas.CoverageReply.model_validate(read(service, "coverage", **before))
    assert [row.coverage for row in covered.items] == [0.0, 0.0, 0.0]
    assert any(row["coverage"] > 0 for row in read(service, "coverage", **counted, interval="1min")["items"])


def test_exports_hold_the_same_rows(service, counted):
    ask = {**counted, "interval": "60min", "units": "kmh"}
    rows = read(service, "flow", **ask)["items"]
    text = service.get("/sensors/counted/flow", params=ask, headers={"Accept": "text/csv"}).text
    lines = service.get("/sensors/counted/flow", params={**ask, "format": "ndjson"}).text.splitlines()
    columnar = service.get("/sensors/counted/flow", params={**ask, "format": "parquet"})
    pems = service.get("/sensors/counted/flow", params={**ask, "format": "pems"}).text

    assert [json.loads(line) for line in lines] == rows
    for table in (list(csv.DictReader(io.StringIO(text, newline=""))), _parquet_rows(columnar)):
        assert [int(row["volume"]) for row in table] == [row["volume"] for row in rows]
        assert float(table[0]["time_mean_speed_kmh"]) == pytest.approx(
            3.6 * rows[0]["time_mean_speed_mps"], abs=1e-3
        )
    assert b"space_mean_speed_mps" in parquet.read_schema(io.BytesIO(columnar.content)).metadata
    assert pems.splitlines()[0].startswith("Timestamp,Station")
    each = service.get("/sensors/counted/crossings", params={"format": "csv"}).text
    assert len(each.splitlines()) == 7


def _parquet_rows(reply):
    assert reply.headers["content-type"] == "application/vnd.apache.parquet"
    return parquet.read_table(io.BytesIO(reply.content)).to_pylist()


def test_movements_lead_from_gate_to_gate(service, counted):
    found = flow_schemas.MovementReply.model_validate(read(service, "movements", **counted, interval="60min"))

    ways = {(row.entry, row.exit): 0 for row in found.items}
    for row in found.items:
        ways[row.entry, row.exit] += row.volume
    assert ways == {("near", "far"): 2, ("far", None): 2}


def test_a_count_by_hand_is_kept_replaced_and_compared(service, counted):
    base = {"line_id": "near", "start": counted["start"], "interval_s": 900}
    path = "/sensors/counted/counts/checks"

    service.post(path, json=[base | {"counted": 99}])
    reply = service.post(path, json=[base | {"counted": 4}, base | {"direction": -1, "counted": 0}])

    first, second = flow_schemas.CheckReply.model_validate(reply.json()).items
    assert (first.counted, first.measured, first.difference) == (4, 2, -2)
    assert first.relative_error == -0.5
    assert (second.measured, second.geh) == (0, 0.0)
    kept = service.get(path, params=counted).json()["items"]
    assert sorted(row["counted"] for row in kept) == [0, 4]
    unknown = base | {"start": "2025-05-12T06:00:00Z", "counted": 7}
    (row,) = service.post(path, json=[unknown]).json()["items"]
    assert (row["coverage"], row["measured"], row["geh"]) == (0.0, None, None)


@pytest.mark.parametrize(
    ("query", "pointer"),
    [
        ("by=colour", "/by"),
        ("tz=Mars/Olympus&interval=day", "/tz"),
        ("format=xml", "/format"),
        ("interval=2min", "/interval"),
    ],
)
def test_wrong_questions_are_told_apart(service, counted, query, pointer):
    window = f"start={counted['start']}&end={counted['end']}"

    body = problem(service.get(f"/sensors/counted/flow?{window}&{query}"), 422)

    assert body["errors"][0]["pointer"] == pointer
    problem(service.get(f"/sensors/nobody/flow?{window}"), 404)
    problem(
        service.post("/sensors/counted/counts/checks", json=[{"line_id": "x", "start": "1", "counted": 1}]),
        422,
    )


def test_edies_measures_need_a_lane_map(service, counted):
    reply = flow_schemas.CellReply.model_validate(read(service, "flow/cells", **counted))

    assert reply.items == []
