from __future__ import annotations

from dataclasses import replace

import pytest

from service.errors import NotFound
from service.storage.database import session_scope
from service.storage.lanes import (
    list_lane_changes,
    list_lane_maps,
    newest_lane_map,
    read_lane_map,
    save_lane_changes,
    save_lane_maps,
)
from service.storage.rows import LaneChangeRow, LaneMapRow, TrackKey

NOW_US = 1_747_029_600_000_000
MAP = LaneMapRow("radar-1", 1, 1, NOW_US, 400, 30, "learned", "[]")
CHANGE = LaneChangeRow(TrackKey("radar-1", 1, 7), NOW_US, NOW_US + 900_000, 1, 2, 1.7, 60.0, 14.0, 1)


def test_maps_are_written_once_and_the_newest_is_in_force(engine, sensor):
    maps = [MAP, replace(MAP, version=2), replace(MAP, epoch=2)]
    with session_scope(engine) as connection:
        save_lane_maps(connection, maps, now_us=NOW_US)
        save_lane_maps(connection, [replace(MAP, lanes="[1]")], now_us=NOW_US)

        assert newest_lane_map(connection, sensor) == maps[2]
        assert read_lane_map(connection, sensor, 1, 1) == MAP
        first = list_lane_maps(connection, sensor, limit=2)
        rest = list_lane_maps(connection, sensor, limit=2, cursor=first.next_cursor)
        assert [*first.items, *rest.items] == maps
        with pytest.raises(NotFound):
            read_lane_map(connection, sensor, 3, 1)


def test_changes_are_written_once_and_read_by_time(engine, sensor):
    changes = [replace(CHANGE, time_us=NOW_US + k, decided_us=NOW_US + 900_000 + k) for k in range(4)]
    with session_scope(engine) as connection:
        save_lane_changes(connection, changes[::-1], now_us=NOW_US)
        save_lane_changes(connection, [replace(changes[0], x_m=9.0)], now_us=NOW_US)

        assert list(list_lane_changes(connection, sensor).items) == changes
        inside = list_lane_changes(connection, sensor, start_us=NOW_US + 1, end_us=NOW_US + 3)
        assert list(inside.items) == changes[1:3]
        first = list_lane_changes(connection, sensor, limit=3)
        assert list(list_lane_changes(connection, sensor, cursor=first.next_cursor).items) == changes[3:]


def test_a_sensor_without_lanes_has_no_map(engine, sensor):
    with session_scope(engine) as connection:
        assert newest_lane_map(connection, sensor) is None
        assert list_lane_changes(connection, sensor).items == ()
