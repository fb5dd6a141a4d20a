"""Sites and sensors over HTTP: register, read, change, archive."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Annotated, cast

from fastapi import APIRouter, Body, Query, Request, Response, status
from pydantic import ValidationError
from sqlalchemy import Connection

from service.api.dependencies import (
    PREFIX,
    AdminKey,
    Cursor,
    Limit,
    Reader,
    ReadKey,
    SensorPath,
    Services,
    ServicesDep,
)
from service.api.paging import page_reply
from service.api.schemas import (
    Identifier,
    JsonObject,
    Page,
    PurgeReply,
    RestartReply,
    SensorInput,
    SensorReply,
    SiteInput,
    SitePatch,
    SiteReply,
)
from service.api.security import Caller
from service.errors import Conflict, FieldError, InvalidInput, NotFound, Unavailable
from service.formats.sensor import SensorConfig
from service.storage import purge
from service.storage import sites as store
from service.storage.audit import note_act
from service.storage.database import connection, session_scope
from service.tracking.filters.registry import make_filter
from service.traffic.parameters import traffic_setup

router = APIRouter(prefix=PREFIX)


@router.post("/sites", status_code=status.HTTP_201_CREATED, tags=["sites"])
def create_site(body: SiteInput, services: ServicesDep, response: Response, caller: AdminKey) -> SiteReply:
    """Register a site."""
    with session_scope(services.engine) as writer:
        site = store.create_site(writer, **body.model_dump(), now_us=_now_us())
        _note(writer, caller, "site.created", site.site_id, body.model_dump(mode="json"))
    response.headers["Location"] = f"/api/v1/sites/{site.site_id}"
    return SiteReply.of(site)


@router.get("/sites", tags=["sites"])
def list_sites(
    request: Request,
    reader: Reader,
    response: Response,
    _: ReadKey,
    cursor: Cursor = None,
    limit: Limit = 1000,
) -> Page[SiteReply]:
    """Sites by id."""
    return page_reply(request, response, store.list_sites(reader, cursor=cursor, limit=limit), SiteReply.of)


@router.get("/sites/{site_id}", tags=["sites"])
def read_site(site_id: Identifier, reader: Reader, _: ReadKey) -> SiteReply:
    """One site."""
    return SiteReply.of(store.read_site(reader, site_id))


@router.patch("/sites/{site_id}", tags=["sites"])
def change_site(site_id: Identifier, body: SitePatch, services: ServicesDep, caller: AdminKey) -> SiteReply:
    """Change some fields of a site."""
    changes = cast("store.SiteChanges", body.model_dump(exclude_unset=True))
    with session_scope(services.engine) as writer:
        site = store.update_site(writer, site_id, changes, now_us=_now_us())
        _note(writer, caller, "site.changed", site_id, body.model_dump(mode="json", exclude_unset=True))
    return SiteReply.of(site)


@router.delete("/sites/{site_id}", status_code=status.HTTP_204_NO_CONTENT, tags=["sites"])
def archive_site(site_id: Identifier, services: ServicesDep, caller: AdminKey) -> None:
    """Take a site without sensors out of use; its id is never given again."""
    with session_scope(services.engine) as writer:
        store.archive_site(writer, site_id, now_us=_now_us())
        _note(writer, caller, "site.archived", site_id)


@router.post("/sensors", status_code=status.HTTP_201_CREATED, tags=["sensors"])
def create_sensor(
    body: SensorInput, services: ServicesDep, response: Response, caller: AdminKey
) -> SensorReply:
    """Register a sensor; the content of a site file is accepted as it is."""
    config = _checked(body.config())
    if not services.host.ready:
        raise Unavailable("the service is not ready")
    sensor = _register(services, body, config, caller)
    services.host.configure(sensor)
    response.headers["Location"] = f"/api/v1/sensors/{sensor.sensor_id}"
    return SensorReply.of(sensor)


@router.get("/sensors", tags=["sensors"])
def list_sensors(  # noqa: PLR0913, PLR0917 - one parameter of the query each
    request: Request,
    reader: Reader,
    response: Response,
    _: ReadKey,
    site_id: Annotated[Identifier | None, Query()] = None,
    cursor: Cursor = None,
    limit: Limit = 1000,
) -> Page[SensorReply]:
    """Sensors by id, of one site if given."""
    page = store.list_sensors(reader, site_id=site_id, cursor=cursor, limit=limit)
    return page_reply(request, response, page, SensorReply.of)


@router.get("/sensors/{sensor_id}", tags=["sensors"])
def read_sensor(sensor_id: SensorPath, reader: Reader, _: ReadKey) -> SensorReply:
    """One sensor."""
    return SensorReply.of(store.read_sensor(reader, sensor_id))


@router.patch("/sensors/{sensor_id}", tags=["sensors"])
def change_sensor(
    sensor_id: SensorPath,
    patch: Annotated[JsonObject, Body(media_type="application/merge-patch+json")],
    services: ServicesDep,
    caller: AdminKey,
) -> SensorReply:
    """Change a sensor by a JSON merge patch (RFC 7396); the tracker takes it over between two frames."""
    return SensorReply.of(change_config(services, sensor_id, patch, caller))


def change_config(services: Services, sensor_id: str, patch: JsonObject, caller: Caller) -> store.Sensor:
    """Change a sensor by a JSON merge patch, for good and for the tracker; raises InvalidInput, NotFound."""
    with session_scope(services.engine) as writer:
        sensor = _change(writer, sensor_id, patch)
        _note(writer, caller, "sensor.changed", sensor_id, patch)
    services.host.configure(sensor)
    return sensor


@router.delete("/sensors/{sensor_id}", status_code=status.HTTP_204_NO_CONTENT, tags=["sensors"])
def archive_sensor(sensor_id: SensorPath, services: ServicesDep, caller: AdminKey) -> None:
    """Take a sensor out of use: it takes no more frames, what it recorded stays readable."""
    with session_scope(services.engine) as writer:
        store.archive_sensor(writer, sensor_id, now_us=_now_us())
        _note(writer, caller, "sensor.archived", sensor_id)
    services.host.forget(sensor_id)


@router.post("/sensors/{sensor_id}:purge", tags=["sensors"])
def purge_sensor(sensor_id: SensorPath, services: ServicesDep, caller: AdminKey) -> PurgeReply:
    """Remove for good what an archived sensor recorded: frames, tracks, events, all; its id stays taken."""
    with connection(services.engine) as reader:
        sensor = store.read_sensor(reader, sensor_id, include_archived=True)
    if sensor.archived_us is None:
        raise Conflict(f"sensor {sensor_id} is in use; DELETE it first")
    services.host.purge(sensor_id)
    rows = purge.purge_sensor(services.engine, sensor.ordinal)
    with session_scope(services.engine) as writer:
        _note(writer, caller, "sensor.purged", sensor_id, {"rows": rows})
    return PurgeReply(sensor_id=sensor_id, rows=rows)


@router.post("/sensors/{sensor_id}:restart", tags=["sensors"])
def restart_sensor(
    sensor_id: SensorPath,
    services: ServicesDep,
    caller: AdminKey,
    *,
    skip: Annotated[
        bool, Query(description="leave untracked what waits in the log, and begin behind it with no track")
    ] = False,
) -> RestartReply:
    """Track a sensor again whose tracker failed, from the record at which it did, or from now on."""
    skipped = services.host.restart(sensor_id, skip=skip)
    with session_scope(services.engine) as writer:
        _note(writer, caller, "sensor.restarted", sensor_id, {"skipped": skipped})
    return RestartReply(sensor_id=sensor_id, skipped=skipped)


def _register(services: Services, body: SensorInput, config: SensorConfig, caller: Caller) -> store.Sensor:
    """Store a new sensor, or return the one that an earlier try stored before the log refused it."""
    with session_scope(services.engine) as writer:
        _note(writer, caller, "sensor.created", config.sensor_id, body.model_dump(mode="json"))
        try:
            return store.create_sensor(writer, config, site_id=body.site_id, name=body.name, now_us=_now_us())
        except Conflict:
            if services.host.live.newest(config.sensor_id) is not None:
                raise
            try:
                return _change(writer, config.sensor_id, body.model_dump(mode="json", exclude_unset=True))
            except NotFound:  # archived
                pass
            raise


def _note(
    writer: Connection,
    caller: Caller,
    action: str,
    target: str,
    detail: Mapping[str, object] | None = None,
) -> None:
    note_act(writer, actor=caller.name, action=action, target=target, detail=detail, now_us=_now_us())


def _change(writer: Connection, sensor_id: str, patch: JsonObject) -> store.Sensor:
    before = store.read_sensor(writer, sensor_id)
    old = {**before.config.model_dump(mode="json"), "site_id": before.site_id, "name": before.name}
    try:
        wanted = SensorInput.model_validate(merge(old, patch))
    except ValidationError as error:
        raise _invalid(error) from None
    changes: store.SensorChanges = {
        "site_id": wanted.site_id,
        "name": wanted.name if wanted.name is not None else sensor_id,
        "config": _checked(wanted.config()),
    }
    return store.update_sensor(writer, sensor_id, changes, now_us=_now_us())


def merge(target: object, patch: object) -> object:
    """Return the target with a JSON merge patch applied (RFC 7396, section 2)."""
    if not isinstance(patch, dict):
        return patch
    merged = dict(target) if isinstance(target, dict) else {}
    for name, value in patch.items():
        if value is None:
            merged.pop(name, None)
        else:
            merged[name] = merge(merged.get(name), value)
    return merged


def _checked(config: SensorConfig) -> SensorConfig:
    """Return the configuration if the tracker can work with it; raises InvalidInput."""
    make_filter(config.filter)
    try:
        make_filter(config.filter, config.tracker_parameters().filters)
        traffic_setup(config)
    except InvalidInput as error:
        errors = [FieldError(f"/parameters{fault.pointer}", fault.reason) for fault in error.errors]
        raise InvalidInput(f"/parameters{error}", errors) from None
    return config


def _invalid(error: ValidationError) -> InvalidInput:
    errors = [
        FieldError("".join(f"/{part}" for part in fault["loc"]), str(fault["msg"]))
        for fault in error.errors()
    ]
    return InvalidInput(f"{errors[0].pointer}: {errors[0].reason}", errors)


def _now_us() -> int:
    return time.time_ns() // 1000
