"""Lane maps and lane changes: written again without effect, read by version and by time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from sqlalchemy import Connection, Row, select, tuple_

from service.errors import NotFound
from service.storage.database import insert_or_ignore
from service.storage.page import Page, check_limit, cut, read_cursor
from service.storage.rows import LaneChangeRow, LaneMapRow, TrackKey
from service.storage.sites import ordinal_of
from service.storage.tables import lane_changes, lane_maps

_US_PER_DAY: Final = 86_400_000_000
_BY_TIME: Final = (
    lane_changes.c.time_us,
    lane_changes.c.epoch,
    lane_changes.c.number,
    lane_changes.c.decided_us,
)
_BY_VERSION: Final = (lane_maps.c.epoch, lane_maps.c.version)


def save_lane_maps(connection: Connection, rows: Sequence[LaneMapRow], *, now_us: int) -> None:
    """Write lane maps; one that is stored already stays as it is."""
    if rows:
        connection.execute(
            insert_or_ignore(connection, "lane_maps"),
            [
                {
                    **_columns(row),
                    "sensor": ordinal_of(connection, row.sensor_id),
                    "stored_day": now_us // _US_PER_DAY,
                }
                for row in rows
            ],
        )


def _columns(row: LaneMapRow) -> dict[str, object]:
    return {name: getattr(row, name) for name in row.__slots__ if name != "sensor_id"}


def save_lane_changes(connection: Connection, rows: Sequence[LaneChangeRow], *, now_us: int) -> None:
    """Write lane changes; one that is stored already stays as it is."""
    if not rows:
        return
    names = ("decided_us", "time_us", "from_lane", "to_lane", "x_m", "y_m", "speed_mps", "map_version")
    connection.execute(
        insert_or_ignore(connection, "lane_changes"),
        [
            {
                "sensor": ordinal_of(connection, row.key.sensor_id),
                "epoch": row.key.epoch,
                "number": row.key.number,
                "stored_day": now_us // _US_PER_DAY,
                **{name: getattr(row, name) for name in names},
            }
            for row in rows
        ],
    )


def newest_lane_map(connection: Connection, sensor_id: str) -> LaneMapRow | None:
    """Return the map in force, None while nothing is known of the lanes; raises NotFound for no sensor."""
    statement = (
        select(lane_maps)
        .where(lane_maps.c.sensor == ordinal_of(connection, sensor_id))
        .order_by(lane_maps.c.epoch.desc(), lane_maps.c.version.desc())
        .limit(1)
    )
    found = connection.execute(statement).one_or_none()
    return None if found is None else _map(sensor_id, found)


def read_lane_map(connection: Connection, sensor_id: str, epoch: int, version: int) -> LaneMapRow:
    """Return one map; raises NotFound."""
    statement = select(lane_maps).where(
        lane_maps.c.sensor == ordinal_of(connection, sensor_id),
        lane_maps.c.epoch == epoch,
        lane_maps.c.version == version,
    )
    found = connection.execute(statement).one_or_none()
    if found is None:
        raise NotFound(f"{sensor_id} has no lane map {epoch}-{version}")
    return _map(sensor_id, found)


def list_lane_maps(
    connection: Connection, sensor_id: str, *, cursor: str | None = None, limit: int = 100
) -> Page[LaneMapRow]:
    """Return the maps of a sensor, oldest first; raises NotFound."""
    statement = (
        select(lane_maps)
        .where(lane_maps.c.sensor == ordinal_of(connection, sensor_id))
        .order_by(*_BY_VERSION)
        .limit(check_limit(limit) + 1)
    )
    if cursor is not None:
        statement = statement.where(tuple_(*_BY_VERSION) > read_cursor(cursor, int, int))
    found = [_map(sensor_id, row) for row in connection.execute(statement)]
    return cut(found, limit, lambda row: (row.epoch, row.version))


def list_lane_changes(  # noqa: PLR0913 - one filter each
    connection: Connection,
    sensor_id: str,
    *,
    start_us: int | None = None,
    end_us: int | None = None,
    cursor: str | None = None,
    limit: int = 100,
) -> Page[LaneChangeRow]:
    """Return the lane changes of a sensor in [start_us, end_us) by time; raises NotFound."""
    statement = (
        select(lane_changes)
        .where(lane_changes.c.sensor == ordinal_of(connection, sensor_id))
        .order_by(*_BY_TIME)
        .limit(check_limit(limit) + 1)
    )
    if start_us is not None:
        statement = statement.where(lane_changes.c.time_us >= start_us)
    if end_us is not None:
        statement = statement.where(lane_changes.c.time_us < end_us)
    if cursor is not None:
        statement = statement.where(tuple_(*_BY_TIME) > read_cursor(cursor, int, int, int, int))
    found = [_change(sensor_id, row) for row in connection.execute(statement)]
    return cut(found, limit, lambda row: (row.time_us, row.key.epoch, row.key.number, row.decided_us))


def _map(sensor_id: str, r: Row[Any]) -> LaneMapRow:
    return LaneMapRow(sensor_id, r.epoch, r.version, r.time_us, r.frame, r.vehicles, r.source, r.lanes)


def _change(sensor_id: str, r: Row[Any]) -> LaneChangeRow:
    return LaneChangeRow(
        key=TrackKey(sensor_id, r.epoch, r.number),
        time_us=r.time_us,
        decided_us=r.decided_us,
        from_lane=r.from_lane,
        to_lane=r.to_lane,
        x_m=r.x_m,
        y_m=r.y_m,
        speed_mps=r.speed_mps,
        map_version=r.map_version,
    )
