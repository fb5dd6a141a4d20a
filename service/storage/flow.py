"""Read traffic measures of a window: rows of intervals, of cells and movements, and what is behind them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from sqlalchemy import Connection, Engine, func, select

from service.errors import NotFound
from service.formats.local_days import Interval, interval_edges_us
from service.storage.counts import read_cells, read_crossings, read_received
from service.storage.database import connection as reading
from service.storage.page import Page, check_limit, cut, read_cursor
from service.storage.sites import ordinal_of, read_sensor
from service.storage.tables import crossing_blocks, sites
from service.tracking.model import I64
from service.traffic.count_intervals import Confidence
from service.traffic.edie import EdieTable, edie_table
from service.traffic.flow import CrossingTable, FlowTable, Group, covered, flow_table
from service.traffic.flow_fields import RowName, groups_of
from service.traffic.movements import LONGEST_US, Movement, movements
from service.traffic.records import MINUTE_US

STREAM_MINUTES: Final = 60  # of crossings in one read of a stream


@dataclass(frozen=True, slots=True)
class FlowQuery:
    """Which measures: of a sensor in intervals of a window, told apart by lane, direction, length class."""

    sensor_id: str
    start_us: int
    end_us: int
    interval: Interval = "15min"
    time_zone: str | None = None  # None: the site's
    line_id: str | None = None
    by: frozenset[str] = frozenset({"lane", "direction"})


@dataclass(frozen=True, slots=True)
class CrossingQuery:
    """Which crossings: of a sensor in [start_us, end_us), of one line or all."""

    sensor_id: str
    start_us: int
    end_us: int
    line_id: str | None = None


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a flow row was computed from, and the row computed again."""

    flow: FlowTable
    crossings: CrossingTable


def zone_of(connection: Connection, sensor_id: str) -> str:
    """Return the time zone of the sensor's site, UTC without one; raises NotFound."""
    site_id = read_sensor(connection, sensor_id, include_archived=True).site_id
    zone = connection.scalar(select(sites.c.time_zone).where(sites.c.site_id == site_id))
    return "UTC" if zone is None else zone


def edges_of(connection: Connection, query: FlowQuery) -> I64:
    """Return the edges of the query's intervals; raises NotFound, InvalidInput."""
    zone = query.time_zone or zone_of(connection, query.sensor_id)
    return interval_edges_us(query.start_us, query.end_us, query.interval, zone)


def read_flow(connection: Connection, query: FlowQuery) -> FlowTable:
    """Return the measures of each interval in which anything was received; raises NotFound, InvalidInput."""
    edges = edges_of(connection, query)
    window = (query.sensor_id, int(edges[0]), int(edges[-1]))
    crossings = read_crossings(connection, *window, line_id=query.line_id)
    config = read_sensor(connection, query.sensor_id, include_archived=True).config
    lines = [query.line_id] if query.line_id else [line.line_id for line in config.count_lines]
    groups = groups_of(crossings, lines, (), query.by)
    confidence = Confidence(mount_height_m=config.mount_height_m)
    return flow_table(crossings, read_received(connection, *window), edges, groups, confidence)


def read_edie(connection: Connection, query: FlowQuery) -> EdieTable:
    """Return Edie's measures of each cell and interval; raises NotFound, InvalidInput."""
    edges = edges_of(connection, query)
    window = (query.sensor_id, int(edges[0]), int(edges[-1]))
    return edie_table(read_cells(connection, *window), read_received(connection, *window), edges)


def read_coverage(connection: Connection, query: FlowQuery) -> list[tuple[int, int, float, float]]:
    """Return start, end, coverage and observed share of every interval, also of those without input."""
    edges = edges_of(connection, query)
    received = read_received(connection, query.sensor_id, int(edges[0]), int(edges[-1]))
    columns = (edges[:-1], edges[1:], *covered(received, edges))
    return [tuple(row) for row in zip(*(column.tolist() for column in columns), strict=True)]


def read_movements(connection: Connection, query: FlowQuery) -> list[Movement]:
    """Return the turning movements of each interval; raises NotFound, InvalidInput."""
    edges = edges_of(connection, query)
    first_us, last_us = max(int(edges[0]) - LONGEST_US, 0), int(edges[-1]) + LONGEST_US
    return movements(read_crossings(connection, query.sensor_id, first_us, last_us), edges)


def read_evidence(connection: Connection, sensor_id: str, row: RowName) -> Evidence:
    """Return a flow row and the crossings behind it; raises NotFound where nothing was received."""
    group = row.group
    received = read_received(connection, sensor_id, row.start_us, row.end_us)
    crossings = read_crossings(connection, sensor_id, row.start_us, row.end_us, line_id=group.line_id)
    edges = np.array([row.start_us, row.end_us], np.int64)
    config = read_sensor(connection, sensor_id, include_archived=True).config
    confidence = Confidence(mount_height_m=config.mount_height_m)
    flow = flow_table(crossings, received, edges, [group], confidence)
    if not len(flow.n):
        raise NotFound(f"{sensor_id} received nothing in the interval of this row")
    return Evidence(flow, of_group(crossings, group))


def of_group(crossings: CrossingTable, group: Group) -> CrossingTable:
    """Return the crossings of one group."""
    return crossings.take(group.holds(crossings))


def list_crossings(
    engine: Engine, query: CrossingQuery, *, cursor: str | None = None, limit: int = 1000
) -> Page[tuple[int, CrossingTable]]:
    """Return crossings by time, each as its place in a table; raises NotFound, InvalidInput."""
    check_limit(limit)
    after = (-1, 0, 0) if cursor is None else read_cursor(cursor, int, int, int)
    found: list[tuple[int, CrossingTable]] = []
    start_us = max(query.start_us, int(after[0]))
    part = CrossingQuery(query.sensor_id, start_us, query.end_us, query.line_id)
    for table in stream_crossings(engine, part):
        keys = zip(table.time_us.tolist(), table.epoch.tolist(), table.number.tolist(), strict=True)
        found += [(i, table) for i, key in enumerate(keys) if key > after]
        if len(found) > limit:
            break
    return cut(found, limit, _crossing_key)


def _crossing_key(item: tuple[int, CrossingTable]) -> tuple[str | int, ...]:
    i, table = item
    return int(table.time_us[i]), int(table.epoch[i]), int(table.number[i])


def stream_crossings(engine: Engine, query: CrossingQuery) -> Iterator[CrossingTable]:
    """Yield the crossings of the query by time, an hour at a time; raises NotFound at once.

    Takes the engine for the reason given at `tracks.stream_tracks`.
    """
    with reading(engine) as connection:
        ordinal = ordinal_of(connection, query.sensor_id)
    return _stream(engine, ordinal, query)


def _stream(engine: Engine, ordinal: int, query: CrossingQuery) -> Iterator[CrossingTable]:
    minute, end = query.start_us // MINUTE_US, -(-query.end_us // MINUTE_US)
    c = crossing_blocks.c
    while minute < end:
        with reading(engine) as connection:
            first = connection.scalar(
                select(func.min(c.minute)).where(c.sensor == ordinal, c.minute >= minute, c.minute < end)
            )
            if first is None:
                return
            minute = min(first + STREAM_MINUTES, end)
            window = (max(query.start_us, first * MINUTE_US), min(query.end_us, minute * MINUTE_US))
            table = read_crossings(connection, query.sensor_id, *window, line_id=query.line_id)
        if len(table):
            yield table
