"""Stored tracks and their states over HTTP: pages of JSON, and streamed NDJSON, CSV and GeoJSON."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, islice
from typing import Annotated, Any

import numpy as np
import orjson
from fastapi import APIRouter, Depends, Path, Query, Request, Response
from fastapi.responses import StreamingResponse
from sqlalchemy import Connection, Engine

from service.api.dependencies import (
    PREFIX,
    Cursor,
    Reader,
    ReadKey,
    SensorPath,
    ServicesDep,
    TimeText,
    time_range_us,
)
from service.api.exports import exported
from service.api.negotiation import MEDIA_TYPES, choose_format
from service.api.paging import next_link
from service.api.schemas import Page
from service.api.track_schemas import TRACK_COLUMNS, StateReply, TrackReply, track_fields
from service.errors import InvalidInput
from service.formats.georeference import Pose, pose_of
from service.formats.track_exports import (
    STATE_COLUMNS,
    StateTable,
    csv_header,
    csv_lines,
    path_feature,
    state_records,
)
from service.formats.tracks import stored_line
from service.storage import states, tracks
from service.storage.database import connection
from service.storage.rows import STATE_SAMPLE, StateBlock, TrackKey, TrackSummary
from service.storage.sites import ordinal_of, read_sensor
from service.storage.tracks import TrackQuery

router = APIRouter(prefix=PREFIX)

PAGE_TRACKS = 100  # tracks of a page unless told
PAGE_SECONDS = 600  # seconds of states in a page unless told
LAST_US = 253_402_300_800_000_000  # the year 10000: later than any time that can be written
CSV_ROWS = 500  # records of one piece of a CSV stream

TrackId = Annotated[str, Path(pattern=r"^[A-Za-z0-9_-]{1,100}$", examples=["radar-1-1-3"])]
Format = Annotated[
    str | None, Query(alias="format", description="instead of the Accept header", examples=["csv"])
]
PageLimit = Annotated[int | None, Query(ge=1, le=10_000, description="items of one page")]


@dataclass(frozen=True, slots=True)
class Paging:
    """Which part of a list."""

    cursor: str | None
    limit: int | None

    def refuse(self) -> None:
        """Raise InvalidInput where a stream was asked for, which has no pages."""
        for name, value in (("cursor", self.cursor), ("limit", self.limit)):
            if value is not None:
                raise InvalidInput.at(f"/{name}", "only JSON comes in pages; this format streams all at once")


def _paging(cursor: Cursor = None, limit: PageLimit = None) -> Paging:
    return Paging(cursor, limit)


Responses = dict[int | str, dict[str, Any]]  # as FastAPI types it

PagingDep = Annotated[Paging, Depends(_paging)]
_EXPORTS: Responses = {
    200: {"content": {MEDIA_TYPES[name]: {} for name in ("ndjson", "csv", "geojson")}},
    406: {"description": "none of the media types in Accept can be given"},
}


@router.get("/tracks", tags=["tracks"], response_model=Page[TrackReply], responses=_EXPORTS)
def read_tracks(  # noqa: PLR0913, PLR0917 - one parameter of the query each
    request: Request,
    services: ServicesDep,
    reader: Reader,
    _: ReadKey,
    paging: PagingDep,
    sensor_id: Annotated[str | None, Query(pattern=r"^[A-Za-z0-9_-]{1,64}$")] = None,
    start: TimeText = None,
    end: TimeText = None,
    wanted: Format = None,
) -> Response:
    """Tracks seen at some time in [start, end), by the time of their first state."""
    form = choose_format(request, wanted, ("json", "ndjson", "csv", "geojson"))
    query = TrackQuery(sensor_id, *time_range_us(start, end))
    if form == "json":
        page = tracks.list_tracks(reader, query, cursor=paging.cursor, limit=paging.limit or PAGE_TRACKS)
        return _page(request, [track_fields(track) for track in page.items], page.next_cursor)
    paging.refuse()
    if sensor_id is not None:
        ordinal_of(reader, sensor_id)  # NotFound now; inside the stream it would come too late
    window = {"sensor_id": sensor_id, "start_us": query.start_us, "end_us": query.end_us}
    return services.exports.stream("tracks", {"form": form, **window}, MEDIA_TYPES[form])


@router.get("/tracks/{track_id}", tags=["tracks"], response_model=TrackReply, responses=_EXPORTS)
def read_track(
    track_id: TrackId, request: Request, reader: Reader, _: ReadKey, wanted: Format = None
) -> Response:
    """One track; as GeoJSON with its whole path."""
    form = choose_format(request, wanted, ("json", "geojson"))
    key = tracks.parse_track_id(track_id)
    track = tracks.read_track(reader, key)
    if form == "geojson":
        return _geojson(_whole_path(reader, track))
    return _json(track_fields(track))


@router.get("/tracks/{track_id}/states", tags=["tracks"], response_model=Page[StateReply], responses=_EXPORTS)
def read_track_states(
    track_id: TrackId,
    request: Request,
    reader: Reader,
    _: ReadKey,
    paging: PagingDep,
    wanted: Format = None,
) -> Response:
    """The states of one track by time; a page of JSON holds `limit` seconds of them."""
    form = choose_format(request, wanted, ("json", "ndjson", "csv", "geojson"))
    key = tracks.parse_track_id(track_id)
    pose = _pose(reader, key.sensor_id)
    if form == "json":
        page = tracks.list_blocks(reader, key, cursor=paging.cursor, limit=paging.limit or PAGE_SECONDS)
        records = state_records(_table(key, page.items), pose)
        return _page(request, records, page.next_cursor)
    paging.refuse()
    if form == "geojson":
        return _geojson(_whole_path(reader, tracks.read_track(reader, key)))
    records = state_records(_table(key, _all_blocks(reader, key)), pose)
    pieces = _csv(STATE_COLUMNS, iter(records)) if form == "csv" else _ndjson(records)
    return Response(b"".join(pieces), media_type=MEDIA_TYPES[form])


@router.get("/sensors/{sensor_id}/states", tags=["tracks"], response_class=StreamingResponse)
def read_states(  # noqa: PLR0913, PLR0917 - one parameter of the query each
    sensor_id: SensorPath,
    request: Request,
    services: ServicesDep,
    reader: Reader,
    _: ReadKey,
    start: TimeText = None,
    end: TimeText = None,
    wanted: Format = None,
) -> Response:
    """All states of a sensor in [start, end), a line for each frame, as in tracks.jsonl; or CSV."""
    form = choose_format(request, wanted, ("ndjson", "csv"))
    start_us, end_us = time_range_us(start, end)
    ordinal_of(reader, sensor_id)  # NotFound now; inside the stream it would come too late
    window = {"start_us": start_us or 0, "end_us": LAST_US if end_us is None else end_us}
    return services.exports.stream(
        "states", {"form": form, "sensor_id": sensor_id, **window}, MEDIA_TYPES[form]
    )


@exported("states")
def state_pieces(engine: Engine, *, form: str, sensor_id: str, start_us: int, end_us: int) -> Iterator[bytes]:
    """Yield the states of a sensor in [start_us, end_us) as NDJSON or CSV."""
    found = states.stream_states(engine, sensor_id, start_us, end_us)
    if form != "csv":
        return map(_line_of, found)
    with connection(engine) as reader:
        pose = _pose(reader, sensor_id)
    records = chain.from_iterable(state_records(_table_of(frame), pose) for frame in found)
    return _csv(STATE_COLUMNS, records)


@exported("tracks")
def track_pieces(
    engine: Engine, *, form: str, sensor_id: str | None, start_us: int | None, end_us: int | None
) -> Iterator[bytes]:
    """Yield the tracks of a window as NDJSON, CSV or GeoJSON."""
    found = tracks.stream_tracks(engine, TrackQuery(sensor_id, start_us, end_us))
    if form == "ndjson":
        return _ndjson(track_fields(track) for track in found)
    if form == "csv":
        return _csv(TRACK_COLUMNS, (track_fields(track) for track in found))
    return _feature_collection(found, engine)


def _feature_collection(found: Iterator[TrackSummary], engine: Engine) -> Iterator[bytes]:
    """Yield a GeoJSON FeatureCollection: each track as the line from its first to its last position."""
    poses: dict[str, Pose | None] = {}
    separator = b'{"type":"FeatureCollection","features":[\n'
    for track in found:
        sensor_id = track.key.sensor_id
        if sensor_id not in poses:
            with connection(engine) as reader:
                poses[sensor_id] = _pose(reader, sensor_id)
        x_m = np.array([track.first_x_m, track.last_x_m])
        y_m = np.array([track.first_y_m, track.last_y_m])
        properties = track_fields(track) | {"geometry_holds": "first and last position"}
        yield separator + orjson.dumps(path_feature(properties, poses[sensor_id], x_m, y_m))
        separator = b",\n"
    yield b"\n]}\n" if separator == b",\n" else separator + b"]}\n"


def _whole_path(reader: Connection, track: TrackSummary) -> dict[str, object]:
    table = _table(track.key, _all_blocks(reader, track.key))
    records = state_records(table, None)
    properties = track_fields(track) | {"times": [record["timestamp"] for record in records]}
    x_m, y_m = table.samples["x_m"].astype(np.float64), table.samples["y_m"].astype(np.float64)
    return path_feature(properties, _pose(reader, track.key.sensor_id), x_m, y_m)


def _all_blocks(reader: Connection, key: TrackKey) -> list[StateBlock]:
    blocks: list[StateBlock] = []
    cursor: str | None = None
    while True:
        page = tracks.list_blocks(reader, key, cursor=cursor)
        blocks += page.items
        cursor = page.next_cursor
        if cursor is None:
            return blocks


def _table(key: TrackKey, blocks: tuple[StateBlock, ...] | list[StateBlock]) -> StateTable:
    samples = np.frombuffer(b"".join(block.samples for block in blocks), STATE_SAMPLE)
    lengths = [len(block.samples) // STATE_SAMPLE.itemsize for block in blocks]
    seconds = np.repeat(np.array([block.second for block in blocks], np.int64), lengths)
    first_frames = np.repeat(np.array([block.first_frame for block in blocks], np.int64), lengths)
    return StateTable(
        sensor_id=key.sensor_id,
        epoch=key.epoch,
        number=np.full(len(samples), key.number, np.int64),
        frame=first_frames + samples["frame_offset"],
        time_us=(seconds * 1000 + samples["time_offset_ms"]) * 1000,
        samples=samples,
    )


def _table_of(frame: states.StateFrame) -> StateTable:
    count = len(frame.states.number)
    return StateTable(
        sensor_id=frame.sensor_id,
        epoch=frame.epoch,
        number=frame.states.number,
        frame=np.full(count, frame.frame, np.int64),
        time_us=np.full(count, frame.time_us, np.int64),
        samples=frame.states.samples,
    )


def _line_of(frame: states.StateFrame) -> bytes:
    return stored_line(frame.sensor_id, frame.epoch, frame.frame, frame.time_us, frame.states) + b"\n"


def _pose(reader: Connection, sensor_id: str) -> Pose | None:
    return pose_of(read_sensor(reader, sensor_id, include_archived=True).config)


def _ndjson(records: Iterator[dict[str, object]] | list[dict[str, object]]) -> Iterator[bytes]:
    return (orjson.dumps(record) + b"\n" for record in records)


def _csv(columns: tuple[str, ...], records: Iterator[dict[str, object]]) -> Iterator[bytes]:
    yield csv_header(columns).encode()
    while piece := list(islice(records, CSV_ROWS)):
        yield csv_lines(columns, piece).encode()


def _page(request: Request, items: list[dict[str, object]], cursor: str | None) -> Response:
    headers = {} if cursor is None else {"Link": next_link(request, cursor)}
    return Response(
        orjson.dumps({"items": items, "next": cursor}), headers=headers, media_type=MEDIA_TYPES["json"]
    )


def _json(body: dict[str, object]) -> Response:
    return Response(orjson.dumps(body), media_type=MEDIA_TYPES["json"])


def _geojson(feature: dict[str, object]) -> Response:
    return Response(orjson.dumps(feature), media_type=MEDIA_TYPES["geojson"])
