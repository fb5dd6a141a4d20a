"""Lane maps and lane changes of a sensor over HTTP."""

from __future__ import annotations

import hashlib
from typing import Annotated

import orjson
from fastapi import APIRouter, Query, Request, Response, status
from sqlalchemy import Connection

from service.api.dependencies import (
    PREFIX,
    AdminKey,
    Cursor,
    Limit,
    Reader,
    ReadKey,
    SensorPath,
    ServicesDep,
    TimeText,
    time_range_us,
)
from service.api.lane_schemas import (
    LaneChangeReply,
    LaneControlInput,
    LaneMapReply,
    LaneVersionReply,
    lane_reply,
    read_version,
    version_reply,
    version_text,
)
from service.api.negotiation import MEDIA_TYPES, choose_format
from service.api.paging import page_reply
from service.api.schemas import Page
from service.api.sensors import change_config
from service.errors import Conflict, InvalidInput, NotFound
from service.formats.georeference import pose_of
from service.formats.lanes import lanes_geojson, read_lanes_json
from service.formats.rfc3339 import format_time
from service.formats.sensor import GivenLane, LaneControl, SensorConfig
from service.storage.database import connection
from service.storage.lanes import list_lane_changes, list_lane_maps, newest_lane_map, read_lane_map
from service.storage.rows import LaneMapRow
from service.storage.sites import read_sensor

router = APIRouter(prefix=PREFIX)

VersionText = Annotated[str | None, Query(max_length=24, description="of the map; the newest without it")]


@router.get("/sensors/{sensor_id}/lanes", tags=["lanes"], response_model=LaneMapReply)
def read_lanes(
    sensor_id: SensorPath,
    request: Request,
    reader: Reader,
    _: ReadKey,
    version: VersionText = None,
    format: Annotated[str | None, Query(description="json or geojson")] = None,  # noqa: A002 - its name in the query
) -> Response:
    """The lane map: lines in the plan frame, and as GeoJSON (WGS84) by `Accept` or `?format=geojson`.

    GeoJSON is refused (409) where the sensor has no position; the plan frame is always given.
    """
    config = read_sensor(reader, sensor_id).config
    form = choose_format(request, format, ("json", "geojson"))
    row = _asked(reader, sensor_id, version)
    body = _geojson(row, config) if form == "geojson" else _json(sensor_id, row, config)
    tag = f'"{hashlib.sha256(body).hexdigest()[:24]}"'
    headers = {"ETag": tag, "Cache-Control": "no-cache"}
    if tag in request.headers.get("if-none-match", ""):
        return Response(status_code=status.HTTP_304_NOT_MODIFIED, headers=headers)
    return Response(body, headers=headers, media_type=MEDIA_TYPES[form])


@router.get("/sensors/{sensor_id}/lanes/versions", tags=["lanes"])
def read_lane_versions(  # noqa: PLR0913, PLR0917 - one parameter of the query each
    sensor_id: SensorPath,
    request: Request,
    response: Response,
    reader: Reader,
    _: ReadKey,
    cursor: Cursor = None,
    limit: Limit = 100,
) -> Page[LaneVersionReply]:
    """Versions of the lane map, oldest first, each with what it changed."""
    page = list_lane_maps(reader, sensor_id, cursor=cursor, limit=limit)
    before = dict(zip(map(version_text, page.items[1:]), page.items[:-1], strict=True))
    if page.items and cursor is not None:
        first = page.items[0]
        if first.version > 1:
            before[version_text(first)] = read_lane_map(reader, sensor_id, first.epoch, first.version - 1)
    return page_reply(request, response, page, lambda row: version_reply(row, before.get(version_text(row))))


@router.put("/sensors/{sensor_id}/lanes", tags=["lanes"], status_code=status.HTTP_202_ACCEPTED)
def control_lanes(
    sensor_id: SensorPath, body: LaneControlInput, services: ServicesDep, caller: AdminKey
) -> LaneControl:
    """Accept, pin, rename or replace the lane map, or learn on; in force between two of the next frames."""
    with connection(services.engine) as reader:
        before = read_sensor(reader, sensor_id).config.lanes
        control = _controlled(before, body, reader, sensor_id)
    # a merge patch takes a name away by null
    gone = {key: None for key in before.names if key not in control.names}
    wanted = control.model_dump(mode="json")
    change_config(services, sensor_id, {"lanes": {**wanted, "names": {**wanted["names"], **gone}}}, caller)
    return control


@router.get("/sensors/{sensor_id}/lane-changes", tags=["lanes"])
def read_lane_changes(  # noqa: PLR0913, PLR0917 - one parameter of the query each
    sensor_id: SensorPath,
    request: Request,
    response: Response,
    reader: Reader,
    _: ReadKey,
    start: TimeText = None,
    end: TimeText = None,
    cursor: Cursor = None,
    limit: Limit = 100,
) -> Page[LaneChangeReply]:
    """Lane changes in [start, end) by the time at which the boundary was crossed."""
    start_us, end_us = time_range_us(start, end)
    page = list_lane_changes(reader, sensor_id, start_us=start_us, end_us=end_us, cursor=cursor, limit=limit)
    return page_reply(request, response, page, LaneChangeReply.of)


def _asked(reader: Connection, sensor_id: str, version: str | None) -> LaneMapRow | None:
    if version is None:
        return newest_lane_map(reader, sensor_id)
    return read_lane_map(reader, sensor_id, *read_version(version))


def _json(sensor_id: str, row: LaneMapRow | None, config: SensorConfig) -> bytes:
    pose, control = pose_of(config), config.lanes
    lanes = read_lanes_json(row.lanes) if row is not None else ()
    reply = LaneMapReply(
        sensor_id=sensor_id,
        version=None if row is None else version_text(row),
        since=None if row is None else format_time(row.time_us),
        frame=None if row is None else row.frame,
        vehicles=0 if row is None else row.vehicles,
        source=None if row is None else ("user" if row.source == "user" else "learned"),
        mode=control.mode,
        accepted=row is not None and control.accepted == version_text(row),
        lanes=[lane_reply(lane, control.names, pose) for lane in lanes],
    )
    return orjson.dumps(reply.model_dump(mode="json"))


def _geojson(row: LaneMapRow | None, config: SensorConfig) -> bytes:
    pose = pose_of(config)
    if pose is None:
        raise Conflict(
            f"{config.sensor_id} has no latitude_deg and longitude_deg: its lanes have no place on earth"
        )
    lanes = read_lanes_json(row.lanes) if row is not None else ()
    return orjson.dumps(lanes_geojson(lanes, pose, config.lanes.names))


def _controlled(
    before: LaneControl, body: LaneControlInput, reader: Connection, sensor_id: str
) -> LaneControl:
    """Return the control that an action leads to; raises InvalidInput, NotFound."""
    merged = before.names | body.names
    names = {key: name for key, name in merged.items() if name}
    changes: dict[str, object] = {"names": names}
    if body.lanes and body.action != "replace":
        raise InvalidInput.at("/lanes", "lanes are given with the action replace only")
    match body.action:
        case "accept":
            changes["accepted"] = version_text(_named(reader, sensor_id, body.version))
        case "pin":
            row = _named(reader, sensor_id, body.version)
            changes |= {"mode": "pinned", "lanes": _given(row), "accepted": version_text(row)}
        case "replace":
            if not body.lanes:
                raise InvalidInput.at("/lanes", "want the lanes that replace the map")
            changes |= {"mode": "replaced", "lanes": tuple(body.lanes)}
        case "learn":
            changes |= {"mode": "learned", "lanes": ()}
        case "rename":
            if not body.names:
                raise InvalidInput.at("/names", "want lane_id and name of what is renamed")
    return before.model_copy(update=changes)


def _named(reader: Connection, sensor_id: str, version: str | None) -> LaneMapRow:
    row = _asked(reader, sensor_id, version)
    if row is None:
        raise NotFound(f"{sensor_id} has no lane map yet")
    return row


def _given(row: LaneMapRow) -> tuple[GivenLane, ...]:
    return tuple(
        GivenLane(
            index=lane.index,
            points_m=lane.points_m,
            width_m=sum(lane.width_m) / len(lane.width_m),
            kind="turn" if lane.kind == "turn" else "lane",
            vehicles=lane.vehicles,
        )
        for lane in read_lanes_json(row.lanes)
    )
