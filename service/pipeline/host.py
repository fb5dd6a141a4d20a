"""The embedded host: takes frames in, has them folded, and answers where everything stands. One process."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

import structlog
from sqlalchemy import Engine

from service.errors import NotFound, Unavailable, WaysideError
from service.formats.sensor import SensorConfig
from service.pipeline.channel import Channel, open_channel
from service.pipeline.door import Door, ItemResult
from service.pipeline.fold_state import Tracker
from service.pipeline.health import HostHealth, StorageHealth, sensor_health, show, storage_health
from service.pipeline.live import LiveView
from service.pipeline.order import flush
from service.pipeline.records import ControlRecord, FrameRecord
from service.pipeline.sqlite_log import LogLimits, SqliteLog
from service.pipeline.tracker_thread import Pace, TrackerThread
from service.settings import Settings
from service.storage.database import connection as reading
from service.storage.sites import Sensor, list_sensors
from service.storage.upkeep import Retention, keep_up
from service.telemetry import Telemetry
from service.tracking import tracker as default_tracker
from service.tracking.model import Frame

_log = structlog.get_logger(__name__)

_PAGE = 1000


def wall_clock_us() -> int:
    """Return the time of the machine in microseconds since 1970."""
    return time.time_ns() // 1000


class EmbeddedHost:
    """Log, tracker thread and live view of one process on one data directory."""

    def __init__(
        self,
        database: Engine,
        settings: Settings,
        *,
        tracker: Tracker[Any] | ModuleType = default_tracker,
        telemetry: Telemetry | None = None,
        clock_us: Callable[[], int] = wall_clock_us,
    ) -> None:
        """Make a host on a migrated database; `start` opens its log."""
        self.live = LiveView()
        self.telemetry = telemetry or Telemetry()
        self._database = database
        self._settings = settings
        self._tracker: Any = tracker
        self._clock_us = clock_us
        self._channels: dict[str, Channel[Any]] = {}  # replaced, never changed
        self._configuring = threading.Lock()
        self._frame_log: SqliteLog | None = None
        self._door: Door | None = None
        self._thread: TrackerThread[Any] | None = None
        self._upkeep: threading.Thread | None = None
        self._stopped = threading.Event()
        self.ready = False

    # ------------------------------------------------------------- life

    def start(self) -> None:
        """Open the log, find every sensor's state again, and begin to track.

        Raises StorageError when another process uses the data directory.
        """
        limits = LogLimits(
            total_bytes=self._settings.log_limit_bytes,
            segment_bytes=self._settings.log_segment_bytes,
            free_share=self._settings.disk_free_min_share,
        )
        self._frame_log = SqliteLog(self._settings.log_dir, limits, on_durable=self._on_durable)
        self._door = Door(self._frame_log, self.telemetry, self._settings.clock_ahead_limit_s)
        pace = Pace(
            self._settings.flush_interval_s,
            self._settings.snapshot_interval_s,
            self._settings.snapshot_frames,
        )
        self._thread = TrackerThread(
            self._database,
            self._frame_log,
            self.live,
            self._tracker,
            self.telemetry,
            pace=pace,
            clock_us=self._clock_us,
        )
        for sensor in self._registered():
            self.configure(sensor)
        for sensor_id in self._frame_log.sensors() - self._channels.keys():
            self._frame_log.release(sensor_id, self._frame_log.last_position(sensor_id))
        self._thread.start()
        self._upkeep = threading.Thread(target=self._keep_up, name="wayside-upkeep", daemon=True)
        self._upkeep.start()
        self.ready = True

    def stop(self) -> None:
        """Take no more frames, fold and store what is logged, and let go of the files."""
        self.ready = False
        self._stopped.set()
        if self._thread is not None and self._thread.alive:
            self._thread.stop()
        if self._upkeep is not None:
            self._upkeep.join()
        if self._frame_log is not None:
            self._frame_log.close()

    def _registered(self) -> list[Sensor]:
        found: list[Sensor] = []
        cursor: str | None = None
        with reading(self._database) as connection:
            while True:
                page = list_sensors(connection, cursor=cursor, limit=_PAGE)
                found += page.items
                cursor = page.next_cursor
                if cursor is None:
                    return found

    def _keep_up(self) -> None:
        """Let go of expired rows, now and each hour."""
        retention = Retention(
            self._settings.states_days,
            self._settings.tracks_days,
            self._settings.events_days,
            self._settings.counts_days,
        )
        while True:
            try:
                expired = keep_up(self._database, retention, now_us=self._clock_us())
                _log.debug("upkeep done", state_blocks=expired.state_blocks, tracks=expired.tracks)
            except WaysideError as error:
                _log.warning("upkeep put off", reason=str(error))
            if self._stopped.wait(self._settings.upkeep_interval_s):
                return

    # ------------------------------------------------------------- sensors

    def configure(self, sensor: Sensor) -> None:
        """Take a registered sensor in, or its changed configuration; durable when this returns.

        Blocks for the disk, so not for the event loop. Raises Unavailable when the log is full.
        """
        frame_log = self._log()
        with self._configuring:
            channel = self._channels.get(sensor.sensor_id)
            if channel is None:
                self._take_in(sensor)
            elif channel.config != sensor.config:
                record = ControlRecord(sensor.config.canonical_json(), self._clock_us())
                frame_log.append(sensor.sensor_id, [record])
                channel.config = sensor.config
                channel.door, _ = flush(channel.door)

    def _take_in(self, sensor: Sensor) -> None:
        channel = open_channel(
            self._database,
            self._log(),
            sensor.config,
            self._tracker,
            now_us=self._clock_us(),
            now_s=time.monotonic(),
        )
        self._channels = {**self._channels, sensor.sensor_id: channel}
        if self._thread is not None:
            self._thread.add(channel)

    def forget(self, sensor_id: str) -> None:
        """Take no more frames of a sensor; what is logged is still folded and stored."""
        with self._configuring:
            channel = self._channels.get(sensor_id)
            self._channels = {k: v for k, v in self._channels.items() if k != sensor_id}
        if channel is not None and self._thread is not None:
            channel.leaving = True
            self._thread.wake()

    def purge(self, sensor_id: str) -> None:
        """Remove an archived sensor's records from the log; raises Unavailable while they are folded."""
        if self.live.newest(sensor_id) is not None:
            raise Unavailable(f"what sensor {sensor_id} recorded is still being stored", 1.0)
        self._log().purge(sensor_id)

    def config(self, sensor_id: str) -> SensorConfig:
        """Return the configuration by which a sensor's frames are decoded; raises NotFound."""
        return self._channel(sensor_id).config

    def _channel(self, sensor_id: str) -> Channel[Any]:
        channel = self._channels.get(sensor_id)
        if channel is None:
            raise NotFound(f"no sensor {sensor_id}")
        return channel

    def _log(self) -> SqliteLog:
        if self._frame_log is None:
            raise Unavailable("the service has not started yet")
        return self._frame_log

    # ------------------------------------------------------------- frames

    async def submit(self, sensor_id: str, frames: Sequence[Frame]) -> list[ItemResult]:
        """Log frames of a sensor and return, once they are durable, what became of each.

        Raises NotFound, and Unavailable when the log or the disk is full.
        """
        channel = self._channel(sensor_id)
        if not self.ready or self._door is None:
            raise Unavailable("the service is not ready")
        return await self._door.submit(channel, frames, self._clock_us())

    def count_rejected(self, sensor_id: str, count: int) -> None:
        """Count frames of a sensor that could not be read."""
        if self._door is not None:
            self._door.count_rejected(sensor_id, count)

    def _on_durable(self, sensor_id: str, position: int) -> None:  # noqa: ARG002 - what the log tells
        if self._thread is not None:
            self._thread.wake()

    # ------------------------------------------------------------- health

    def health(self) -> HostHealth:
        """Return where every sensor and the log stand, and bring the gauges up to date."""
        now_us, frame_log = self._clock_us(), self._frame_log
        found = HostHealth(
            ready=self.ready,
            tracking=self._thread is not None and self._thread.alive,
            log_refusal=None if frame_log is None else frame_log.refusal(),
            storage=StorageHealth()
            if frame_log is None
            else storage_health(frame_log, self._settings.log_dir, self._database, now_us),
            sensors=tuple(
                sensor_health(channel, self.live, self._log().last_position(channel.sensor_id), now_us)
                for channel in self._channels.values()
            ),
        )
        show(found, self.telemetry)
        return found

    def recent_frames(self, sensor_id: str, count: int) -> list[FrameRecord]:
        """Return the frames among a sensor's newest `count` records; reads the disk. Raises NotFound."""
        self._channel(sensor_id)
        frame_log = self._log()
        after = max(0, frame_log.last_position(sensor_id) - count)
        records = (record for _, record in frame_log.read(sensor_id, after, count))
        return [record for record in records if isinstance(record, FrameRecord)]
