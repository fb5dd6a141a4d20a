"""Read the embedded log from another process than the one that writes it.

SQLite's write-ahead mode lets any number of processes read while one writes. Who reads here is told by the
writer how far the log goes; the files are found by their names, which count up.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path

from service.errors import Unavailable
from service.pipeline.segments import READ_RECORDS, not_read, open_to_read


class LogReader:
    """Follows the log of one folder, sensor by sensor."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._open: dict[Path, sqlite3.Connection] = {}
        self._used: set[Path] = set()  # since files were let go last
        self._paths: list[Path] = []  # by age
        self._at: dict[str, Path] = {}  # the file in which a sensor was read last

    def read(self, sensor_id: str, after: int, limit: int) -> list[tuple[int, bytes]]:
        """Return up to `limit` bodies of a sensor with positions above `after`, in order.

        Raises StorageError when a file is damaged, Unavailable when one cannot be read for now.
        """
        found: list[tuple[int, bytes]] = []
        path = self._at.get(sensor_id) or self._next(None)
        while path is not None:
            rows = self._read(path, sensor_id, found[-1][0] if found else after, limit - len(found))
            if rows:
                found += rows
                self._at[sensor_id] = path
            if len(found) >= limit:
                break
            path = self._next(path)
        return found

    def _read(self, path: Path, sensor_id: str, after: int, limit: int) -> list[tuple[int, bytes]]:
        try:
            if path not in self._open:
                self._open[path] = open_to_read(path)
            self._used.add(path)
            return self._open[path].execute(READ_RECORDS, (sensor_id, after, limit)).fetchall()
        except sqlite3.Error as error:
            failed = self._open.pop(path, None)
            if failed is not None:
                failed.close()
            elif not path.exists():  # dropped: nothing in it is wanted any more
                return []
            raise not_read(path, error) from error

    def _next(self, path: Path | None) -> Path | None:
        """Return the file after this one (None: the oldest), None when it is the newest."""
        later = [one for one in self._paths if path is None or one > path]
        if not later:
            try:
                self._paths = sorted(self._folder.glob("segment-*.sqlite"))
            except OSError as error:
                raise Unavailable(f"the log's folder cannot be read: {error}") from error
            later = [one for one in self._paths if path is None or one > path]
        return later[0] if later else None

    def let_go(self) -> None:
        """Close the files that were dropped, so that their room on the disk is free, and those read through.

        The newest file in which something was read stays open, and those that were read since the last call.
        """
        newest = max(self._at.values(), default=None)
        for path in list(self._open):
            dropped = not path.exists()
            if dropped or (path not in self._used and path != newest):
                self._open.pop(path).close()
            if dropped:
                self._paths = [one for one in self._paths if one != path]
                self._at = {name: at for name, at in self._at.items() if at != path}
        self._used.clear()

    def close(self) -> None:
        """Let go of all files."""
        for connection in self._open.values():
            connection.close()
        self._open.clear()
