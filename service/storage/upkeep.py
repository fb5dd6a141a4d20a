"""Keep the database small: let go of rows past their days and look after PostgreSQL's daily partitions."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

from sqlalchemy import (
    Connection,
    Engine,
    Integer,
    Table,
    column,
    delete,
    exists,
    select,
    table,
    text,
    tuple_,
)

from service.storage.database import connection as reading
from service.storage.database import session_scope
from service.storage.tables import (
    cell_minutes,
    crossing_blocks,
    events,
    lane_changes,
    track_states,
    tracks,
    traffic_minutes,
)

BATCH_ROWS: Final = 2000  # of one transaction, so that a flush never waits long behind the deletion of a day
PARTITION_PREFIX: Final = "track_states_"
DEFAULT_PARTITION: Final = (
    "track_states_default"  # what no day's partition takes: clocks far off, old recordings
)

_S_PER_DAY: Final = 86_400
_US_PER_DAY: Final = _S_PER_DAY * 1_000_000
_PARTITION_LOCK: Final = 0x7761_7973_0002  # advisory lock: one process at a time makes partitions
_DAY_PARTITION: Final = re.compile(PARTITION_PREFIX + r"(\d{8})")


@dataclass(frozen=True, slots=True)
class Retention:
    """How many whole days rows stay after the day on which they were stored."""

    states_days: int = 7
    tracks_days: int = 400
    events_days: int = 400
    counts_days: int = 400


@dataclass(frozen=True, slots=True)
class Expired:
    """What one upkeep let go of."""

    state_blocks: int = 0
    tracks: int = 0
    events: int = 0
    lane_changes: int = 0
    counts: int = 0  # minutes of crossings, of frames received and of Edie's sums
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
