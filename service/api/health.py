"""Is the process alive, is the service ready, and how are its sensors? Outside the versioned prefix."""

from __future__ import annotations

from fastapi import APIRouter, Response, status
from sqlalchemy import text

from service import __version__
from service.api.dependencies import ReadKey, Services, ServicesDep
from service.api.schemas import (
    AliveReply,
    CheckReply,
    HealthReply,
    ReadyReply,
    SensorHealthReply,
    StorageReply,
    TrackerProcessReply,
)
from service.errors import WaysideError
from service.pipeline.health import HostHealth, SensorHealth, StorageHealth
from service.storage.database import connection

router = APIRouter(tags=["health"])

LAG_MOST_S = 5.0  # a live picture older than this is not one
METRICS_TYPE = "text/plain; version=0.0.4; charset=utf-8"


@router.get("/livez")
async def live() -> AliveReply:
    """The process answers."""
    return AliveReply(status="ok")


@router.get("/readyz", responses={503: {"model": ReadyReply, "description": "not ready"}})
def ready(services: ServicesDep, response: Response) -> ReadyReply:
    """Whether frames are taken, tracked in time and stored: one named check each."""
    found = services.host.health()
    checks = [_host(services), _log(found), _tracker(found), _lag(found), _database(services)]
    if all(check.ok for check in checks):
        return ReadyReply(status="ready", checks=checks)
    response.status_code = status.HTTP_503_SERVICE_UNAVAILABLE
    return ReadyReply(status="not ready", checks=checks)


@router.get("/healthz")
async def health(services: ServicesDep, _: ReadKey) -> HealthReply:
    """Every sensor: age of its newest frame and of its newest stored row, backlog, clock, failure."""
    found = services.host.health()
    degraded = not found.ready or not found.tracking or any(s.failure is not None for s in found.sensors)
    return HealthReply(
        status="degraded" if degraded else "ok",
        version=__version__,
        lag_s=round(found.lag_s, 3),
        log_bytes=found.storage.log_bytes,
        log_damaged_records=found.storage.log_damaged_records,
        storage=_storage(found.storage),
        sensors=[_sensor(sensor) for sensor in found.sensors],
        tracker_processes=[
            TrackerProcessReply(running=one.running, restarts=one.restarts, sensors=one.sensors)
            for one in found.processes
        ],
    )


@router.get("/metrics", response_class=Response)
async def metrics(services: ServicesDep, _: ReadKey) -> Response:
    """Metrics in the text format of Prometheus."""
    return Response(services.host.metrics(), media_type=METRICS_TYPE)


def _host(services: Services) -> CheckReply:
    is_ready = services.host.ready
    return CheckReply(name="host", ok=is_ready, detail="takes frames" if is_ready else "starting or stopping")


def _log(found: HostHealth) -> CheckReply:
    return CheckReply(name="log", ok=found.log_refusal is None, detail=found.log_refusal or "has room")


def _lag(found: HostHealth) -> CheckReply:
    detail = (
        f"the oldest frame that is not tracked yet has waited {found.lag_s:.1f} s, at most {LAG_MOST_S:g}"
    )
    return CheckReply(name="lag", ok=found.lag_s <= LAG_MOST_S, detail=detail)


def _tracker(found: HostHealth) -> CheckReply:
    failed = [sensor.sensor_id for sensor in found.sensors if sensor.failure is not None]
    if not found.tracking:
        detail = "the tracker does not run; it is started again where that is possible"
        return CheckReply(name="tracker", ok=False, detail=detail)
    return CheckReply(name="tracker", ok=True, detail=f"failed sensors: {len(failed)}")


def _database(services: Services) -> CheckReply:
    try:
        with connection(services.engine) as reader:
            reader.execute(text("SELECT 1"))
    except WaysideError as error:
        return CheckReply(name="database", ok=False, detail=str(error))
    return CheckReply(name="database", ok=True, detail="answers")


def _storage(storage: StorageHealth) -> StorageReply:
    share = storage.disk_free_share
    return StorageReply(
        log_files=storage.log_files,
        log_oldest_age_s=_rounded(storage.log_oldest_age_s),
        log_waiting_records=storage.log_waiting_records,
        rows_bytes=storage.rows_bytes,
        oldest_age_s={kind: round(age_s, 3) for kind, age_s in storage.oldest_age_s.items()},
        disk_free_share=None if share is None else round(share, 4),
    )


def _sensor(sensor: SensorHealth) -> SensorHealthReply:
    return SensorHealthReply(
        sensor_id=sensor.sensor_id,
        state=sensor.state,
        failure=sensor.failure,
        epoch=sensor.epoch,
        frame_age_s=_rounded(sensor.frame_age_s),
        stored_age_s=_rounded(sensor.stored_age_s),
        clock_ahead_s=_rounded(sensor.clock.ahead_s),
        clock_skew_s=_rounded(sensor.clock.skew_s),
        clock_drift_ppm=sensor.clock.drift_ppm,
        clock_jitter_s=None if sensor.clock.jitter_s is None else round(sensor.clock.jitter_s, 6),
        clock_steps=sensor.clock.steps,
        queue_depth=sensor.queue_depth,
        lag_s=round(sensor.lag_s, 3),
        unstored_frames=sensor.unstored_frames,
        waiting_log_bytes=sensor.waiting_bytes,
    )


def _rounded(age_s: float | None) -> float | None:
    return None if age_s is None else round(age_s, 3)
