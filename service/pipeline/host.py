"""The embedded host: takes frames in, has them folded, and answers where everything stands."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

import structlog
from sqlalchemy import Engine

from service.errors import NotFound, Unavailable, WaysideError
from service.formats.columnar import points_digest
from service.formats.sensor import SensorConfig
from service.pipeline.blame import Blame, BlameBook, PlaceFile
from service.pipeline.channel import Doorway, open_channel, open_doorway
from service.pipeline.door import Door, ItemResult
from service.pipeline.fold_state import Tracker
from service.pipeline.folding import Folding
from service.pipeline.health import HostHealth, StorageHealth, sensor_health, show, storage_health
from service.pipeline.keeping import Keeping
from service.pipeline.live import LiveEntry, LiveView
from service.pipeline.nursery import Nursery
from service.pipeline.order import flush
from service.pipeline.place import nowhere
from service.pipeline.records import ControlRecord, FrameRecord
from service.pipeline.sqlite_log import LogLimits, SqliteLog, share_of_log
from service.pipeline.tracker_member import ProcessHealth
from service.pipeline.tracker_process import pace_of, wait_for_orphans
from service.pipeline.tracker_processes import TrackerProcesses
from service.pipeline.tracker_thread import Readers, TrackerThread
from service.pipeline.untracked import Allowance, Untracked
from service.settings import Settings
from service.storage.database import connection as reading
from service.storage.sites import Sensor, list_sensors
from service.telemetry import Telemetry
from service.tracking import tracker as default_tracker
from service.tracking.model import Frame

_log = structlog.get_logger(__name__)

_PAGE = 1000


def wall_clock_us() -> int:
    """Return the time of the machine in microseconds since 1970."""
    return time.time_ns() // 1000


class EmbeddedHost:
    """Log, live view and tracker (a thread here, or processes) on one data directory."""

    def __init__(  # noqa: PLR0913 - its collaborators
        self,
        database: Engine,
        settings: Settings,
        *,
        tracker: Tracker[Any] | ModuleType = default_tracker,
        telemetry: Telemetry | None = None,
        clock_us: Callable[[], int] = wall_clock_us,
        nursery: Nursery | None = None,
    ) -> None:
        """Make a host on a migrated database; `start` opens its log.

        nursery: where tracker processes are started, as many as the settings say; without it a thread tracks.
        """
        self.live = LiveView()
        self.telemetry = telemetry or Telemetry()
        self._database = database
        self._settings = settings
        self._tracker: Any = tracker
        self._clock_us = clock_us
        self._nursery = nursery
        self._doorways: dict[str, Doorway] = {}  # replaced, never changed
        self._configuring = threading.Lock()
        self._frame_log: SqliteLog | None = None
        self._door: Door | None = None
        self._trackers: TrackerThread[Any] | TrackerProcesses | None = None
        self._untracked: Untracked | None = None
        self._blames: BlameBook | None = None
        self._keeping = Keeping(database, settings, clock_us)
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
        self._frame_log = SqliteLog(self._settings.log_dir, limits, self._on_durable, self._given_up)
        wait_for_orphans(self._settings.log_dir)
        blames = self._blames = BlameBook(self._settings.log_dir, self._digest_at, self._on_set_aside)
        self._count_deaths(blames)
        self._door = Door(self._frame_log, self.telemetry, self._settings.clock_ahead_limit_s)
        self._trackers = self._make_trackers(self._frame_log, blames)
        for sensor in self._registered():
            self.configure(sensor)
        for sensor_id in self._frame_log.sensors() - self._doorways.keys():
            self._frame_log.release(sensor_id, self._frame_log.last_position(sensor_id))
        self._untracked = Untracked(
            self._frame_log,
            self._trackers,
            lambda: self._doorways,
            Allowance(share_of_log(limits), round(self._settings.untracked_hours * 3_600_000_000)),
            blames,
            self._clock_us,
        )
        self._trackers.start()
        self._keeping.start()
        self._untracked.start()
        self.ready = True

    def _make_trackers(
        self, frame_log: SqliteLog, blames: BlameBook
    ) -> TrackerThread[Any] | TrackerProcesses:
        readers = Readers(self.live, self.telemetry, self._clock_us, self._pass_folded)
        count = max(self._settings.tracker_process_count, 1)
        if self._nursery is not None:
            return TrackerProcesses(self._nursery, count, frame_log, readers, self.telemetry, blames)
        return TrackerThread(
            Folding(
                self._database,
                frame_log,
                readers,
                self._tracker,
                self.telemetry,
                pace=pace_of(self._settings),
                clock_us=self._clock_us,
                place=nowhere(PlaceFile(blames.place_path(0))),
            )
        )

    def _pass_folded(self, sensor_id: str, position: int) -> None:
        doorway = self._doorways.get(sensor_id)
        if doorway is not None:
            doorway.pass_folded(position)

    def stop(self) -> None:
        """Take no more frames, fold and store what is logged, and let go of the files."""
        self.ready = False
        if self._untracked is not None:
            self._untracked.stop()
        if self._trackers is not None:
            self._trackers.stop()
        self._keeping.stop()
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

    # ------------------------------------------------------------- sensors

    def configure(self, sensor: Sensor) -> None:
        """Take a registered sensor in, or its changed configuration; durable when this returns.

        Blocks for the disk, so not for the event loop. Raises Unavailable when the log is full.
        """
        frame_log = self._log()
        with self._configuring:
            doorway = self._doorways.get(sensor.sensor_id)
            if doorway is None:
                self._take_in(sensor)
            elif doorway.config != sensor.config:
                record = ControlRecord(sensor.config.canonical_json(), self._clock_us())
                frame_log.append(sensor.sensor_id, [record])
                doorway.config = sensor.config
                doorway.door, _ = flush(doorway.door)
                if self._trackers is not None:
                    self._trackers.reconfigure(sensor.config)

    def _take_in(self, sensor: Sensor) -> None:
        channel = open_channel(
            self._database,
            self._log(),
            sensor.config,
            self._tracker,
            now_us=self._clock_us(),
            now_s=time.monotonic(),
        )
        channel.number = sensor.ordinal
        blame = self._blame_of(sensor.sensor_id)
        channel.failure = blame.failure
        doorway = open_doorway(self._log(), sensor.config, channel.state, now_us=self._clock_us())
        self.live.publish(LiveEntry(sensor.sensor_id, channel.state.position, channel.state.epoch))
        doorway.set_aside = frozenset(blame.digests)
        self._doorways = {**self._doorways, sensor.sensor_id: doorway}
        if self._trackers is not None:
            self._trackers.add(channel, sensor.config)

    def forget(self, sensor_id: str) -> None:
        """Take no more frames of a sensor; what is logged is still folded and stored."""
        with self._configuring:
            known = sensor_id in self._doorways
            self._doorways = {k: v for k, v in self._doorways.items() if k != sensor_id}
        if known and self._trackers is not None:
            self._trackers.leave(sensor_id)

    def purge(self, sensor_id: str) -> None:
        """Remove an archived sensor's records from the log; raises Unavailable while they are folded."""
        if self.live.newest(sensor_id) is not None:
            raise Unavailable(f"what sensor {sensor_id} recorded is still being stored", 1.0)
        self._log().purge(sensor_id)
        if self._blames is not None:
            self._blames.forget(sensor_id)

    def restart(self, sensor_id: str, *, skip: bool) -> int:
        """Track a sensor that failed once more, and return how many records are left out for good.

        skip: those that are logged and not tracked; an epoch without tracks begins behind them. Raises
        NotFound, Conflict when the sensor has not failed, and Unavailable.
        """
        doorway = self._doorway(sensor_id)
        if self._untracked is None:
            raise Unavailable("the service has not started yet")
        return self._untracked.restart(doorway, skip=skip)

    def config(self, sensor_id: str) -> SensorConfig:
        """Return the configuration by which a sensor's frames are decoded; raises NotFound."""
        return self._doorway(sensor_id).config

    def _doorway(self, sensor_id: str) -> Doorway:
        doorway = self._doorways.get(sensor_id)
        if doorway is None:
            raise NotFound(f"no sensor {sensor_id}")
        return doorway

    def _log(self) -> SqliteLog:
        if self._frame_log is None:
            raise Unavailable("the service has not started yet")
        return self._frame_log

    # ------------------------------------------------------------- frames

    async def submit(self, sensor_id: str, frames: Sequence[Frame]) -> list[ItemResult]:
        """Log frames of a sensor and return, once they are durable, what became of each.

        Raises NotFound, and Unavailable when the log or the disk is full.
        """
        doorway = self._doorway(sensor_id)
        if not self.ready or self._door is None:
            raise Unavailable("the service is not ready")
        if self._untracked is not None:
            self._untracked.require_room(doorway)
        return await self._door.submit(doorway, frames, self._clock_us())

    def count_rejected(self, sensor_id: str, count: int) -> None:
        """Count frames of a sensor that could not be read."""
        if self._door is not None:
            self._door.count_rejected(sensor_id, count)

    def _given_up(self, sensor_id: str) -> bool:
        return self._untracked is not None and self._untracked.given_up(sensor_id)

    def _count_deaths(self, blames: BlameBook) -> None:
        """Charge the end of an earlier service to the records that its trackers were at."""
        sensors = {sensor.ordinal: sensor.sensor_id for sensor in self._registered()}
        for sensor_id in sensors.values():
            self._on_set_aside(sensor_id)
        for number, position in blames.take_places():
            if number in sensors:
                blames.died_at(sensors[number], position)

    def _blame_of(self, sensor_id: str) -> Blame:
        return Blame() if self._blames is None else self._blames.of(sensor_id)

    def _on_set_aside(self, sensor_id: str) -> None:
        blame = self._blame_of(sensor_id)
        self._log().sieve.set_aside(sensor_id, blame.set_aside, blame.digests)
        doorway = self._doorways.get(sensor_id)
        if doorway is not None:
            doorway.set_aside = frozenset(blame.digests)

    def _digest_at(self, sensor_id: str, position: int) -> int | None:
        try:
            found = self._log().read(sensor_id, position - 1, 1)
        except WaysideError as error:  # the tracker shall be started again all the same
            _log.warning("frame not remembered", sensor_id=sensor_id, position=position, reason=str(error))
            return None
        frames = (record for _, record in found)
        return next((points_digest(one.frame) for one in frames if isinstance(one, FrameRecord)), None)

    def _on_durable(self, positions: dict[str, int]) -> None:
        if self._trackers is not None:
            self._trackers.news(positions)

    # ------------------------------------------------------------- health

    def health(self) -> HostHealth:
        """Return where every sensor and the log stand, and bring the gauges up to date."""
        now_us, frame_log, trackers = self._clock_us(), self._frame_log, self._trackers
        storage, sensors = StorageHealth(), []
        if frame_log is not None and trackers is not None:
            storage = storage_health(
                frame_log,
                self._settings.log_dir,
                self._database,
                now_us,
                damaged_records=trackers.damaged_records,
                oldest_us=self._keeping.oldest_us,
            )
            for doorway in self._doorways.values():
                standing = trackers.standing(doorway.sensor_id)
                if standing is not None:
                    logged = frame_log.last_position(doorway.sensor_id)
                    sensors.append(sensor_health(doorway, standing, self.live, logged, now_us))
        found = HostHealth(
            ready=self.ready,
            tracking=trackers is not None and trackers.alive,
            log_refusal=None if frame_log is None else frame_log.refusal(),
            storage=storage,
            sensors=tuple(sensors),
            processes=self.tracker_processes(),
        )
        show(found, self.telemetry)
        return found

    def tracker_processes(self) -> tuple[ProcessHealth, ...]:
        """Return where each tracker process stands; uses no lock."""
        return () if self._trackers is None else self._trackers.health()

    def metrics(self) -> bytes:
        """Return the metrics of the host and of its tracker processes in Prometheus' text format."""
        self.health()
        return self.telemetry.text([] if self._trackers is None else self._trackers.samples())

    def recent_frames(self, sensor_id: str, count: int) -> list[FrameRecord]:
        """Return the frames among a sensor's newest `count` records; reads the disk. Raises NotFound."""
        self._doorway(sensor_id)
        frame_log = self._log()
        after = max(0, frame_log.last_position(sensor_id) - count)
        records = (record for _, record in frame_log.read(sensor_id, after, count))
        return [record for record in records if isinstance(record, FrameRecord)]
