"""The tracker in a process of its own: reads the log, folds, stores rows and states, and tells the service.

One thread does all of it, so that nothing competes for the interpreter; it sleeps on the socket to the
serving process. The database is written here, the log only there: ticks go over the socket.
"""

from __future__ import annotations

import fcntl
import os
import socket
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import astuple
from functools import partial
from pathlib import Path
from typing import Any

import orjson
import structlog

from service.errors import StorageError, Unavailable, WaysideError
from service.formats.sensor import SensorConfig
from service.pipeline.blame import PlaceFile
from service.pipeline.channel import Reopening, open_channel
from service.pipeline.fold_state import Tracker
from service.pipeline.folding import DRAIN_S, IDLE_S, Folding, Pace
from service.pipeline.line import Kind, Line, LineClosed
from service.pipeline.live import LiveEntry
from service.pipeline.live_wire import encode_entry
from service.pipeline.log_reader import LogReader
from service.pipeline.nursery import Work, end_with
from service.pipeline.place import Place, open_place
from service.pipeline.records import Record, TickRecord
from service.pipeline.sieve import Sieve
from service.settings import Settings
from service.storage.database import open_database
from service.telemetry import Telemetry

WORK = "tracker"
REPORT_S = 0.5
ORPHANS_S = 10.0
NICENESS = 4  # what is logged can be tracked a moment later; what waits to be logged keeps a sensor waiting

_log = structlog.get_logger(__name__)


def work_of(settings: Settings, tracker: Tracker[Any], clock_us: Callable[[], int]) -> Work:
    """Return the work of a tracker process for a nursery; its files are socket, lifeline and place."""
    return partial(_work, settings, tracker, clock_us)


def pace_of(settings: Settings) -> Pace:
    """Return how often rows and states are stored."""
    return Pace(settings.flush_interval_s, settings.snapshot_interval_s, settings.snapshot_frames)


def _work(
    settings: Settings,
    tracker: Tracker[Any],
    clock_us: Callable[[], int],
    descriptors: list[int],
    arguments: dict[str, object],
) -> None:
    connection, lifeline, memory = descriptors
    end_with(lifeline)
    os.nice(NICENESS)
    mark = _mark(settings.log_dir)
    fcntl.flock(mark, fcntl.LOCK_SH)  # until the process ends
    line = Line(socket.socket(fileno=connection))
    place = open_place(memory, PlaceFile(Path(str(arguments["place"]))))
    TrackerProcess(settings, tracker, clock_us, line, place).run()


def wait_for_orphans(folder: Path) -> None:
    """Wait until the tracker processes of an earlier, killed service have ended.

    They do so by themselves, in the middle of a transaction if need be. Raises StorageError when one does
    not.
    """
    mark = _mark(folder)
    deadline_s = time.monotonic() + ORPHANS_S
    try:
        while True:
            try:
                fcntl.flock(mark, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                if time.monotonic() > deadline_s:
                    raise StorageError(
                        f"a tracker process of an earlier run still uses the data in {folder}"
                    ) from None
                time.sleep(0.01)
            else:
                return
    finally:
        os.close(mark)


def _mark(folder: Path) -> int:
    return os.open(folder / "trackers.lock", os.O_RDWR | os.O_CREAT, 0o644)


class RemoteLog:
    """The log as the tracker process sees it: reads the files itself, has ticks appended by the writer."""

    def __init__(self, reader: LogReader, line: Line) -> None:
        self._reader = reader
        self._line = line
        self._first: dict[str, int] = {}
        self._last: dict[str, int] = {}
        self._ticks: dict[str, Future[list[int]]] = {}
        self.sieve = Sieve()

    def learn(self, sensor_id: str, last: int, first: int | None = None) -> None:
        """Take in how far a sensor's log goes."""
        self._last[sensor_id] = max(last, self._last.get(sensor_id, 0))
        if first is not None:
            self._first[sensor_id] = first
        tick = self._ticks.pop(sensor_id, None)
        if tick is not None:
            tick.set_result([last])

    def refuse(self, sensor_id: str) -> None:
        """Take in that a tick was not logged."""
        tick = self._ticks.pop(sensor_id, None)
        if tick is not None:
            tick.set_exception(Unavailable("the log did not take the tick"))

    def read(self, sensor_id: str, after: int, limit: int) -> list[tuple[int, Record]]:
        """Return up to `limit` records above `after`; a damaged one stands there as such, and counts."""
        limit = min(limit, self.last_position(sensor_id) - after)  # a further file is not looked for in vain
        return [
            (position, self.sieve.record(sensor_id, position, body))
            for position, body in self._reader.read(sensor_id, after, limit)
        ]

    def append(self, sensor_id: str, records: Sequence[Record]) -> list[int]:
        """Raise StorageError: another process writes the log."""
        raise StorageError(f"a tracker process does not write the log of {sensor_id}: {records}")

    def append_later(self, sensor_id: str, records: Sequence[Record]) -> Future[list[int]]:
        """Have ticks appended by the writer; the future ends with the sensor's next record."""
        done: Future[list[int]] = Future()
        done.set_running_or_notify_cancel()
        self._ticks[sensor_id] = done
        for record in records:
            if not isinstance(record, TickRecord):
                raise StorageError("only ticks are appended from here")
            self._line.send(Kind.TICK, orjson.dumps([sensor_id, record.time_us]))
        return done

    def last_position(self, sensor_id: str) -> int:
        """Return the newest position as far as it was told, 0 for an empty log."""
        return self._last.get(sensor_id, 0)

    def first_position(self, sensor_id: str) -> int:
        """Return the oldest position that was kept when the sensor was taken in."""
        return self._first.get(sensor_id, 0)

    def reserve(self, sensor_id: str, position: int) -> None:
        """Do nothing: the writer has seen to it before the sensor came here."""

    def release(self, sensor_id: str, position: int) -> None:
        """Let the writer drop the sensor's records up to `position`."""
        self._line.send(Kind.RELEASE, orjson.dumps([sensor_id, position]))


class RemoteAudience:
    """Sends views to the serving process, the newest of each sensor: none waits for the others."""

    def __init__(self, line: Line) -> None:
        self._line = line
        self._views: dict[str, tuple[LiveEntry, bool]] = {}

    def show(self, entry: LiveEntry, *, frame: bool) -> None:
        """Send the view, or replace the one that waits."""
        self._views[entry.sensor_id] = entry, frame
        self.push()

    def push(self) -> None:
        """Send what waits as far as the socket takes it."""
        self._line.push()
        while self._views and self._line.clear:
            sensor_id = next(iter(self._views))
            entry, frame = self._views.pop(sensor_id)
            self._line.send(Kind.VIEW, encode_entry(entry, frame=frame))

    def gone(self, sensor_id: str) -> None:
        """Tell that a sensor was let go."""
        self._views.pop(sensor_id, None)
        self._line.send(Kind.GONE, sensor_id.encode())

    @property
    def empty(self) -> bool:
        """Whether everything is on its way."""
        return not self._views and self._line.clear


class TrackerProcess:
    """The life of a tracker process."""

    def __init__(
        self,
        settings: Settings,
        tracker: Tracker[Any],
        clock_us: Callable[[], int],
        line: Line,
        place: Place,
    ) -> None:
        self._line = line
        self._place = place
        self._tracker = tracker
        self._clock_us = clock_us
        self._database = open_database(settings.rows_url)
        self._reader = LogReader(settings.log_dir)
        self._frame_log = RemoteLog(self._reader, line)
        self._audience = RemoteAudience(line)
        self._telemetry = Telemetry()
        self._folding: Folding[Any] = Folding(
            self._database,
            self._frame_log,
            self._audience,
            tracker,
            self._telemetry,
            pace=pace_of(settings),
            clock_us=clock_us,
            place=place,
        )
        self._failures: dict[str, str] = {}  # of sensors that could not be taken in
        self._stop_by_s: float | None = None
        self._reported_s = 0.0

    def run(self) -> None:
        """Fold until the service says to stop; ends without a word when it is gone."""
        self._line.send(Kind.READY)
        try:
            self._fold_all()
        except LineClosed:
            return
        self._folding.finish()
        self._report()
        self._line.send(Kind.DONE)
        while not self._audience.empty:
            self._audience.push()
            self._line.wait(IDLE_S)
        self._reader.close()
        self._database.dispose()

    def _fold_all(self) -> None:
        while True:
            self._hear()
            stop_by_s = self._stop_by_s
            worked = self._folding.take_turns()
            if time.monotonic() - self._reported_s >= REPORT_S:
                self._report()
            self._audience.push()
            if stop_by_s is not None and (not worked or time.monotonic() >= stop_by_s):
                return
            if not worked:
                self._line.wait(IDLE_S)

    def _hear(self) -> None:
        for kind, body in self._line.receive():
            match kind:
                case Kind.NEWS:
                    for sensor_id, position in orjson.loads(body).items():
                        self._frame_log.learn(sensor_id, position)
                case Kind.ADD:
                    self._take_in(**orjson.loads(body))
                case Kind.LEAVE:
                    channel = self._folding.channels.get(body.decode())
                    if channel is not None:
                        channel.leaving = True
                    else:
                        self._audience.gone(body.decode())
                case Kind.REFUSED:
                    self._frame_log.refuse(body.decode())
                case Kind.STOP:
                    self._stop_by_s = time.monotonic() + DRAIN_S
                case _:
                    _log.error("strange message", kind=kind)

    def _take_in(  # noqa: PLR0913 - the members of the message
        self,
        *,
        config: str,
        first: int,
        last: int,
        number: int,
        set_aside: list[int],
        digests: list[int],
        anew: str | None,
    ) -> None:
        chosen = SensorConfig.model_validate_json(config)
        self._place.end()
        self._frame_log.sieve.set_aside(chosen.sensor_id, set_aside, digests)
        self._frame_log.learn(chosen.sensor_id, last, first)
        self._failures.pop(chosen.sensor_id, None)
        if self._folding.reopen(chosen.sensor_id, Reopening(chosen, anew)):
            return
        try:
            channel = open_channel(
                self._database,
                self._frame_log,
                chosen,
                self._tracker,
                now_us=self._clock_us(),
                now_s=time.monotonic(),
                anew=anew,
            )
        except WaysideError as error:
            _log.exception("sensor not taken in", sensor_id=chosen.sensor_id)
            self._failures[chosen.sensor_id] = str(error)
        else:
            channel.number = number
            self._folding.take_in_again(channel)

    def _report(self) -> None:
        """Tell where everything stands."""
        self._reported_s = time.monotonic()
        self._reader.let_go()
        standings = [astuple(channel.standing()) for channel in self._folding.channels.values()]
        report = {
            "standings": standings,
            "failures": self._failures,
            "metrics": self._telemetry.samples(),
            "damaged_records": self._frame_log.sieve.damaged_records,
        }
        self._line.send(Kind.REPORT, orjson.dumps(report))
