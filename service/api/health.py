"""Is the process alive, is the service ready, and how are its sensors? Outside the versioned prefix."""

from __future__ import annotations

from fastapi import APIRouter, Response, status
from sqlalchemy import text

from service import __version__
from service.api.dependencies import ReadKey, Services, ServicesDep
from service.api.schemas import AliveReply, CheckReply, HealthReply, ReadyReply, SensorHealthReply
from service.errors import WaysideError
from service.pipeline.host import SensorHealth
from service.storage.database import connection

router = APIRouter(tags=["health"])

METRICS_TYPE = "text/plain; version=0.0.4; charset=utf-8"


@router.get("/livez")
async def live() -> AliveReply:
    """The process answers."""
    return AliveReply(status="ok")


@router.get("/readyz", responses={503: {"model": ReadyReply, "description": "not ready"}})
def ready(services: ServicesDep, response: Response) -> ReadyReply:
    """Whether frames are taken, tracked and stored: one named check each."""
    checks = [_host(services), _tracker(services), _database(services)]
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
        log_bytes=found.log_bytes,
        log_damaged_records=found.log_damaged_records,
        sensors=[_sensor(sensor) for sensor in found.sensors],
    )


@router.get("/metrics", response_class=Response)
async def metrics(services: ServicesDep, _: ReadKey) -> Response:
    """Metrics in the text format of Prometheus."""
    services.host.health()  # brings the gauges up to date
    return Response(services.host.telemetry.text(), media_type=METRICS_TYPE)


def _host(services: Services) -> CheckReply:
    is_ready = services.host.ready
    return CheckReply(name="host", ok=is_ready, detail="takes frames" if is_ready else "starting or stopping")


def _tracker(services: Services) -> CheckReply:
    found = services.host.health()
    failed = [sensor.sensor_id for sensor in found.sensors if sensor.failure is not None]
    if not found.tracking:
        return CheckReply(name="tracker", ok=False, detail="the tracker thread does not run")
    return CheckReply(name="tracker", ok=True, detail=f"failed sensors: {len(failed)}")


def _database(services: Services) -> CheckReply:
    try:
        with connection(services.engine) as reader:
            reader.execute(text("SELECT 1"))
    except WaysideError as error:
        return CheckReply(name="database", ok=False, detail=str(error))
    return CheckReply(name="database", ok=True, detail="answers")


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
    )


def _rounded(age_s: float | None) -> float | None:
    return None if age_s is None else round(age_s, 3)
