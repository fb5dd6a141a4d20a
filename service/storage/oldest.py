"""Since when rows are kept: the oldest of each kind, found in the indices alone."""

from __future__ import annotations

from typing import Final

from sqlalchemy import Connection, Table, func, select

from service.storage.tables import (
    acts,
    cell_minutes,
    crossing_blocks,
    events,
    lane_changes,
    lane_maps,
    sensors,
    track_states,
    tracks,
    traffic_minutes,
)

_US_PER_S: Final = 1_000_000
_US_PER_MINUTE: Final = 60 * _US_PER_S
_US_PER_DAY: Final = 86_400 * _US_PER_S

# The column by whose index the rows of one sensor are in the order of the time they speak of, and its unit.
_TIMES: Final[tuple[tuple[Table, str, int], ...]] = (
    (track_states, "second", _US_PER_S),
    (tracks, "first_time_us", 1),
    (events, "time_us", 1),
    (crossing_blocks, "minute", _US_PER_MINUTE),
    (traffic_minutes, "minute", _US_PER_MINUTE),
    (cell_minutes, "minute", _US_PER_MINUTE),
    (lane_changes, "time_us", 1),
    (lane_maps, "time_us", 1),  # has no such index and needs none: a row a map
)
KINDS: Final = (*(table.name for table, _, _ in _TIMES), "acts")


def oldest_rows(connection: Connection) -> dict[str, int]:
    """Return since when (us) rows of each kind are kept, without the kinds of which there are none.

    Of what sensors measured this is the start of the day on which the oldest row was stored, or the time that
    the oldest row speaks of if that is later: exact for what is live, and no more than a day too early for
    recordings from before that day. Asks indices only, one look-up a sensor and kind.
    """
    found: dict[str, int] = {}
    for table, name, unit_us in _TIMES:
        day = connection.scalar(select(func.min(table.c.stored_day)))
        if day is None:
            continue
        of_sensor = select(func.min(table.c[name])).where(table.c.sensor == sensors.c.ordinal)
        times = connection.scalars(select(of_sensor.scalar_subquery()).select_from(sensors))
        first = min((time for time in times if time is not None), default=0)
        found[table.name] = max(day * _US_PER_DAY, first * unit_us)
    act_us = connection.scalar(select(acts.c.time_us).order_by(acts.c.number).limit(1))
    if act_us is not None:
        found["acts"] = act_us
    return found
