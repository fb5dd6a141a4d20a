"""Stored events of a sensor over HTTP."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from service.api.dependencies import (
    PREFIX,
    Cursor,
    Limit,
    Reader,
    ReadKey,
    SensorPath,
    TimeText,
    time_range_us,
)
from service.api.paging import page_reply
from service.api.schemas import Page
from service.api.track_schemas import EventReply
from service.storage.events import list_events

router = APIRouter(prefix=PREFIX)


@router.get("/sensors/{sensor_id}/events", tags=["events"])
def read_events(  # noqa: PLR0913, PLR0917 - one parameter of the query each
    sensor_id: SensorPath,
    request: Request,
    response: Response,
    reader: Reader,
    _: ReadKey,
    start: TimeText = None,
    end: TimeText = None,
    kind: Annotated[str | None, Query(max_length=64)] = None,
    cursor: Cursor = None,
    limit: Limit = 100,
) -> Page[EventReply]:
    """Events of a sensor in [start, end), by time."""
    start_us, end_us = time_range_us(start, end)
    page = list_events(
        reader, sensor_id, start_us=start_us, end_us=end_us, kind=kind, cursor=cursor, limit=limit
    )
    return page_reply(request, response, page, EventReply.of)
