"""Events of sensors: write them again without effect, read them by time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from sqlalchemy import Connection, select, tuple_

from service.storage.database import insert_or_advance
from service.storage.page import Page, check_limit, cut, read_cursor
from service.storage.rows import EventRow
from service.storage.sites import ordinal_of
from service.storage.tables import events

_US_PER_DAY: Final = 86_400_000_000

# The time of an event's opening does not change, and cursors and retention rely on it.
_KEPT: Final = frozenset({"time_us", "stored_day"})
_BY_TIME: Final = (events.c.time_us, events.c.epoch, events.c.number)


def save_events(connection: Connection, rows: Sequence[EventRow], *, now_us: int) -> None:
    """Write events; a stored one gives way only to one with a later `as_of`, so a replay changes nothing."""
    if not rows:
        return
    ordinals = {sensor_id: ordinal_of(connection, sensor_id) for sensor_id in {row.sensor_id for row in rows}}
    connection.execute(
        insert_or_advance(connection, "events", _KEPT),
        [
            {
                "sensor": ordinals[row.sensor_id],
                "epoch": row.epoch,
                "number": row.number,
                "as_of": row.as_of,
                "kind": row.kind,
                "time_us": row.time_us,
                "detail": row.detail,
                "stored_day": now_us // _US_PER_DAY,
            }
            for row in rows
        ],
    )


def list_events(  # noqa: PLR0913 - one filter each
    connection: Connection,
    sensor_id: str,
    *,
    start_us: int | None = None,
    end_us: int | None = None,
    kind: str | None = None,
    cursor: str | None = None,
    limit: int = 100,
) -> Page[EventRow]:
    """Return the events of a sensor in [start_us, end_us) by time; raises NotFound for an unknown sensor."""
    statement = (
        select(events)
        .where(events.c.sensor == ordinal_of(connection, sensor_id))
        .order_by(*_BY_TIME)
        .limit(check_limit(limit) + 1)
    )
    if start_us is not None:
        statement = statement.where(events.c.time_us >= start_us)
    if end_us is not None:
        statement = statement.where(events.c.time_us < end_us)
    if kind is not None:
        statement = statement.where(events.c.kind == kind)
    if cursor is not None:
        statement = statement.where(tuple_(*_BY_TIME) > read_cursor(cursor, int, int, int))
    found = [
        EventRow(sensor_id, r.epoch, r.number, r.as_of, r.kind, r.time_us, r.detail)
        for r in connection.execute(statement)
    ]
    return cut(found, limit, lambda event: (event.time_us, event.epoch, event.number))
