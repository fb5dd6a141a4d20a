"""The newest tracks of a sensor over HTTP: polled with an entity tag, long-polled, or streamed by SSE."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response, status
from fastapi.responses import StreamingResponse

from service.api import live_view
from service.api.dependencies import PREFIX, SensorPath, Services, admit
from service.api.track_schemas import LiveView
from service.errors import NotFound
from service.formats.sensor import SensorConfig
from service.pipeline.live import STALE_AFTER_US, LiveEntry

router = APIRouter(prefix=PREFIX)

WAIT_MAX_S = 30.0  # below the idle time-out of common proxies
STREAM_PERIOD_S = 0.1  # newest wins: a stream carries at most ten views a second
KEEP_ALIVE_S = 15.0
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
        entry = await _news(services, sensor_id, after, wait) or entry
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
    """The same as server-sent events, at most ten a second: a slow reader misses views, never the newest."""
    services = await admit(request, "read")
    _newest(services, sensor_id)
    seen = int(last_event_id) if last_event_id is not None and last_event_id.isdecimal() else -1
    return StreamingResponse(
        _stream(services, sensor_id, seen, points=points),
        media_type="text/event-stream",
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
    )


async def _stream(services: Services, sensor_id: str, seen: int, *, points: bool) -> AsyncIterator[bytes]:
    shown: tuple[int, str] | None = None
    if (entry := services.host.live.newest(sensor_id)) is not None and entry.version == seen:
        shown = seen, entry.state(time.time_ns() // 1000)
    yield b"retry: 1000\n\n"
    while not services.closing.is_set():
        entry = services.host.live.newest(sensor_id)
        if entry is None:
            yield b"event: end\ndata: {}\n\n"
            return
        now_us = time.time_ns() // 1000
        state = entry.state(now_us)
        if (entry.version, state) != shown:
            shown = entry.version, state
            body = live_view.body(entry, _config(services, sensor_id), now_us, points=points)
            yield b"id: %d\nevent: live\ndata: %b\n\n" % (entry.version, body)
            await asyncio.sleep(STREAM_PERIOD_S)
        patience_s = _patience_s(entry, now_us)
        news = await _news(services, sensor_id, entry.version, patience_s)
        if news is entry and patience_s == KEEP_ALIVE_S:
            yield b": keep-alive\n\n"


def _patience_s(entry: LiveEntry, now_us: int) -> float:
    """Return how long a stream may stay silent: until the view turns stale or a keep-alive is due."""
    if entry.received_us is None or entry.state(now_us) == "stale":
        return KEEP_ALIVE_S
    return min((entry.received_us + STALE_AFTER_US - now_us) / 1e6 + 0.01, KEEP_ALIVE_S)


async def _news(services: Services, sensor_id: str, after: int, timeout_s: float) -> LiveEntry | None:
    """Wait for another version, but not beyond the end of the service."""
    waiting = asyncio.ensure_future(services.host.live.wait(sensor_id, after, timeout_s))
    closing = asyncio.ensure_future(services.closing.wait())
    try:
        await asyncio.wait((waiting, closing), return_when=asyncio.FIRST_COMPLETED)
        return waiting.result() if waiting.done() else services.host.live.newest(sensor_id)
    finally:
        waiting.cancel()
        closing.cancel()


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
