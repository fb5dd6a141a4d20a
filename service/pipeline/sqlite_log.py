"""The embedded log: every sensor's records in SQLite files of one folder, durable before the caller goes on.

One writer thread takes all that waits into one transaction (group commit). Files rotate by size; the
oldest is dropped when the whole log is too large and the host has released all of its records, or has given
up the sensors of the others; else appending is refused: nothing is dropped silently.
"""

from __future__ import annotations

import asyncio
import fcntl
import os
import shutil
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import structlog

from service.errors import InvalidFrame, StorageError, Unavailable, WaysideError
from service.pipeline.codec import encode_record, record_time_us
from service.pipeline.promises import Promise, tell
from service.pipeline.records import Record
from service.pipeline.segments import Extent, Segment, next_path, set_aside
from service.pipeline.sieve import Sieve

log = structlog.get_logger(__name__)

_ROOM_CHECK_S = 1.0  # how often the size of the log and the free space are looked at
_SIZE_CHECKS, _GROWTH_BYTES = 256, 4096  # looks at the size of a file while it fills; growth beside a record
_LEAST_SEGMENTS = 8  # of a full log, so that dropping the oldest frees a small part of it


@dataclass(frozen=True, slots=True)
class LogLimits:
    """How large the log may grow."""

    total_bytes: int = 2 * 2**30
    segment_bytes: int = 256 * 2**20
    pending_records: int = 20_000  # waiting for the disk; more are refused
    free_share: float = 0.05  # of the disk; below it appending is refused
    retry_after_s: float = 5.0  # what a refused caller is told


def share_of_log(limits: LogLimits) -> int:
    """Return the bytes that one file may take, or one sensor that is not tracked."""
    return limits.total_bytes // _LEAST_SEGMENTS


@dataclass(frozen=True, slots=True)
class _Pending:
    sensor_id: str
    records: Sequence[Record]
    done: Future[list[int]] | Promise


class SqliteLog:
    """A FrameLog in SQLite files; see the module."""

    def __init__(
        self,
        folder: Path,
        limits: LogLimits = LogLimits(),
        on_durable: Callable[[dict[str, int]], None] | None = None,
        given_up: Callable[[str], bool] = lambda _: False,
    ) -> None:
        """Open the folder's log, or make one; `on_durable` hears of each commit.

        `on_durable` is called with the newest position of each sensor in the commit, from the writer thread;
        `given_up` tells the sensors that are not tracked, whose records hold no file back. Neither may
        block or use the log. Raises StorageError when another process uses the folder.
        """
        self._folder = folder
        self._limits = limits
        self._segment_bytes = min(limits.segment_bytes, share_of_log(limits))
        self._on_durable = on_durable
        self._given_up = given_up
        folder.mkdir(parents=True, exist_ok=True)
        self._lock_file = _lock(folder)
        self._guard = threading.Condition()  # over all that follows
        self._segments: list[Segment] = []
        self._last: dict[str, int] = {}
        self._released: dict[str, int] = {}
        self._waiting: deque[_Pending] = deque()
        self._waiting_records = 0
        self._closing = False
        self._refusal: str | None = None
        self._room_checked_s = -_ROOM_CHECK_S
        self._grown_bytes = 0  # about, since the size of the newest file was looked at
        self.sieve = Sieve()
        try:
            self._open_segments()
        except BaseException:
            os.close(self._lock_file)
            raise
        self._writer = threading.Thread(target=self._write_all, name="wayside-log", daemon=True)
        self._writer.start()

    # ------------------------------------------------------------- appending

    def append(self, sensor_id: str, records: Sequence[Record]) -> list[int]:
        """Write the records, wait until they are durable, and return their positions.

        Raises Unavailable when the log or the disk is full, and InvalidFrame when a frame cannot be stored.
        """
        return self.append_later(sensor_id, records).result()

    def append_async(self, sensor_id: str, records: Sequence[Record]) -> asyncio.Future[list[int]]:
        """Do the same as `append` without blocking the event loop; await what is returned."""
        loop = asyncio.get_running_loop()
        promise = Promise(loop, loop.create_future())
        self._enqueue(_Pending(sensor_id, records, promise))
        return promise.future

    def append_later(self, sensor_id: str, records: Sequence[Record]) -> Future[list[int]]:
        """Do the same without waiting; the future gives the positions once the records are durable."""
        done: Future[list[int]] = Future()
        done.set_running_or_notify_cancel()  # a caller that goes away does not take its records back
        self._enqueue(_Pending(sensor_id, records, done))
        return done

    def _enqueue(self, pending: _Pending) -> None:
        with self._guard:
            self._require_room(len(pending.records))
            self._waiting.append(pending)
            self._waiting_records += len(pending.records)
            self._guard.notify_all()

    def _require_room(self, count: int) -> None:
        if self._closing:
            raise Unavailable("the log is closing", self._limits.retry_after_s)
        if self._waiting_records + count > self._limits.pending_records:
            raise Unavailable(f"{self._waiting_records} records wait for the disk", 1.0)
        if time.monotonic() - self._room_checked_s >= _ROOM_CHECK_S:
            self._refusal = self._check_room()
            self._room_checked_s = time.monotonic()
        if self._refusal is not None:
            raise Unavailable(self._refusal, self._limits.retry_after_s)

    def refusal(self) -> str | None:
        """Return why no frames are taken now, None when they are."""
        with self._guard:
            try:
                self._require_room(0)
            except Unavailable as error:
                return str(error)
            return None

    def _check_room(self) -> str | None:
        """Drop what may go, and return why no more can be taken (None: there is room)."""
        self._drop_released()
        size = self._size_bytes()
        if size > self._limits.total_bytes:
            return f"the log is full: {size} of {self._limits.total_bytes} bytes, and none of it may go yet"
        disk = shutil.disk_usage(self._folder)
        if disk.free < self._limits.free_share * disk.total:
            return f"the disk is nearly full: {disk.free} of {disk.total} bytes are free"
        return None

    # ------------------------------------------------------------- the writer thread

    def _write_all(self) -> None:
        while True:
            with self._guard:
                while not self._waiting and not self._closing:
                    self._guard.wait()
                batch = list(self._waiting)
                self._waiting.clear()
            if not batch:
                return
            try:
                self._write(batch)
            except Exception as error:  # noqa: BLE001 - the edge of a thread: each caller hears of it
                log.error("log not written", error=str(error))  # noqa: TRY400 - a full disk needs no trace
                for pending in batch:
                    if not pending.done.done():
                        pending.done.set_exception(_as_unavailable(error, self._limits.retry_after_s))
            finally:
                tell([pending.done for pending in batch if isinstance(pending.done, Promise)])
                with self._guard:
                    self._waiting_records -= sum(len(pending.records) for pending in batch)

    def _write(self, batch: Sequence[_Pending]) -> None:
        """Write what waits in one transaction, then tell everyone."""
        last = dict(self._last)
        rows: list[tuple[str, int, bytes]] = []
        written: list[tuple[_Pending, list[int]]] = []
        for pending in batch:
            try:
                bodies = [encode_record(record) for record in pending.records]
            except InvalidFrame as error:
                pending.done.set_exception(error)
                continue
            first = last.get(pending.sensor_id, 0) + 1
            positions = list(range(first, first + len(bodies)))
            last[pending.sensor_id] = first + len(bodies) - 1
            rows.extend((pending.sensor_id, *row) for row in zip(positions, bodies, strict=True))
            written.append((pending, positions))
        segment = self._active()
        segment.append(rows)
        self._grown_bytes += len(rows) * _GROWTH_BYTES + sum(len(body) for _, _, body in rows)
        with self._guard:
            segment.extend(rows)
            for sensor_id, position in last.items():  # `reserve` may have raised others meanwhile
                self._last[sensor_id] = max(position, self._last.get(sensor_id, 0))
        if self._on_durable is not None:
            self._on_durable({sensor_id: position for sensor_id, position, _ in rows})
        for pending, positions in written:
            pending.done.set_result(positions)

    def _active(self) -> Segment:
        """Return the segment to write into; a new one when the newest is large enough."""
        newest = self._segments[-1]
        if self._grown_bytes < self._segment_bytes // _SIZE_CHECKS:
            return newest
        self._grown_bytes = 0
        if newest.size_bytes() < self._segment_bytes:
            return newest
        with self._guard:
            segment = Segment(next_path(newest.path), self._last)
            self._segments.append(segment)
        _seal(newest)
        return segment

    # ------------------------------------------------------------- reading

    def read(self, sensor_id: str, after: int, limit: int) -> list[tuple[int, Record]]:
        """Return up to `limit` records with positions above `after`, in order.

        A damaged record stands there as such, is logged and counted. Raises StorageError when a file is
        damaged or the log closed, Unavailable when a file cannot be read for now.
        """
        found: list[tuple[int, bytes]] = []
        at: Segment | None = None
        with self._guard:
            segments = [
                s for s in self._segments if sensor_id in s.extents and s.extents[sensor_id].last > after
            ]
            followed = [s for s in self._segments if sensor_id in s.followers]
        for at in segments:
            found += at.read(sensor_id, after, limit - len(found))
            if len(found) >= limit:
                break
        for segment in followed:
            if segment is not at:
                segment.leave(sensor_id)
        return [(position, self.sieve.record(sensor_id, position, body)) for position, body in found]

    @property
    def damaged_records(self) -> int:
        """Records that were read here and left out."""
        return self.sieve.damaged_records

    def last_position(self, sensor_id: str) -> int:
        """Return the newest position, 0 for an empty log."""
        return self._last.get(sensor_id, 0)

    def first_position(self, sensor_id: str) -> int:
        """Return the oldest position still kept, 0 when none is."""
        with self._guard:
            firsts = [s.extents[sensor_id].first for s in self._segments if sensor_id in s.extents]
        return min(firsts, default=0)

    def size_bytes(self) -> int:
        """Return what the log takes on the disk."""
        with self._guard:
            return self._size_bytes()

    def file_count(self) -> int:
        """Return of how many files the log consists."""
        with self._guard:
            return len(self._segments)

    @property
    def waiting_records(self) -> int:
        """Records that wait for the disk."""
        return self._waiting_records

    def oldest_us(self) -> int | None:
        """Return when the oldest record was received, None when there is none or it is not read for now."""
        with self._guard, suppress(Unavailable):
            oldest = self._segments[0]
            if oldest.begun_us is None and not self._closing and (body := oldest.first_body()) is not None:
                oldest.begun_us = record_time_us(body)
            return oldest.begun_us
        return None

    def _size_bytes(self) -> int:
        return sum(segment.size_bytes() for segment in self._segments)

    # ------------------------------------------------------------- retention

    def reserve(self, sensor_id: str, position: int) -> None:
        """Put the sensor's next record behind `position`, as when its log was lost and its rows were not."""
        with self._guard:
            self._last[sensor_id] = max(position, self._last.get(sensor_id, 0))

    def sensors(self) -> set[str]:
        """Return the sensors of which records are kept."""
        with self._guard:
            return {sensor_id for segment in self._segments for sensor_id in segment.extents}

    def release(self, sensor_id: str, position: int) -> None:
        """Allow the sensor's records up to `position` to be dropped when the log is too large."""
        with self._guard:
            self._released[sensor_id] = max(position, self._released.get(sensor_id, 0))

    def expire(self, sensor_id: str, position: int) -> None:
        """Keep the sensor's records up to `position` no longer, whether they were tracked or not."""
        with self._guard:
            self._released[sensor_id] = max(position, self._released.get(sensor_id, 0))
            for segment in self._segments:
                extent = segment.extents.get(sensor_id)
                if extent is not None and extent.last <= position:
                    segment.extents.pop(sensor_id)
                elif extent is not None and extent.first <= position:
                    segment.extents[sensor_id] = Extent(position + 1, extent.last)

    def purge(self, sensor_id: str) -> None:
        """Remove a sensor's records for good; its positions are not given again."""
        with self._guard:
            segments = [segment for segment in self._segments if sensor_id in segment.extents]
        for segment in segments:
            segment.purge(sensor_id)
            with self._guard:
                segment.extents.pop(sensor_id, None)
            segment.leave(sensor_id)

    def _drop_released(self) -> None:
        while len(self._segments) > 1 and self._size_bytes() > self._limits.total_bytes - self._segment_bytes:
            oldest = self._segments[0]
            wanted = {n for n, extent in oldest.extents.items() if extent.last > self._released.get(n, 0)}
            if not all(map(self._given_up, wanted)):
                return
            self._segments.pop(0)
            oldest.delete()
            log.info("log file dropped", file=oldest.path.name, untracked=sorted(wanted))

    # ------------------------------------------------------------- opening and closing

    def _open_segments(self) -> None:
        for path in sorted(self._folder.glob("segment-*.sqlite")):
            try:
                segment = Segment(path, {})
            except StorageError as error:
                log.error("log file set aside", file=path.name, error=str(error))  # noqa: TRY400
                set_aside(path)
                continue
            if self._segments:
                _seal(self._segments[-1])
            self._segments.append(segment)
            ends = {name: extent.last for name, extent in segment.extents.items()}
            for name, position in (*segment.carried.items(), *ends.items()):
                self._last[name] = max(position, self._last.get(name, 0))
        if not self._segments:
            used = [int(path.name[8:16]) for path in self._folder.glob("segment-*")]
            first = self._folder / f"segment-{max(used, default=0) + 1:08d}.sqlite"
            self._segments.append(Segment(first, {}))

    def close(self) -> None:
        """Write what waits, then let go of the files; closing again has no effect."""
        with self._guard:
            if self._closing:
                return
            self._closing = True
            self._guard.notify_all()
        self._writer.join()
        for segment in self._segments:
            segment.close()
        os.close(self._lock_file)


def _seal(segment: Segment) -> None:
    with suppress(sqlite3.Error):  # no room for it: the write-ahead file stays, nothing is lost
        segment.seal()


def _as_unavailable(error: Exception, retry_after_s: float) -> WaysideError:
    return (
        error
        if isinstance(error, WaysideError)
        else Unavailable(f"the log cannot be written: {error}", retry_after_s)
    )


def _lock(folder: Path) -> int:
    """Return the open lock file; raises StorageError when another process holds it."""
    descriptor = os.open(folder / "lock", os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise StorageError(f"another process uses the data in {folder}; only one may") from error
    return descriptor
