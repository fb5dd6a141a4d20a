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

from service.errors import StorageError, Unavailable, WaysideError

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
# A place of the disk that cannot be read stays so: who waited for it would hold back every file behind.
_LOST = frozenset({sqlite3.SQLITE_IOERR_READ, sqlite3.SQLITE_IOERR_CORRUPTFS})


@dataclass(frozen=True, slots=True)
class Extent:
    """The positions of one sensor inside a segment, both ends included."""

    first: int
    last: int


class Segment:
    """One segment file; one thread appends until it is sealed, any thread reads.

    While it is written it is held open by two connections, with 3 MB of memory; once sealed by none, but for
    one while sensors are read in the midst of it.
    """

    def __init__(self, path: Path, carried: Mapping[str, int]) -> None:
        """Open the file, or create it with the newest position of every sensor so far.

        Raises StorageError when the file is damaged, Unavailable when the disk is full or does not answer.
        """
        self.path = path
        self.extents: dict[str, Extent] = {}
        self.begun_us: int | None = None  # when its first record was received, once somebody asked
        self.followers: set[str] = set()  # sensors that were read here last and have more here
        self._reading = threading.Lock()  # over the reader, and over what follows
        self._sealed = self._closed = False
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
        """Return up to `limit` bodies of a sensor with positions above `after`, in order.

        A sealed file stays open while there is more of the sensor, until `leave`. Raises StorageError when
        the file is damaged or closed, Unavailable when it cannot be read for now.
        """
        with self._opened() as connection:
            rows = connection.execute(READ_RECORDS, (sensor_id, after, limit)).fetchall()
            extent = self.extents.get(sensor_id)
            if rows and extent is not None and rows[-1][0] < extent.last:
                self.followers.add(sensor_id)
            else:
                self.followers.discard(sensor_id)
        return rows

    def leave(self, sensor_id: str) -> None:
        """Take in that a sensor is read elsewhere."""
        with self._reading:
            self.followers.discard(sensor_id)
            self._rest()

    def purge(self, sensor_id: str) -> None:
        """Overwrite a sensor's records with zeros, in small parts so that appending never waits long."""
        self._require_open()
        with closing(_connect(self.path)) as connection:
            connection.execute("PRAGMA secure_delete = ON")
            while connection.execute(_PURGE, (sensor_id, sensor_id, PURGED_RECORDS)).rowcount > 0:
                pass
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").close()

    def first_body(self) -> bytes | None:
        """Return the body of the first record, None when there is none; raises as `read` does."""
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
                self._sealed = True
                self._let_go()

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        """Yield a connection for reading, which nobody else uses meanwhile; raises as `read` does."""
        with self._reading:
            self._require_open()
            try:
                if self._reader is None:
                    self._reader = open_to_read(self.path)
                yield self._reader
            except sqlite3.Error as error:
                self.followers.clear()
                raise not_read(self.path, error) from error
            finally:
                self._rest()

    def _require_open(self) -> None:
        """Raise StorageError when the log was closed: its folder may be another process's by now."""
        if self._closed:
            raise StorageError(f"the log file {self.path.name} is closed")

    def _rest(self) -> None:
        """Let go of a sealed file that is not read any more."""
        if self._sealed and not self.followers:
            self._let_go()

    def close(self) -> None:
        """Close the file for good; the write-ahead file goes into it."""
        with self._reading:
            self._closed = True
            self._let_go()

    def _let_go(self) -> None:
        for name in ("_reader", "_writer"):
            connection: sqlite3.Connection | None = getattr(self, name, None)
            if connection is not None:
                connection.close()
        self._reader = None

    def delete(self) -> None:
        """Close the file and remove it."""
        self.close()
        for path in (self.path, _beside(self.path, "-wal"), _beside(self.path, "-shm")):
            path.unlink(missing_ok=True)


def next_path(path: Path) -> Path:
    """Return the path of the segment after this one."""
    return path.with_name(f"segment-{int(path.name[8:16]) + 1:08d}.sqlite")


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


def not_read(path: Path, error: sqlite3.Error) -> WaysideError:
    """Return what to raise when a segment file was not read: Unavailable when that may pass."""
    told = f"the log file {path.name} cannot be read: {error}"
    lost = getattr(error, "sqlite_errorcode", None) in _LOST
    return StorageError(told) if lost or _code(error) not in _NO_DAMAGE else Unavailable(told)


def open_to_read(path: Path) -> sqlite3.Connection:
    """Return a connection that reads a segment file and takes little memory; raises sqlite3.Error."""
    address = f"{path.absolute().as_uri()}?mode=rw"  # an empty file is never made
    return _set_up(
        sqlite3.connect(address, uri=True, isolation_level=None, check_same_thread=False),
        "query_only = ON",
        f"cache_size = -{_READ_CACHE_KB}",
    )


def _connect(path: Path) -> sqlite3.Connection:
    return _set_up(
        sqlite3.connect(path, isolation_level=None, check_same_thread=False),
        f"page_size = {PAGE_BYTES}",
        "journal_mode = WAL",
        "synchronous = FULL",
        f"wal_autocheckpoint = {_CHECKPOINT_PAGES}",
    )


def _set_up(connection: sqlite3.Connection, *pragmas: str) -> sqlite3.Connection:
    """Return the connection with its settings made; it is closed when the file does not allow one."""
    try:
        for pragma in pragmas:
            connection.execute(f"PRAGMA {pragma}").close()
    except BaseException:
        connection.close()
        raise
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
