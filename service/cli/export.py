"""`wayside export`: stored crossings and traffic measures into files, with their definitions beside them."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import orjson
import typer

from service.cli import options
from service.cli.database import open_rows, read_settings
from service.cli.edge import one_sentence
from service.cli.output import json_text, print_facts, print_json, provenance
from service.errors import InvalidInput
from service.formats.rfc3339 import parse_time_us

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from sqlalchemy import Engine

    from service.formats.local_days import Interval
    from service.storage.flow import FlowQuery
    from service.storage.flow_exports import Units

TABLES = ("crossings", "flow", "cells", "movements")


class Form(StrEnum):
    """How tables are written."""

    CSV = "csv"
    JSONL = "jsonl"
    PARQUET = "parquet"


class Speed(StrEnum):
    """The unit of speeds in CSV and Parquet."""

    MPS = "mps"
    KMH = "kmh"
    MPH = "mph"


@one_sentence()
def export(
    sensor_id: Annotated[str, typer.Argument(metavar="SENSOR", help="Id of the sensor.")],
    out: options.Out,
    *,
    start: Annotated[str, typer.Option(help="RFC 3339 time.")],
    end: Annotated[str, typer.Option(help="RFC 3339 time, not included.")],
    interval: Annotated[str, typer.Option(help="1min, 5min, 15min, 60min or day.")] = "15min",
    by: Annotated[str, typer.Option(help="Which of lane, direction, length_class.")] = "lane,direction",
    form: Annotated[Form, typer.Option("--format", help="Of the tables.")] = Form.CSV,
    units: Annotated[Speed, typer.Option(help="Of speeds; columns are renamed.")] = Speed.MPS,
    time_zone: Annotated[
        str | None, typer.Option("--tz", help="Bins local days. [default: the site's]")
    ] = None,
    force: options.Force = False,
    data_dir: options.DataDir = None,
    database: options.Database = None,
    as_json: options.Json = False,
) -> None:
    """Write crossings, flow, cells, movements, lane CSV as of PeMS, and a sidecar of definitions."""
    from service.cli.results import written_together
    from service.formats.local_days import INTERVALS
    from service.storage.flow import FlowQuery

    if interval not in INTERVALS:
        raise InvalidInput(f"--interval wants one of {', '.join(INTERVALS)}, got {interval!r}")
    chosen: Interval = interval  # type: ignore[assignment]  # looked at just now
    kinds = frozenset(part.strip() for part in by.split(",") if part.strip())
    query = FlowQuery(
        sensor_id, _time_us("--start", start), _time_us("--end", end), chosen, time_zone, None, kinds
    )
    engine = open_rows(read_settings(data_dir=data_dir, database_url=database))
    names = (*(f"{name}.{form}" for name in TABLES), "pems_lanes.csv", "definitions.json")
    with written_together(out, names, force=force) as folder:
        counts = _write(engine, query, folder, form, units.value)
        about = provenance() | {"sensor_id": sensor_id, "start": start, "end": end, "interval": interval}
        (folder / "definitions.json").write_text(json_text(about | _definitions()) + "\n")
    summary = about | {f"{name}_rows": n for name, n in counts.items()}
    if as_json:
        print_json(summary | {"out": str(out)})
    else:
        print_facts(f"Counts of {sensor_id} -> {out}", summary)


def _definitions() -> dict[str, object]:
    from service.storage.flow_exports import DEFINITION_TEXT

    return {"columns": dict(DEFINITION_TEXT)}


def _write(engine: Engine, query: FlowQuery, folder: Path, form: Form, units: Units) -> dict[str, int]:
    """Write the tables and return the rows of each."""
    from dataclasses import replace

    from service.api.flow_schemas import CellRow, CrossingReply, FlowRow, MovementRow
    from service.api.flow_views import movement_fields
    from service.storage import flow as store
    from service.storage.database import connection
    from service.storage.flow_exports import pems_rows
    from service.traffic.flow_fields import crossing_fields, edie_fields, flow_fields

    sensor_id = query.sensor_id
    crossings = store.CrossingQuery(sensor_id, query.start_us, query.end_us)
    with connection(engine) as reader:
        zone = query.time_zone or store.zone_of(reader, sensor_id)
        flow = store.read_flow(reader, query)
        lanes = store.read_flow(reader, replace(query, by=frozenset({"lane", "direction"})))
        edie, ways = store.read_edie(reader, query), store.read_movements(reader, query)
    with (folder / "pems_lanes.csv").open("w", encoding="utf-8", newline="") as file:
        file.writelines(pems_rows(lanes, zone))
    each = (
        row
        for table in store.stream_crossings(engine, crossings)
        for row in crossing_fields(sensor_id, table)
    )
    tables = {
        "crossings": (each, tuple(CrossingReply.model_fields)),
        "flow": (flow_fields(sensor_id, flow), tuple(FlowRow.model_fields)),
        "cells": (edie_fields(sensor_id, edie), tuple(CellRow.model_fields)),
        "movements": (movement_fields(ways), tuple(MovementRow.model_fields)),
    }
    write = _WRITERS[form]
    return {
        name: write(folder / f"{name}.{form}", rows, columns, units)
        for name, (rows, columns) in tables.items()
    }


def _csv(path: Path, rows: Iterable[dict[str, object]], columns: tuple[str, ...], units: Units) -> int:
    from service.storage.flow_exports import csv_rows

    with path.open("w", encoding="utf-8", newline="") as file:
        lines = -1  # the header
        for line in csv_rows(rows, columns, units):
            file.write(line)
            lines += 1
    return lines


def _jsonl(path: Path, rows: Iterable[dict[str, object]], _: tuple[str, ...], __: Units) -> int:
    lines = 0
    with path.open("wb") as file:
        for row in rows:
            file.write(orjson.dumps(row) + b"\n")
            lines += 1
    return lines


def _parquet(path: Path, rows: Iterable[dict[str, object]], columns: tuple[str, ...], units: Units) -> int:
    from service.formats.parquet import parquet_bytes
    from service.storage.flow_exports import DEFINITION_TEXT, column_names, converted

    names = column_names(columns, units)
    table = [dict(zip(names, converted(row, columns, units), strict=True)) for row in rows]
    path.write_bytes(parquet_bytes(table, names, DEFINITION_TEXT))
    return len(table)


_WRITERS: Mapping[Form, Callable[[Path, Iterable[dict[str, object]], tuple[str, ...], Units], int]] = {
    Form.CSV: _csv,
    Form.JSONL: _jsonl,
    Form.PARQUET: _parquet,
}


def _time_us(option: str, text: str) -> int:
    try:
        return parse_time_us(text)
    except ValueError as error:
        raise InvalidInput(f"{option}: {error}") from None
