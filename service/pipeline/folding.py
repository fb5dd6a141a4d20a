"""Fold sensors in turn, and store what comes out of it; one loop that belongs to a thread or to a process.

Each turn takes a few records of every sensor, so that one with a backlog does not hold up the others.
Rows and cursor of each sensor go to the database once a second, with a snapshot now and then; the sensors
take part in a few transactions spread over the second, since nothing is folded during one.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Generic, Protocol

import numpy as np
import structlog
from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

from service.errors import Unavailable, WaysideError
from service.pipeline.channel import Channel, Reopening, Restart, open_channel
from service.pipeline.flushing import settle, store
from service.pipeline.fold import TICK_US, step
from service.pipeline.fold_state import Folded, FoldOutput, S, Tracker
from service.pipeline.live import LiveEntry
from service.pipeline.log import FrameLog
from service.pipeline.place import Place, nowhere
from service.pipeline.records import DamagedRecord, FrameRecord, Record, TickRecord
from service.telemetry import Telemetry
from service.tracking.model import TrackStatus

_log = structlog.get_logger(__name__)

EXPIRED = "expired"  # the fate of frames that were never tracked
TURN_RECORDS = 4  # of one sensor before the next has its turn
PARTS = 5  # transactions over which the sensors are spread within the interval of flushes
DRAIN_S = 15.0  # a stop goes on folding for so long; what is left is folded at the next start
IDLE_S = 0.1  # longest wait without news: a tenth of what ticks and flushes are apart
UNSTORED_FRAMES = 50_000  # of one sensor, before folding waits for the database
# How far a tick keeps behind its time: a frame that comes after a later tick is not tracked, so a short stall
# of the network, or a sensor that posts once a second, must not meet one.
TICK_GRACE_US = 1_000_000
_US_PER_S = 1_000_000


@dataclass(frozen=True, slots=True)
class Pace:
    """How often rows and states are stored."""

    flush_interval_s: float = 1.0
    snapshot_interval_s: float = 10.0
    snapshot_frames: int = 200


class Audience(Protocol):
    """Who hears of what was folded."""

    def show(self, entry: LiveEntry, *, frame: bool) -> None:
        """Take a newer view of a sensor; `frame`: its record is a frame."""
        ...

    def gone(self, sensor_id: str) -> None:
        """Take in that a sensor that was leaving is let go: all that is its own is stored."""
        ...


class Folding(Generic[S]):
    """The sensors of one thread or process; nobody else touches it, but for `add`."""

    def __init__(  # noqa: PLR0913 - its collaborators
        self,
        database: Engine,
        log: FrameLog,
        audience: Audience,
        tracker: Tracker[S],
        telemetry: Telemetry,
        *,
        pace: Pace,
        clock_us: Callable[[], int],
        place: Place | None = None,
    ) -> None:
        self._database = database
        self._frame_log = log
        self._audience = audience
        self._tracker = tracker
        self._telemetry = telemetry
        self._pace = pace
        self._clock_us = clock_us
        self._place = place or nowhere()
        self.channels: dict[str, Channel[S]] = {}  # replaced, never changed
        self._guard = threading.Lock()  # over replacing them
        self._flushed_s = time.monotonic()

    def add(self, channel: Channel[S]) -> None:
        """Take a sensor in; from any thread."""
        with self._guard:
            self.channels = {**self.channels, channel.sensor_id: channel}

    def take_in_again(self, channel: Channel[S]) -> None:
        """Take in a sensor that may have failed before."""
        self.add(channel)
        if channel.skipped:
            self._telemetry.frames.labels(channel.sensor_id, EXPIRED).inc(channel.skipped)

    def reopen(self, sensor_id: str, reopening: Reopening) -> bool:
        """Have a sensor's state found again at the next turn; from any thread. False: it is not here."""
        channel = self.channels.get(sensor_id)
        if channel is not None:
            channel.reopening = reopening
        return channel is not None

    def take_turns(self) -> bool:
        """Fold a few records of each sensor, store what is due, and return whether there were any."""
        worked = [self._turn(channel) for channel in self.channels.values()]
        self._flush_if_due()
        self._reopen()
        self._let_go()
        return any(worked)

    def finish(self) -> None:
        """Store everything, with a snapshot of each sensor."""
        self._flush(self.channels.values(), snapshots=True)

    # ------------------------------------------------------------- folding

    def _turn(self, channel: Channel[S]) -> bool:
        """Fold a few records of a sensor; return whether there were any."""
        if channel.failure is not None or len(channel.unstored_received_us) > UNSTORED_FRAMES:
            return False
        try:
            if self._frame_log.last_position(channel.sensor_id) <= channel.state.position:
                self._tick_if_silent(channel)
                return False
            records = self._read(channel)
            for position, record in records:
                self._fold(channel, position, record)
        except Exception as error:  # noqa: BLE001 - the edge of one sensor: the others go on
            _log.exception("sensor failed", sensor_id=channel.sensor_id, position=channel.state.position + 1)
            channel.failure = f"record {channel.state.position + 1}: {type(error).__name__}: {error}"
            self._place.end()
            return False
        return bool(records)

    def _read(self, channel: Channel[S]) -> list[tuple[int, Record]]:
        """Return a sensor's next few records; none while they cannot be read, as when the disk is full."""
        if time.monotonic() < channel.read_again_s:
            return []
        try:
            records = self._frame_log.read(channel.sensor_id, channel.state.position, TURN_RECORDS)
        except Unavailable as error:
            if not channel.read_again_s:
                _log.warning(
                    "records not read, will try again", sensor_id=channel.sensor_id, reason=str(error)
                )
            channel.read_again_s = time.monotonic() + error.retry_after_s
            return []
        channel.read_again_s = 0.0
        return records

    def _fold(self, channel: Channel[S], position: int, record: Record) -> None:
        started_s = time.perf_counter()
        self._place.begin(channel.number, position)
        channel.state, output = step(channel.state, position, record, self._tracker)
        self._place.end()
        self._telemetry.fold.observe(time.perf_counter() - started_s)
        now_us = self._clock_us()
        if output.rows:
            channel.rows.append(output.rows)
        if output.restarted is not None:
            channel.restarts.append(Restart(position, output.restarted, now_us))
        if isinstance(record, FrameRecord):
            channel.received_us = record.received_us
            if position > channel.opened_position:
                channel.heard_us = record.received_us
        if output.folded:
            channel.newest = output.folded[-1]
        frames = output.frames
        if frames:
            channel.newest_frame = frames[-1]
            channel.frames_since_snapshot += len(frames)
            channel.unstored_received_us += [channel.received_us or now_us] * len(frames)
        if isinstance(record, DamagedRecord) and record.fatal:
            channel.frames_since_snapshot = self._pace.snapshot_frames  # so that it is never met again
        self._count(channel, record, output, now_us)
        entry = LiveEntry(
            channel.sensor_id,
            position,
            channel.state.epoch,
            channel.received_us,
            channel.newest,
            channel.newest_frame,
        )
        self._audience.show(entry, frame=isinstance(record, FrameRecord))

    def _count(self, channel: Channel[S], record: Record, output: FoldOutput, now_us: int) -> None:
        metrics, sensor_id = self._telemetry, channel.sensor_id
        if isinstance(record, FrameRecord):
            metrics.frames.labels(sensor_id, output.fate.value).inc()
            metrics.stage.labels("folded").observe(max(0, now_us - record.received_us) / _US_PER_S)
        if output.missing:
            metrics.missing.labels(sensor_id).inc(output.missing)
        if output.dropped:
            metrics.frames.labels(sensor_id, "dropped").inc(output.dropped)
        if output.restarted is not None:
            metrics.restarts.labels(sensor_id).inc()
        for item in output.frames:
            metrics.points.labels(sensor_id).inc(item.report.points)
            metrics.clusters.labels(sensor_id).inc(item.report.clusters)
        if output.folded:
            self._count_tracks(sensor_id, output.folded[-1])

    def _count_tracks(self, sensor_id: str, newest: Folded) -> None:
        counts = np.bincount(newest.estimates.status, minlength=len(TrackStatus))
        for status in (TrackStatus.CONFIRMED, TrackStatus.COASTING):
            self._telemetry.tracks.labels(sensor_id, status.name.lower()).set(int(counts[status]))

    # ------------------------------------------------------------- ticks

    def _tick_if_silent(self, channel: Channel[S]) -> None:
        """Append the next tick of a sensor that has been silent for long enough; do not wait for it."""
        state = channel.state
        newest_us = state.order.newest_us
        if channel.tick is not None and not channel.tick.done():
            return
        if newest_us is None or state.frame_us is None or not state.wants_ticks:
            return
        held = bool(state.order.held)
        number = 1 if held else state.ticks + 1
        if self._clock_us() - channel.heard_us < number * TICK_US + TICK_GRACE_US:
            return
        tick = TickRecord((newest_us if held else state.frame_us) + number * TICK_US)
        try:
            channel.tick = self._frame_log.append_later(channel.sensor_id, [tick])
        except Unavailable as error:
            _log.debug("tick put off", sensor_id=channel.sensor_id, reason=str(error))

    # ------------------------------------------------------------- storing

    def _flush_if_due(self) -> None:
        now_s, interval_s = time.monotonic(), self._pace.flush_interval_s
        if now_s - self._flushed_s < interval_s / PARTS:
            return
        self._flushed_s = now_s
        # A sensor that fell silent still wants its last snapshot: until then the log keeps its last records,
        # and with them every later file of all sensors.
        moved = [
            c
            for c in self.channels.values()
            if now_s - c.flushed_s >= interval_s
            and (c.state.position > c.shard.cursor or c.rows or c.restarts or self._snapshot_due(c))
        ]
        moved.sort(key=lambda c: c.flushed_s)
        due = moved[: -(-len(self.channels) // PARTS)]
        for channel in due:
            channel.flushed_s = now_s
        self._flush(due)

    def _flush(self, channels: Collection[Channel[S]], *, snapshots: bool = False) -> bool:
        """Store what the sound ones among the channels collected; return whether that worked."""
        sound = [channel for channel in channels if channel.failure is None or channel.rows]
        if not sound:
            return True
        due = [channel.sensor_id for channel in sound if snapshots or self._snapshot_due(channel)]
        try:
            self._store(sound, due)
        except Unavailable as error:
            self._telemetry.flush_failures.inc()
            _log.warning("rows not stored, will try again", reason=str(error))
            return False
        except (WaysideError, SQLAlchemyError) as error:
            self._telemetry.flush_failures.inc()
            if len(sound) == 1:
                _log.exception("sensor let go", sensor_id=sound[0].sensor_id)
                sound[0].rows.clear()
                sound[0].failure = str(error)
                return False
            # One sensor's rows do not go in: those of the others shall.
            stored = [self._flush([channel], snapshots=snapshots) for channel in sound]
            return all(stored)
        return True

    def _snapshot_due(self, channel: Channel[S]) -> bool:
        if channel.state.position <= channel.snapshot_position:
            return False
        waited_s = time.monotonic() - channel.snapshot_at_s
        return (
            waited_s >= self._pace.snapshot_interval_s
            or channel.frames_since_snapshot >= self._pace.snapshot_frames
        )

    def _store(self, channels: Collection[Channel[S]], snapshots: Collection[str]) -> None:
        started_s = time.perf_counter()
        now_us = self._clock_us()
        stored = store(self._database, channels, snapshots, now_us=now_us)
        self._telemetry.flush.observe(time.perf_counter() - started_s)
        now_us = self._clock_us()
        for item in stored:
            for received_us in item.channel.unstored_received_us[: item.frames]:
                self._telemetry.stage.labels("stored").observe(max(0, now_us - received_us) / _US_PER_S)
            settle(item, now_us=now_us, now_s=time.monotonic())
            if item.snapshot_position is not None:
                self._frame_log.release(item.channel.sensor_id, item.snapshot_position)

    def _reopen(self) -> None:
        """Find the state of sensors again that are to be tracked once more."""
        for channel in list(self.channels.values()):
            wanted = channel.reopening
            if wanted is None or (channel.rows and not self._flush([channel]) and channel.rows):
                continue  # rows of before the failure go first, at the next turn when the database is gone
            channel.reopening = None
            try:
                fresh = open_channel(
                    self._database,
                    self._frame_log,
                    wanted.config,
                    self._tracker,
                    now_us=self._clock_us(),
                    now_s=time.monotonic(),
                    anew=wanted.anew,
                )
            except (WaysideError, SQLAlchemyError) as error:
                _log.exception("sensor not taken in again", sensor_id=channel.sensor_id)
                channel.failure = str(error)
                continue
            fresh.number, fresh.leaving = channel.number, channel.leaving
            self.take_in_again(fresh)
            entry = LiveEntry(channel.sensor_id, fresh.state.position, fresh.state.epoch)
            self._audience.show(entry, frame=False)

    def _let_go(self) -> None:
        """Take out the sensors that are leaving, once all that is theirs is stored."""
        for channel in list(self.channels.values()):
            behind = self._frame_log.last_position(channel.sensor_id) > channel.state.position
            if not channel.leaving or (behind and channel.failure is None):
                continue
            if self._flush([channel], snapshots=True) or channel.failure is not None:
                with self._guard:
                    self.channels = {k: v for k, v in self.channels.items() if v is not channel}
                self._frame_log.release(channel.sensor_id, self._frame_log.last_position(channel.sensor_id))
                self._audience.gone(channel.sensor_id)
