"""Where the host and its sensors stand: ages, lag, queues and sizes, for health replies and gauges."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from sqlalchemy import Engine

from service.pipeline.channel import Doorway, Standing
from service.pipeline.clocks import ClockReport
from service.pipeline.live import LiveState, LiveView
from service.pipeline.sqlite_log import SqliteLog
from service.pipeline.tracker_member import ProcessHealth
from service.storage.database import file_bytes
from service.storage.oldest import KINDS
from service.telemetry import Telemetry

_US_PER_S = 1_000_000


@dataclass(frozen=True, slots=True)
class SensorHealth:
    """Where one sensor stands."""

    sensor_id: str
    state: LiveState
    failure: str | None  # why its frames are not tracked any more
    epoch: int
    logged_position: int
    folded_position: int
    stored_position: int
    received_us: int | None  # host's time of the newest folded frame
    frame_age_s: float | None  # since then
    stored_age_s: float | None  # since rows were stored last
    lag_s: float  # how long the oldest frame that is logged and not folded has waited; 0: none waits
    unstored_frames: int  # folded, and not stored yet
    waiting_bytes: int  # in the log, of frames that are not folded
    clock: ClockReport  # the sensor's clock against the host's

    @property
    def queue_depth(self) -> int:
        """Records that are logged and not folded."""
        return self.logged_position - self.folded_position


@dataclass(frozen=True, slots=True)
class StorageHealth:
    """How much is stored, and since when."""

    log_bytes: int = 0
    log_files: int = 0
    log_oldest_age_s: float | None = None  # since the oldest frame that is kept was received
    log_waiting_records: int = 0  # for the disk
    log_damaged_records: int = 0
    rows_bytes: int | None = None  # None: a database elsewhere
    disk_free_share: float | None = None
    oldest_age_s: Mapping[str, float] = field(default_factory=dict)  # of the rows of each kind


@dataclass(frozen=True, slots=True)
class HostHealth:
    """Where the whole host stands."""

    ready: bool
    tracking: bool  # the tracker's thread, or every process of it, runs
    log_refusal: str | None  # why frames are not taken now
    storage: StorageHealth
    sensors: tuple[SensorHealth, ...]
    processes: tuple[ProcessHealth, ...] = ()  # of the tracker; none where a thread tracks

    @property
    def lag_s(self) -> float:
        """The longest lag of a sensor that is tracked."""
        return max((sensor.lag_s for sensor in self.sensors if sensor.failure is None), default=0.0)


def sensor_health(
    doorway: Doorway, standing: Standing, live: LiveView, logged_position: int, now_us: int
) -> SensorHealth:
    """Return where a sensor stands; a tracker process tells of itself twice a second, of tracks at once."""
    entry = live.newest(doorway.sensor_id)
    received_us = standing.received_us
    if entry is not None and entry.received_us is not None:
        received_us = max(entry.received_us, received_us or 0)
    return SensorHealth(
        sensor_id=doorway.sensor_id,
        state="waiting" if entry is None else entry.state(now_us),
        failure=standing.failure,
        epoch=standing.epoch,
        logged_position=logged_position,
        folded_position=doorway.folded,
        stored_position=standing.stored_position,
        received_us=received_us,
        frame_age_s=_age_s(now_us, received_us),
        stored_age_s=_age_s(now_us, standing.stored_us),
        lag_s=_age_s(now_us, doorway.oldest_waiting_us()) or 0.0,
        unstored_frames=standing.unstored_frames,
        waiting_bytes=doorway.waiting_bytes,
        clock=doorway.clock.report(),
    )


def storage_health(  # noqa: PLR0913 - what it looks at
    log: SqliteLog,
    data_dir: Path,
    database: Engine,
    now_us: int,
    *,
    damaged_records: int,
    oldest_us: Mapping[str, int],
) -> StorageHealth:
    """Return how much is stored; looks at files only, so that the event loop may ask.

    damaged_records: those that tracker processes left out.  oldest_us: since when rows of each kind are kept.
    """
    disk = shutil.disk_usage(data_dir)
    return StorageHealth(
        log_bytes=log.size_bytes(),
        log_files=log.file_count(),
        log_oldest_age_s=_age_s(now_us, log.oldest_us()),
        log_waiting_records=log.waiting_records,
        log_damaged_records=log.damaged_records + damaged_records,
        rows_bytes=file_bytes(database),
        disk_free_share=disk.free / disk.total,
        oldest_age_s={kind: max(0, now_us - then_us) / _US_PER_S for kind, then_us in oldest_us.items()},
    )


def show(health: HostHealth, telemetry: Telemetry) -> None:
    """Bring the gauges up to date."""
    storage = health.storage
    telemetry.log_bytes.set(storage.log_bytes)
    telemetry.log_files.set(storage.log_files)
    telemetry.log_damaged.set(storage.log_damaged_records)
    telemetry.log_waiting.set(storage.log_waiting_records)
    for gauge, value in (
        (telemetry.log_oldest_age, storage.log_oldest_age_s),
        (telemetry.rows_bytes, storage.rows_bytes),
        (telemetry.disk_free, storage.disk_free_share),
    ):
        if value is not None:
            gauge.set(value)
    for kind in KINDS:
        telemetry.rows_oldest_age.labels(kind).set(storage.oldest_age_s.get(kind, 0.0))
    for sensor in health.sensors:
        telemetry.failed.labels(sensor.sensor_id).set(sensor.failure is not None)
        telemetry.queue.labels(sensor.sensor_id).set(sensor.queue_depth)
        telemetry.lag.labels(sensor.sensor_id).set(sensor.lag_s)
        telemetry.waiting_bytes.labels(sensor.sensor_id).set(sensor.waiting_bytes)
        telemetry.unstored.labels(sensor.sensor_id).set(sensor.unstored_frames)
        telemetry.show_clock(sensor.sensor_id, sensor.clock.skew_s, sensor.clock.jitter_s)
        for gauge, age_s in (
            (telemetry.frame_age, sensor.frame_age_s),
            (telemetry.stored_age, sensor.stored_age_s),
        ):
            if age_s is not None:
                gauge.labels(sensor.sensor_id).set(age_s)


def _age_s(now_us: int, then_us: int | None) -> float | None:
    return None if then_us is None else (now_us - then_us) / _US_PER_S
