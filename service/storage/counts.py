"""Crossings, frames received and Edie's sums by minute: written again without effect, read by time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from sqlalchemy import Connection, Row, Select, Table, select

from service.storage.count_tables import cells_of, crossings_of_rows, received_of_rows
from service.storage.database import insert_or_advance
from service.storage.rows import CellRow, CrossingBlock, MinuteRow
from service.storage.sites import ordinal_of, read_sensor
from service.storage.tables import cell_minutes, crossing_blocks, traffic_minutes
from service.traffic.edie import CellTable
from service.traffic.flow import CrossingTable, Received
from service.traffic.records import MINUTE_US

_US_PER_DAY: Final = 86_400_000_000
_KEPT: Final = frozenset({"stored_day"})  # retention counts from the day of the first write


def save_counts(
    connection: Connection,
    crossings: Sequence[CrossingBlock],
    minutes: Sequence[MinuteRow],
    cells: Sequence[CellRow],
    *,
    now_us: int,
) -> None:
    """Write counts; a stored row gives way only to one with a later `as_of`, so a replay changes nothing."""
    for table, rows in (
        ("crossing_blocks", crossings),
        ("traffic_minutes", minutes),
        ("cell_minutes", cells),
    ):
        if rows:
            ordinals = {name: ordinal_of(connection, name) for name in {row.sensor_id for row in rows}}
            common = {"stored_day": now_us // _US_PER_DAY}
            connection.execute(
                insert_or_advance(connection, table, _KEPT),
                [{**_columns(row), "sensor": ordinals[row.sensor_id], **common} for row in rows],
            )


def _columns(row: CrossingBlock | MinuteRow | CellRow) -> dict[str, object]:
    return {name: getattr(row, name) for name in row.__slots__ if name != "sensor_id"}


def read_crossings(
    connection: Connection, sensor_id: str, start_us: int, end_us: int, *, line_id: str | None = None
) -> CrossingTable:
    """Return the crossings of a sensor in [start_us, end_us) by time; raises NotFound."""
    c = crossing_blocks.c
    query = select(c.epoch, c.line_id, c.minute, c.records)
    if line_id is not None:
        query = query.where(c.line_id == line_id)
    rows = _rows(connection, query, crossing_blocks, sensor_id, start_us, end_us)
    bounds_m = read_sensor(connection, sensor_id, include_archived=True).config.length_bounds_m
    return crossings_of_rows([tuple(row) for row in rows], bounds_m).between(start_us, end_us)


def read_received(connection: Connection, sensor_id: str, start_us: int, end_us: int) -> Received:
    """Return the minutes of a sensor that lie in or touch [start_us, end_us); raises NotFound."""
    c = traffic_minutes.c
    query = select(c.minute, c.frames, c.expected, c.observed_us)
    rows = _rows(connection, query, traffic_minutes, sensor_id, start_us, end_us)
    return received_of_rows([tuple(row) for row in rows])


def read_cells(connection: Connection, sensor_id: str, start_us: int, end_us: int) -> CellTable:
    """Return Edie's sums of the minutes in or touching [start_us, end_us); raises NotFound."""
    c = cell_minutes.c
    query = select(c.epoch, c.minute, c.map_version, c.as_of, c.cells)
    rows = _rows(connection, query, cell_minutes, sensor_id, start_us, end_us)
    return cells_of([CellRow(sensor_id, r.epoch, r.minute, r.map_version, r.as_of, r.cells) for r in rows])


def known_lines(connection: Connection, sensor_id: str) -> list[str]:
    """Return the lines that the sensor ever had a crossing of; raises NotFound."""
    c = crossing_blocks.c
    query = select(c.line_id).where(c.sensor == ordinal_of(connection, sensor_id)).distinct()
    return sorted(connection.scalars(query))


def _rows(  # noqa: PLR0913, PLR0917 - one condition each
    connection: Connection,
    query: Select[Any],
    table: Table,
    sensor_id: str,
    start_us: int,
    end_us: int,
) -> Sequence[Row[Any]]:
    c = table.c
    found = query.where(
        c.sensor == ordinal_of(connection, sensor_id),
        c.minute >= start_us // MINUTE_US,
        c.minute < -(-end_us // MINUTE_US),
    ).order_by(c.minute, c.epoch)
    return connection.execute(found).all()
