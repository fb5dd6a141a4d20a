"""Remove for good what a sensor recorded; its id stays taken."""

from __future__ import annotations

from typing import Final

from sqlalchemy import Engine, Table, delete, select, tuple_

from service.storage.database import is_postgresql, session_scope
from service.storage.tables import metadata

BATCH_ROWS: Final = 2000  # of one transaction, so that a flush never waits long behind it


def tables_of_sensors() -> list[Table]:
    """Return every table whose rows belong to a sensor by its ordinal, those that others refer to last."""
    return [table for table in reversed(metadata.sorted_tables) if "sensor" in table.c]


def purge_sensor(engine: Engine, ordinal: int) -> dict[str, int]:
    """Delete every row of a sensor, and return how many there were in each table.

    Commits in small parts; again has no effect, so an interruption leaves only work for the next time.
    On SQLite the freed pages are overwritten with zeros.
    """
    return {table.name: _purge(engine, table, ordinal) for table in tables_of_sensors()}


def _purge(engine: Engine, table: Table, ordinal: int) -> int:
    key = list(table.primary_key)
    batch = select(*key).where(table.c.sensor == ordinal).limit(BATCH_ROWS)
    deleted = 0
    while True:
        with session_scope(engine) as connection:
            if not is_postgresql(connection):
                connection.exec_driver_sql("PRAGMA secure_delete = ON")
            count = connection.execute(delete(table).where(tuple_(*key).in_(batch))).rowcount
        deleted += count
        if count < BATCH_ROWS:
            return deleted
