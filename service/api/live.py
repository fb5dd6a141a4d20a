"""The newest tracks of a sensor over HTTP: polled with an entity tag, long-polled, or streamed by SSE."""

from __future__ import annotations

import time
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response, status
from fastapi.responses import StreamingResponse

from service.api import live_view
from service.api.dependencies import PREFIX, SensorPath, Services, admit
from service.api.track_schemas import LiveView
from service.errors import NotFound
from service.formats.sensor import SensorConfig
from service.pipeline.live import LiveEntry

router = APIRouter(prefix=PREFIX)

WAIT_MAX_S = 30.0  # below the idle time-out of common proxies
VERSION_MAX = 2**63 - 1

PointsFlag = Annotated[bool, Query(description="add the raw points of the newest frame")]


@router.get("/sensors/{sensor_id}/live", tags=["live"], response_model=LiveView)
async def read_live(
    sensor_id: SensorPath,
    request: Request,
    after: Annotated[
        int | None, Query(ge=0, le=VERSION_MAX, description="wait until the version is another than this")
    ] = None,
    wait: Annotated[float, Query(ge=0, le=WAIT_MAX_S, description="seconds to wait at most")] = 0.0,
    points: PointsFlag = False,  # noqa: FBT002 - a parameter of the query
) -> Response:
    """The newest tracks, with an ETag; `after` and `wait` make it a long poll."""
    services = await admit(request, "read")
    entry = _newest(services, sensor_id)
    if after is not None and wait > 0:
        entry = await services.host.live.wait(sensor_id, after, wait) or entry
    now_us = time.time_ns() // 1000
    tag = live_view.etag(entry, now_us, points=points)
    headers = {"ETag": tag, "Cache-Control": "no-cache"}
    if _matches(request.headers.get("if-none-match"), tag):
        return Response(status_code=status.HTTP_304_NOT_MODIFIED, headers=headers)
    body = live_view.body(entry, _config(services, sensor_id), now_us, points=points)
    return Response(body, headers=headers, media_type="application/json")


@router.get("/sensors/{sensor_id}/live/stream", tags=["live"], response_class=StreamingResponse)
async def stream_live(
    sensor_id: SensorPath,
    request: Request,
    last_event_id: Annotated[str | None, Header(max_length=64)] = None,
    points: PointsFlag = False,  # noqa: FBT002 - a parameter of the query
) -> Response:
    """The same as server-sent events; a slow reader misses views, never the newest, and is told how many."""
    services = await admit(request, "read")
    _newest(services, sensor_id)
    known = last_event_id is not None and last_event_id.isdecimal() and last_event_id.isascii()
    return StreamingResponse(
        services.broadcasts.stream(sensor_id, int(last_event_id or 0) if known else None, points=points),
        media_type="text/event-stream",
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
    )


def _newest(services: Services, sensor_id: str) -> LiveEntry:
    entry = services.host.live.newest(sensor_id)
    if entry is None:
        raise NotFound(f"no sensor {sensor_id}")
    return entry


def _config(services: Services, sensor_id: str) -> SensorConfig:
    return services.host.config(sensor_id)


def _matches(header: str | None, tag: str) -> bool:
    """Return whether If-None-Match names the tag (RFC 9110, 13.1.2; weak comparison)."""
    if header is None:
        return False
    return any(item.strip().removeprefix("W/") in {tag, "*"} for item in header.split(","))
