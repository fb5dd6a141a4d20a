"""Crossings and traffic measures over HTTP, with the evidence behind each number, and counts by hand."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import orjson
from fastapi import APIRouter, Body, Depends, Path, Query, Request, Response
from fastapi.responses import StreamingResponse
from sqlalchemy import Connection, Engine

from service.api.dependencies import (
    PREFIX,
    AdminKey,
    Cursor,
    Reader,
    ReadKey,
    SensorPath,
    ServicesDep,
    TimeText,
    time_range_us,
)
from service.api.exports import exported
from service.api.flow_json import rows_json
from service.api.flow_schemas import (
    CellReply,
    CellRow,
    CheckReply,
    CoverageReply,
    CrossingReply,
    EvidenceReply,
    FlowReply,
    FlowRow,
    ManualCountInput,
    MovementReply,
    MovementRow,
)
from service.api.flow_views import check_fields, evidence_fields, manual_counts_of, movement_fields
from service.api.negotiation import MEDIA_TYPES, choose_format
from service.api.paging import next_link
from service.api.schemas import Page
from service.errors import InvalidInput
from service.formats.local_days import Interval
from service.formats.parquet import parquet_bytes
from service.formats.rfc3339 import format_time
from service.storage import flow as store
from service.storage.database import session_scope
from service.storage.flow import CrossingQuery, FlowQuery
from service.storage.flow_exports import DEFINITION_TEXT, Units, column_names, converted, csv_rows, pems_rows
from service.storage.manual_counts import check_counts, compare, save_manual_counts
from service.storage.sites import ordinal_of
from service.traffic.flow_fields import crossing_fields, edie_fields, flow_columns, parse_row_name, rows_of

router = APIRouter(prefix=PREFIX)

PAGE_CROSSINGS = 1000
LAST_US = 253_402_300_800_000_000  # the year 10000
MOST_CHECKS = 2000  # counts by hand in one request: three weeks of quarters of an hour
_DIMENSIONS = frozenset({"lane", "direction", "length_class"})

Rows = Sequence[Mapping[str, object]] | orjson.Fragment
Responses = dict[int | str, dict[str, Any]]  # as FastAPI types it
_EXPORTS: Responses = {
    200: {"content": {MEDIA_TYPES[name]: {} for name in ("ndjson", "csv", "parquet")}},
    406: {"description": "none of the media types in Accept can be given"},
}

Format = Annotated[str | None, Query(alias="format", description="instead of the Accept header")]
LineId = Annotated[str | None, Query(max_length=64, description="of one count line", examples=["C40"])]
UnitsOf = Annotated[Units, Query(description="of speeds in CSV and Parquet; columns are renamed")]
TimeZone = Annotated[
    str | None,
    Query(max_length=64, description="IANA name; bins local days, never shifts times. Default: the site's"),
]


@dataclass(frozen=True, slots=True)
class Window:
    """A window in which measures are asked for, in intervals."""

    start: Annotated[str, Query(description="RFC 3339", examples=["2025-05-12T00:00:00Z"])]
    end: Annotated[str, Query(description="RFC 3339", examples=["2025-05-13T00:00:00Z"])]
    interval: Annotated[Interval, Query(description="minutes of UTC, or local days")] = "15min"
    tz: TimeZone = None
    line_id: LineId = None

    def query(self, sensor_id: str, by: frozenset[str] = frozenset()) -> FlowQuery:
        """Return what to read; raises InvalidInput."""
        start_us, end_us = time_range_us(self.start, self.end)
        return FlowQuery(sensor_id, start_us or 0, end_us or 0, self.interval, self.tz, self.line_id, by)


WindowDep = Annotated[Window, Depends()]


@router.get(
    "/sensors/{sensor_id}/crossings", tags=["counts"], response_model=Page[CrossingReply], responses=_EXPORTS
)
def read_crossings(  # noqa: PLR0913, PLR0917 - one parameter of the query each
    sensor_id: SensorPath,
    request: Request,
    services: ServicesDep,
    reader: Reader,
    _: ReadKey,
    start: TimeText = None,
    end: TimeText = None,
    line_id: LineId = None,
    cursor: Cursor = None,
    limit: Annotated[int, Query(ge=1, le=10_000)] = PAGE_CROSSINGS,
    wanted: Format = None,
    units: UnitsOf = "mps",
) -> Response:
    """Vehicles over count lines in [start, end), by time: the rows that every count is made of."""
    form = choose_format(request, wanted, ("json", "ndjson", "csv", "parquet"))
    start_us, end_us = time_range_us(start, end)
    query = CrossingQuery(sensor_id, start_us or 0, LAST_US if end_us is None else end_us, line_id)
    ordinal_of(reader, sensor_id)  # NotFound now; inside a stream it would come too late
    if form == "json":
        page = store.list_crossings(services.engine, query, cursor=cursor, limit=limit)
        items = [crossing_fields(sensor_id, table.take([i]))[0] for i, table in page.items]
        return _page(request, items, page.next_cursor)
    if cursor is not None:
        raise InvalidInput.at("/cursor", "only JSON comes in pages; this format streams all at once")
    if form == "parquet":  # its file is made as a whole
        return _parquet(_crossing_rows(services.engine, query), tuple(CrossingReply.model_fields), units)
    asked = {"sensor_id": sensor_id, "start_us": query.start_us, "end_us": query.end_us, "line_id": line_id}
    return services.exports.stream("crossings", {"form": form, "units": units, **asked}, MEDIA_TYPES[form])


@exported("crossings")
def crossing_pieces(  # noqa: PLR0913 - what is asked for
    engine: Engine,
    *,
    form: str,
    units: Units,
    sensor_id: str,
    start_us: int,
    end_us: int,
    line_id: str | None,
) -> Iterator[bytes]:
    """Yield the crossings of a window as NDJSON or CSV."""
    rows = _crossing_rows(engine, CrossingQuery(sensor_id, start_us, end_us, line_id))
    if form == "ndjson":
        return (orjson.dumps(row) + b"\n" for row in rows)
    return (line.encode() for line in csv_rows(rows, tuple(CrossingReply.model_fields), units))


def _crossing_rows(engine: Engine, query: CrossingQuery) -> Iterator[dict[str, object]]:
    for table in store.stream_crossings(engine, query):
        yield from crossing_fields(query.sensor_id, table)


@router.get("/sensors/{sensor_id}/flow", tags=["counts"], response_model=FlowReply, responses=_EXPORTS)
def read_flow(  # noqa: PLR0913, PLR0917 - one parameter of the query each
    sensor_id: SensorPath,
    request: Request,
    reader: Reader,
    _: ReadKey,
    window: WindowDep,
    by: Annotated[
        str, Query(description="which of lane, direction, length_class to tell apart", max_length=64)
    ] = "lane,direction",
    histogram: Annotated[bool, Query(description="with the histogram of speeds")] = True,  # noqa: FBT002
    wanted: Format = None,
    units: UnitsOf = "mps",
) -> Response:
    """Volume, flow rate, speeds, occupancy, density, headway and gap by line, lane, direction and interval.

    `format=pems` gives lane CSV as in PeMS's station files.
    """
    form = choose_format(request, wanted, ("json", "ndjson", "csv", "parquet", "pems"))
    query = window.query(sensor_id, _dimensions("lane,direction" if form == "pems" else by))
    flow = store.read_flow(reader, query)
    if form == "pems":
        zone = query.time_zone or store.zone_of(reader, sensor_id)
        return _stream("csv", (line.encode() for line in pems_rows(flow, zone)))
    columns = flow_columns(sensor_id, flow, histogram=histogram)
    if form == "json":
        return _table(reader, query, rows_json(columns))
    return _export(form, iter(rows_of(columns)), tuple(FlowRow.model_fields), units)


@router.get("/sensors/{sensor_id}/flow/cells", tags=["counts"], response_model=CellReply, responses=_EXPORTS)
def read_cells(  # noqa: PLR0913, PLR0917 - one parameter of the query each
    sensor_id: SensorPath,
    request: Request,
    reader: Reader,
    _: ReadKey,
    window: WindowDep,
    wanted: Format = None,
    units: UnitsOf = "mps",
) -> Response:
    """Edie's flow, density and speed of each cell of a lane, from the trajectories themselves."""
    form = choose_format(request, wanted, ("json", "ndjson", "csv", "parquet"))
    query = window.query(sensor_id)
    rows = edie_fields(sensor_id, store.read_edie(reader, query))
    if form == "json":
        return _table(reader, query, rows)
    return _export(form, iter(rows), tuple(CellRow.model_fields), units)


@router.get("/sensors/{sensor_id}/flow/{row}/evidence", tags=["counts"])
def read_evidence(
    sensor_id: SensorPath,
    row: Annotated[str, Path(pattern=r"^[A-Za-z0-9_-]{1,400}$", description="`row` of a flow row")],
    reader: Reader,
    _: ReadKey,
) -> EvidenceReply:
    """The crossings, tracks and frames behind one flow row, and the row computed from them again."""
    evidence = store.read_evidence(reader, sensor_id, parse_row_name(row))
    return EvidenceReply.model_validate(evidence_fields(reader, sensor_id, evidence))


@router.get("/sensors/{sensor_id}/coverage", tags=["counts"])
def read_coverage(sensor_id: SensorPath, reader: Reader, _: ReadKey, window: WindowDep) -> CoverageReply:
    """How complete the data are: frames received of those expected, interval by interval."""
    query = window.query(sensor_id)
    names = ("start", "end", "coverage", "observed")
    rows = [
        dict(zip(names, (format_time(start), format_time(end), round(c, 4), round(o, 4)), strict=True))
        for start, end, c, o in store.read_coverage(reader, query)
    ]
    return CoverageReply.model_validate(_head(reader, query) | {"items": rows})


@router.get(
    "/sensors/{sensor_id}/movements", tags=["counts"], response_model=MovementReply, responses=_EXPORTS
)
def read_movements(
    sensor_id: SensorPath,
    request: Request,
    reader: Reader,
    _: ReadKey,
    window: WindowDep,
    wanted: Format = None,
) -> Response:
    """Turning movements: vehicles by entry and exit gate, length class and interval."""
    form = choose_format(request, wanted, ("json", "ndjson", "csv", "parquet"))
    query = window.query(sensor_id)
    rows = movement_fields(store.read_movements(reader, query))
    if form == "json":
        return _table(reader, query, rows)
    return _export(form, iter(rows), tuple(MovementRow.model_fields), "mps")


@router.post("/sensors/{sensor_id}/counts/checks", tags=["counts"])
def check_manual_counts(
    sensor_id: SensorPath,
    services: ServicesDep,
    _: AdminKey,
    counts: Annotated[list[ManualCountInput], Body(max_length=MOST_CHECKS)],
) -> CheckReply:
    """Keep counts by hand, in place of earlier ones, and return how the measured volumes compare."""
    manual = manual_counts_of(counts)
    with session_scope(services.engine) as connection:
        save_manual_counts(connection, sensor_id, manual, now_us=time.time_ns() // 1000)
        checked = compare(connection, sensor_id, manual)
    return CheckReply.model_validate({"sensor_id": sensor_id, "items": [check_fields(c) for c in checked]})


@router.get("/sensors/{sensor_id}/counts/checks", tags=["counts"])
def read_checks(
    sensor_id: SensorPath, reader: Reader, _: ReadKey, start: TimeText = None, end: TimeText = None
) -> CheckReply:
    """Counts by hand that begin in [start, end), each held against the measured volume."""
    start_us, end_us = time_range_us(start, end)
    checked = check_counts(reader, sensor_id, start_us or 0, LAST_US if end_us is None else end_us)
    return CheckReply.model_validate({"sensor_id": sensor_id, "items": [check_fields(c) for c in checked]})


def _dimensions(text: str) -> frozenset[str]:
    found = frozenset(part.strip() for part in text.split(",") if part.strip())
    if not found <= _DIMENSIONS:
        raise InvalidInput.at("/by", f"want some of {', '.join(sorted(_DIMENSIONS))}, got {text!r}")
    return found


def _head(reader: Connection, query: FlowQuery) -> dict[str, object]:
    zone = query.time_zone or store.zone_of(reader, query.sensor_id)
    return {"sensor_id": query.sensor_id, "interval": query.interval, "time_zone": zone}


def _table(reader: Connection, query: FlowQuery, rows: Rows) -> Response:
    body = orjson.dumps(_head(reader, query) | {"items": rows})
    return Response(body, media_type=MEDIA_TYPES["json"])


def _export(form: str, rows: Iterator[dict[str, object]], columns: tuple[str, ...], units: Units) -> Response:
    exports: Mapping[str, Callable[[], Response]] = {
        "ndjson": lambda: _stream("ndjson", (orjson.dumps(row) + b"\n" for row in rows)),
        "csv": lambda: _stream("csv", (line.encode() for line in csv_rows(rows, columns, units))),
        "parquet": lambda: _parquet(rows, columns, units),
    }
    return exports[form]()


def _parquet(rows: Iterator[dict[str, object]], columns: tuple[str, ...], units: Units) -> Response:
    names = column_names(columns, units)
    table = [dict(zip(names, converted(row, columns, units), strict=True)) for row in rows]
    return Response(parquet_bytes(table, names, DEFINITION_TEXT), media_type=MEDIA_TYPES["parquet"])


def _stream(form: str, pieces: Iterator[bytes]) -> Response:
    return StreamingResponse(pieces, media_type=MEDIA_TYPES[form])


def _page(request: Request, items: list[dict[str, object]], cursor: str | None) -> Response:
    headers = {} if cursor is None else {"Link": next_link(request, cursor)}
    body = orjson.dumps({"items": items, "next": cursor})
    return Response(body, headers=headers, media_type=MEDIA_TYPES["json"])
