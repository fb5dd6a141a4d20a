"""One file of the embedded log: records of all sensors in the order of their positions.

SQLite in write-ahead mode with `synchronous=FULL`: one flush to the disk per transaction (3 ms where it
was measured; 18 ms with a rollback journal). A segment also notes the newest position of every sensor at
its creation, so that positions go on when the older segments are dropped.
"""

from __future__ import annotations

import sqlite3
import threading
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from service.errors import StorageError, Unavailable

PAGE_BYTES = 16384  # nine frames of 100 points, three of 300: little of a page stays empty
_CHECKPOINT_PAGES = 500  # the write-ahead file is 8 MB at most
# Of who reads: SQLite would keep 2 MB of pages for each open file. The newest file changes with every
# transaction, which voids what is kept; in an older one a record is read once.
_READ_CACHE_KB = 256
# Rows lie in the order in which they came, so that every page is filled before the next is begun; the key is
# an index beside them. (As the table's own order it would be an index of bodies, of which all but 2 kB go
# to pages that nothing else may use: such files were 1.8 to 3.7 times as large as the frames in them.)
_RECORD_TABLE = """
CREATE TABLE IF NOT EXISTS record (
    sensor TEXT NOT NULL, position INTEGER NOT NULL, body BLOB NOT NULL, UNIQUE (sensor, position)
)"""
_CARRIED_TABLE = """
CREATE TABLE IF NOT EXISTS carried (sensor TEXT PRIMARY KEY, position INTEGER NOT NULL) WITHOUT ROWID"""
READ_RECORDS = "SELECT position, body FROM record WHERE sensor = ? AND position > ? ORDER BY position LIMIT ?"
_FIRST = "SELECT min(position) FROM record WHERE sensor = ?"
_LAST = "SELECT max(position) FROM record WHERE sensor = ?"
_PURGE = """
DELETE FROM record WHERE sensor = ? AND position IN (
    SELECT position FROM record WHERE sensor = ? ORDER BY position LIMIT ?)"""
PURGED_RECORDS = 500  # of one transaction


_NO_DAMAGE = frozenset(
    {
        sqlite3.SQLITE_FULL,
        sqlite3.SQLITE_IOERR,
        sqlite3.SQLITE_BUSY,
        sqlite3.SQLITE_LOCKED,
        sqlite3.SQLITE_CANTOPEN,
        sqlite3.SQLITE_READONLY,
        sqlite3.SQLITE_PERM,
        sqlite3.SQLITE_NOMEM,
    }
)
_PRIMARY_CODE = 0xFF  # SQLite's extended result codes keep the primary one in the lowest byte


@dataclass(frozen=True, slots=True)
class Extent:
    """The positions of one sensor inside a segment, both ends included."""

    first: int
    last: int


class Segment:
    """One segment file; one thread appends until it is sealed, any thread reads.

    While it is written it is held open by two connections, with 3 MB of memory; once sealed by none.
    """

    def __init__(self, path: Path, carried: Mapping[str, int]) -> None:
        """Open the file, or create it with the newest position of every sensor so far.

        Raises StorageError when the file is damaged, Unavailable when the disk is full or does not answer.
        """
        self.path = path
        self.extents: dict[str, Extent] = {}
        self.begun_us: int | None = None  # when its first record was received, once somebody asked
        unclean = _beside(path, "-wal").exists()
        try:
            self._writer = _connect(path)
            self._reader: sqlite3.Connection | None = open_to_read(path)
            self._prepare(carried, check=unclean)
        except sqlite3.DatabaseError as error:
            self.close()
            if _code(error) in _NO_DAMAGE:  # such a file must not be set aside
                raise Unavailable(f"the log file {path.name} cannot be opened: {error}") from error
            raise StorageError(f"the log file {path.name} is damaged: {error}") from error
        self._reading = threading.Lock()

    def _prepare(self, carried: Mapping[str, int], *, check: bool) -> None:
        if check:
            verdict = self._writer.execute("PRAGMA quick_check(1)").fetchone()[0]
            if verdict != "ok":
                raise sqlite3.DatabaseError(verdict)
        with self._writer:
            self._writer.execute("BEGIN IMMEDIATE")
            self._writer.execute(_RECORD_TABLE)
            self._writer.execute(_CARRIED_TABLE)
            self._writer.executemany("INSERT OR IGNORE INTO carried VALUES (?, ?)", carried.items())
        self.carried: dict[str, int] = dict(self._writer.execute("SELECT sensor, position FROM carried"))
        self.extents = dict(_extents(self._writer))

    def append(self, rows: Iterable[tuple[str, int, bytes]]) -> None:
        """Write (sensor, position, body) in one transaction; they are durable when this returns."""
        with self._writer:
            self._writer.execute("BEGIN IMMEDIATE")
            self._writer.executemany("INSERT INTO record VALUES (?, ?, ?)", rows)

    def extend(self, rows: Iterable[tuple[str, int, bytes]]) -> None:
        """Take in that rows were appended."""
        ends: dict[str, list[int]] = defaultdict(list)
        for sensor_id, position, _ in rows:
            ends[sensor_id].append(position)
        for sensor_id, positions in ends.items():
            known = self.extents.get(sensor_id)
            self.extents[sensor_id] = Extent(positions[0] if known is None else known.first, positions[-1])

    def read(self, sensor_id: str, after: int, limit: int) -> list[tuple[int, bytes]]:
        """Return up to `limit` bodies of a sensor with positions above `after`, in order."""
        with self._opened() as connection:
            return connection.execute(READ_RECORDS, (sensor_id, after, limit)).fetchall()

    def purge(self, sensor_id: str) -> None:
        """Overwrite a sensor's records with zeros, in small parts so that appending never waits long."""
        with closing(_connect(self.path)) as connection:
            connection.execute("PRAGMA secure_delete = ON")
            while connection.execute(_PURGE, (sensor_id, sensor_id, PURGED_RECORDS)).rowcount > 0:
                pass
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").close()

    def first_body(self) -> bytes | None:
        """Return the body of the first record, None when there is none."""
        with self._opened() as connection:
            row = connection.execute("SELECT body FROM record LIMIT 1").fetchone()
        return None if row is None else bytes(row[0])

    def size_bytes(self) -> int:
        """Return what the file and its write-ahead file take on the disk."""
        size = 0
        for path in (self.path, _beside(self.path, "-wal")):
            with suppress(FileNotFoundError):  # who closes a file last removes the other, at any time
                size += path.stat().st_size
        return size

    def seal(self) -> None:
        """Move the write-ahead file into the file, of which no more is written, and let go of both.

        An active file keeps up to 8 MB of it, to write the same pages again and again. Whoever reads a
        sealed file opens it for that: a log of many files would else take memory and descriptors for each.
        """
        with self._reading:  # a reader would make it wait
            try:
                self._writer.execute("PRAGMA wal_checkpoint(TRUNCATE)").close()
            finally:
                self.close()

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        """Yield a connection for reading, which nobody else uses meanwhile."""
        with self._reading:
            if self._reader is not None:
                yield self._reader
                return
            with closing(open_to_read(self.path)) as connection:
                yield connection

    def close(self) -> None:
        """Close the file; the write-ahead file goes into it."""
        for name in ("_reader", "_writer"):
            connection: sqlite3.Connection | None = getattr(self, name, None)
            if connection is not None:
                connection.close()
        self._reader = None

    def delete(self) -> None:
        """Close the file and remove it."""
        with self._reading:
            self.close()
        for path in (self.path, _beside(self.path, "-wal"), _beside(self.path, "-shm")):
            path.unlink(missing_ok=True)


def set_aside(path: Path) -> None:
    """Rename a damaged segment so that it is kept for study, and no longer read."""
    for suffix in ("", "-wal", "-shm"):
        part = _beside(path, suffix)
        if part.exists():
            part.rename(_beside(path, f".damaged{suffix}"))


def _beside(path: Path, suffix: str) -> Path:
    return path.with_name(path.name + suffix)


def _code(error: sqlite3.Error) -> int | None:
    """Return SQLite's own code of an error, None for one of Python's module."""
    code: int | None = getattr(error, "sqlite_errorcode", None)
    return None if code is None else code & _PRIMARY_CODE


def open_to_read(path: Path) -> sqlite3.Connection:
    """Return a connection that reads a segment file and takes little memory; raises sqlite3.Error."""
    address = f"{path.absolute().as_uri()}?mode=rw"  # an empty file is never made
    connection = sqlite3.connect(address, uri=True, isolation_level=None, check_same_thread=False)
    for pragma in ("query_only = ON", f"cache_size = -{_READ_CACHE_KB}"):
        connection.execute(f"PRAGMA {pragma}").close()
    return connection


def _connect(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    for pragma in (
        f"page_size = {PAGE_BYTES}",
        "journal_mode = WAL",
        "synchronous = FULL",
        f"wal_autocheckpoint = {_CHECKPOINT_PAGES}",
    ):
        connection.execute(f"PRAGMA {pragma}").close()
    return connection


def _extents(connection: sqlite3.Connection) -> Iterable[tuple[str, Extent]]:
    """Yield each sensor's positions by hopping through the key, without reading the records."""
    sensor_id = ""
    while True:
        row = connection.execute("SELECT min(sensor) FROM record WHERE sensor > ?", (sensor_id,)).fetchone()
        if row[0] is None:
            return
        sensor_id = row[0]
        first, last = (connection.execute(end, (sensor_id,)).fetchone()[0] for end in (_FIRST, _LAST))
        yield sensor_id, Extent(first, last)
