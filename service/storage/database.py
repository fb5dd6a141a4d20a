"""Open the database and hand out its transactions: the only module that commits.

SQLite (embedded): one file in write-ahead mode, one writer at a time, readers never wait. PostgreSQL:
psycopg.
"""

from __future__ import annotations

import functools
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np
from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, DataError, NoSuchModuleError, OperationalError
from sqlalchemy.pool import ConnectionPoolEntry

from service.errors import InvalidInput, StorageError, Unavailable
from service.storage.tables import metadata

PAGE_BYTES: Final = 8192  # holds about 18 blocks of 20 samples; larger pages only make each flush write more
BUSY_TIMEOUT_S: Final = (
    15.0  # longest wait for another writer: above the slowest flush, below a client's patience
)
JOURNAL_LIMIT_BYTES: Final = (
    64 * 2**20
)  # the write-ahead file shrinks to this after a long reader held it open
POOL_SIZE: Final = 10
POOL_OVERFLOW: Final = 40  # the API's thread pool, each thread with one connection at most

_BUSY_CODES: Final = frozenset(
    {
        sqlite3.SQLITE_BUSY,
        sqlite3.SQLITE_LOCKED,
        sqlite3.SQLITE_FULL,
        sqlite3.SQLITE_IOERR,
        sqlite3.SQLITE_CANTOPEN,
    }
)
_NUMPY_SCALARS: Final = tuple(
    kind for kind in np.sctypeDict.values() if issubclass(kind, np.integer | np.floating | np.bool_)
)
_PRIMARY_CODE: Final = 0xFF  # SQLite's extended result codes keep the primary one in the lowest byte
_WRITING: Final = "wayside_writing"  # execution options of our transactions
_UNCHECKED: Final = "wayside_unchecked"


def open_database(url: str) -> Engine:
    """Return the engine of `sqlite:///path` or `postgresql://...`; the folder of a SQLite file is made.

    Raises StorageError when the address cannot be used. Makes no tables: `migrate.upgrade` does.
    """
    try:
        address = make_url(url)
        if address.get_backend_name() == "sqlite":
            return _open_sqlite(address)
        if address.get_backend_name() == "postgresql":
            return _open_postgresql(address)
    except (ArgumentError, NoSuchModuleError, ModuleNotFoundError, OSError) as error:
        raise StorageError(f"cannot open the database: {error}") from error
    raise StorageError(f"want a database address of sqlite or postgresql, got {address.get_backend_name()!r}")


@contextmanager
def session_scope(engine: Engine, *, enforce_references: bool = True) -> Iterator[Connection]:
    """Yield a connection inside one writing transaction: committed at the end, rolled back on an error.

    Only a migration does without `enforce_references`: SQLite rebuilds a table to change it.
    Raises Unavailable when the database is locked, full or gone, and InvalidInput for a value it cannot hold.
    """
    options = {_WRITING: True, _UNCHECKED: not enforce_references}
    with _translated(), engine.connect().execution_options(**options) as connection, connection.begin():
        yield connection


@contextmanager
def connection(engine: Engine) -> Iterator[Connection]:
    """Yield a connection that reads one consistent state of the database; what it writes is rolled back."""
    with _translated(), engine.connect() as reader:
        if is_postgresql(reader):
            reader.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)
        yield reader


def file_bytes(engine: Engine) -> int | None:
    """Return what a SQLite database and its write-ahead file take on the disk; None for another database."""
    if engine.dialect.name != "sqlite" or engine.url.database is None:
        return None
    paths = (Path(engine.url.database), Path(f"{engine.url.database}-wal"))
    return sum(path.stat().st_size for path in paths if path.exists())


def is_postgresql(connection: Connection) -> bool:
    """Return whether the connection speaks to PostgreSQL (else: SQLite)."""
    return connection.dialect.name == "postgresql"


def insert_or_ignore(connection: Connection, table: str) -> sqlite.Insert | postgresql.Insert:
    """Return an insert into the named table that leaves a row which is there already as it is."""
    return _insert(connection.dialect.name, table).on_conflict_do_nothing()


def insert_or_advance(
    connection: Connection, table: str, keep: frozenset[str]
) -> sqlite.Insert | postgresql.Insert:
    """Return an insert into the named table that replaces a row of the same primary key and a lower `as_of`.

    The columns of `keep` stay as they were first written.
    """
    return _advance(connection.dialect.name, table, keep)


@functools.cache
def _advance(dialect: str, table: str, keep: frozenset[str]) -> sqlite.Insert | postgresql.Insert:
    # Kept, because building it takes longer than writing the rows of a second.
    insert = _insert(dialect, table)
    target = metadata.tables[table]
    key = [column.name for column in target.primary_key]
    replaced = {c.name: insert.excluded[c.name] for c in target.columns if c.name not in keep.union(key)}
    newer = insert.excluded.as_of > target.c.as_of
    return insert.on_conflict_do_update(index_elements=key, set_=replaced, where=newer)


def _insert(dialect: str, table: str) -> sqlite.Insert | postgresql.Insert:
    target = metadata.tables[table]
    return postgresql.insert(target) if dialect == "postgresql" else sqlite.insert(target)


def _open_sqlite(address: URL) -> Engine:
    if not address.database or address.database == ":memory:":
        raise StorageError("want a database file, got one in memory: each connection would see its own")
    Path(address.database).parent.mkdir(parents=True, exist_ok=True)
    for scalar in _NUMPY_SCALARS:  # sqlite3 would take the bytes of an np.int64 for a BLOB, without a word
        sqlite3.register_adapter(scalar, _as_python)
    engine = create_engine(
        address.set(drivername="sqlite+pysqlite"),
        connect_args={"timeout": BUSY_TIMEOUT_S},
        pool_size=POOL_SIZE,
        max_overflow=POOL_OVERFLOW,
        pool_use_lifo=True,  # each that is used fills 2 MB with pages: the same one again, not all in turn
        hide_parameters=True,  # in errors, which end up in logs
    )
    event.listen(engine, "connect", _prepare_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _as_python(number: np.generic) -> int | float | bool:
    value: int | float | bool = number.item()
    return value


def _open_postgresql(address: URL) -> Engine:
    return create_engine(
        address.set(drivername="postgresql+psycopg"),
        pool_size=POOL_SIZE,
        max_overflow=POOL_OVERFLOW,
        pool_pre_ping=True,
        hide_parameters=True,
    )


def _prepare_sqlite(driver: sqlite3.Connection, _: ConnectionPoolEntry) -> None:
    driver.isolation_level = None  # the driver begins no transaction of its own; _begin_sqlite does
    for pragma in (
        f"page_size = {PAGE_BYTES}",  # before the first page is written; later without effect
        "journal_mode = WAL",
        # Each commit is on the disk: a revoked key stays so, and the log may drop what a snapshot covers.
        "synchronous = FULL",
        f"journal_size_limit = {JOURNAL_LIMIT_BYTES}",
    ):
        driver.execute(f"PRAGMA {pragma}")


def _begin_sqlite(connection: Connection) -> None:
    options = connection.get_execution_options()
    # Has no effect inside a transaction, so it is said before each.
    connection.exec_driver_sql(f"PRAGMA foreign_keys = {'OFF' if options.get(_UNCHECKED) else 'ON'}")
    # A transaction that reads first and then writes cannot wait for another writer (its view is old by then),
    # so one that will write takes its turn at once.
    connection.exec_driver_sql("BEGIN IMMEDIATE" if options.get(_WRITING) else "BEGIN")


@contextmanager
def _translated() -> Iterator[None]:
    try:
        yield
    except DataError as error:
        raise InvalidInput(f"a value does not fit the database: {error.orig}") from error
    except OperationalError as error:
        cause = error.orig
        if isinstance(cause, sqlite3.Error) and (cause.sqlite_errorcode & _PRIMARY_CODE) not in _BUSY_CODES:
            raise
        raise Unavailable(f"the database cannot be used now: {cause}") from error
