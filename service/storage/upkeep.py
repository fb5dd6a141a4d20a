"""Keep the database small: let go of rows past their days and look after PostgreSQL's daily partitions."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

import numpy as np
from sqlalchemy import (
    Connection,
    Engine,
    Integer,
    Table,
    column,
    delete,
    exists,
    func,
    select,
    table,
    text,
    tuple_,
)

from service.storage.database import connection as reading
from service.storage.database import session_scope
from service.storage.tables import (
    acts,
    cell_minutes,
    crossing_blocks,
    events,
    lane_changes,
    lane_maps,
    track_states,
    tracks,
    traffic_minutes,
)
from service.traffic.records import CROSSING, MINUTE_US

BATCH_ROWS: Final = 2000  # of one transaction, so that a flush never waits long behind the deletion of a day
PARTITION_PREFIX: Final = "track_states_"
DEFAULT_PARTITION: Final = (
    "track_states_default"  # what no day's partition takes: clocks far off, old recordings
)

_S_PER_DAY: Final = 86_400
_US_PER_DAY: Final = _S_PER_DAY * 1_000_000
_END_US: Final = 2**62  # later than every time
_BLOCKS: Final = 200  # of crossings, read at a time
_PARTITION_LOCK: Final = 0x7761_7973_0002  # advisory lock: one process at a time makes partitions
_DAY_PARTITION: Final = re.compile(PARTITION_PREFIX + r"(\d{8})")


@dataclass(frozen=True, slots=True)
class Retention:
    """How many whole days rows stay after the day on which they were stored."""

    states_days: int = 7
    tracks_days: int = 400
    events_days: int = 400
    counts_days: int = 400
    lane_maps_days: int = 400
    audit_days: int = 400


@dataclass(frozen=True, slots=True)
class Expired:
    """What one upkeep let go of."""

    state_blocks: int = 0
    tracks: int = 0
    events: int = 0
    lane_changes: int = 0
    counts: int = 0  # minutes of crossings, of frames received and of Edie's sums
    lane_maps: int = 0
    acts: int = 0
    partitions: int = 0  # of PostgreSQL, dropped whole; their blocks are not counted


def keep_up(engine: Engine, retention: Retention, *, now_us: int) -> Expired:
    """Make the partitions that are due and delete expired rows; to be called at the start and each hour.

    Commits in small parts: an interruption leaves only work for the next time.
    """
    today = now_us // _US_PER_DAY
    oldest_states = today - retention.states_days
    partitions = 0
    if engine.dialect.name == "postgresql":
        with session_scope(engine) as connection:
            _add_partition(connection, today)
            _add_partition(connection, today + 1)
        partitions = _drop_partitions(engine, oldest_states)
    return Expired(
        state_blocks=_expire(engine, track_states, oldest_states),
        tracks=_expire(engine, tracks, today - retention.tracks_days),
        events=_expire(engine, events, today - retention.events_days),
        lane_changes=_expire(engine, lane_changes, today - retention.counts_days),
        counts=sum(
            _expire(engine, table, today - retention.counts_days)
            for table in (crossing_blocks, traffic_minutes, cell_minutes)
        ),
        lane_maps=_expire_lane_maps(engine, today - retention.lane_maps_days),
        acts=_expire_acts(engine, today - retention.audit_days),
        partitions=partitions,
    )


def partition_name(day: int) -> str:
    """Return the name of the table of PostgreSQL that holds the states of one day (since 1970)."""
    return f"{PARTITION_PREFIX}{datetime.fromtimestamp(day * _S_PER_DAY, UTC):%Y%m%d}"


def _add_partition(connection: Connection, day: int) -> None:
    """Make the partition of a day, taking over what the default partition holds of it."""
    name, start, end = partition_name(day), day * _S_PER_DAY, (day + 1) * _S_PER_DAY
    connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _PARTITION_LOCK})
    if connection.scalar(text("SELECT to_regclass(:name)"), {"name": name}) is not None:
        return
    within = f"second >= {start} AND second < {end}"
    for statement in (
        f"LOCK TABLE {DEFAULT_PARTITION} IN ACCESS EXCLUSIVE MODE",  # nobody writes there while rows move
        f"CREATE TABLE {name} (LIKE track_states INCLUDING ALL)",
        f"INSERT INTO {name} SELECT * FROM {DEFAULT_PARTITION} WHERE {within}",  # noqa: S608 - names and numbers of ours
        f"DELETE FROM {DEFAULT_PARTITION} WHERE {within}",  # noqa: S608
        f"ALTER TABLE track_states ATTACH PARTITION {name} FOR VALUES FROM ({start}) TO ({end})",
    ):
        connection.exec_driver_sql(statement)


def _drop_partitions(engine: Engine, oldest_day: int) -> int:
    """Drop the partitions of days before `oldest_day` unless an old recording was stored in one since."""
    with reading(engine) as connection:
        names = connection.scalars(
            text(
                "SELECT c.relname FROM pg_inherits i JOIN pg_class c ON c.oid = i.inhrelid "
                "WHERE i.inhparent = to_regclass('track_states') ORDER BY c.relname"
            )
        ).all()
    dropped = 0
    for name in names:
        if not _DAY_PARTITION.fullmatch(name) or name >= partition_name(oldest_day):
            continue
        with session_scope(engine) as connection:
            stored_day = column("stored_day", Integer)
            recent = select(stored_day).select_from(table(name, stored_day)).where(stored_day >= oldest_day)
            if not connection.scalar(select(exists(recent))):
                connection.exec_driver_sql(f"DROP TABLE {name}")
                dropped += 1
    return dropped


def _expire(engine: Engine, expiring: Table, oldest_day: int) -> int:
    """Delete the rows stored before `oldest_day` and return how many there were."""
    key = list(expiring.primary_key)
    batch = select(*key).where(expiring.c.stored_day < oldest_day).limit(BATCH_ROWS)
    deleted = 0
    while True:
        with session_scope(engine) as connection:
            count = connection.execute(delete(expiring).where(tuple_(*key).in_(batch))).rowcount
        deleted += count
        if count < BATCH_ROWS:
            return deleted


def _expire_acts(engine: Engine, oldest_day: int) -> int:
    """Delete the acts of the days before `oldest_day`, but the newest: numbers go on rising from it."""
    old = acts.c.time_us < oldest_day * _US_PER_DAY
    newest = select(func.max(acts.c.number)).scalar_subquery()
    batch = select(acts.c.number).where(old, acts.c.number < newest).order_by(acts.c.number).limit(BATCH_ROWS)
    deleted = 0
    while True:
        with session_scope(engine) as connection:
            count = connection.execute(delete(acts).where(acts.c.number.in_(batch))).rowcount
        deleted += count
        if count < BATCH_ROWS:
            return deleted


@dataclass(frozen=True, slots=True)
class _OldMap:
    """An expired lane map, and the minutes in which something may name it."""

    sensor: int
    epoch: int
    version: int
    first_minute: int
    last_minute: int


def _expire_lane_maps(engine: Engine, oldest_day: int) -> int:
    """Delete the maps stored before `oldest_day` that are neither in force nor named by a count or change."""
    m = lane_maps.c
    key = (m.sensor, m.epoch, m.version)
    with reading(engine) as connection:
        gone = [old for old in _old_maps(connection, oldest_day) if not _is_named(connection, old)]
    for first in range(0, len(gone), BATCH_ROWS):
        keys = [(old.sensor, old.epoch, old.version) for old in gone[first : first + BATCH_ROWS]]
        with session_scope(engine) as connection:
            for some in keys:
                connection.execute(delete(lane_maps).where(tuple_(*key) == some))
    return len(gone)


def _old_maps(connection: Connection, oldest_day: int) -> list[_OldMap]:
    """Return the maps stored before `oldest_day` but the one in force of each sensor.

    What names a map lies between the map before it (a vehicle may get its lane late) and a day after the
    next one.
    """
    m = lane_maps.c
    old = select(m.sensor).where(m.stored_day < oldest_day)
    query = select(m.sensor, m.epoch, m.version, m.time_us, m.stored_day).where(m.sensor.in_(old))
    maps = connection.execute(query.order_by(m.sensor, m.epoch, m.version)).all()
    found = []
    for before, one, after in zip([None, *maps], maps, maps[1:], strict=False):
        if after.sensor != one.sensor or one.stored_day >= oldest_day:
            continue
        same = (one.sensor, one.epoch)
        start_us = before.time_us if before is not None and (before.sensor, before.epoch) == same else 0
        end_us = after.time_us + _US_PER_DAY if (after.sensor, after.epoch) == same else _END_US
        found.append(_OldMap(*same, one.version, start_us // MINUTE_US, end_us // MINUTE_US))
    return found


def _is_named(connection: Connection, old: _OldMap) -> bool:
    """Return whether a crossing, a sum of a cell or a lane change that is stored names a map.

    They are looked through only until the first that does; a map that nothing names is not asked for again.
    """
    b, c, d = crossing_blocks.c, cell_minutes.c, lane_changes.c
    minutes = old.first_minute, old.last_minute
    times_us = old.first_minute * MINUTE_US, (old.last_minute + 1) * MINUTE_US
    sums = (c.sensor == old.sensor, c.minute.between(*minutes), c.epoch == old.epoch)
    changes = (d.sensor == old.sensor, d.time_us.between(*times_us), d.epoch == old.epoch)
    for named, where in (
        (c.map_version, sums),
        (d.map_version, changes),
    ):
        if connection.scalar(select(exists(select(named).where(*where, named == old.version)))):
            return True
    where = (b.sensor == old.sensor, b.minute.between(*minutes), b.epoch == old.epoch)
    blocks = select(b.records).where(*where).order_by(b.minute).execution_options(yield_per=_BLOCKS)
    with connection.execute(blocks) as found:
        return any(
            (np.frombuffer(row.records, CROSSING)["map_version"] == old.version).any() for row in found
        )
