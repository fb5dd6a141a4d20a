"""Sites and their sensors: create, read, change, archive.

Nothing is deleted: an archived site or sensor disappears from lists, what was recorded stays readable, and
its id is never given again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypedDict

from sqlalchemy import Connection, RowMapping, select, update

from service.errors import Conflict, InvalidInput, NotFound
from service.formats.sensor import SensorConfig
from service.storage.database import insert_or_ignore
from service.storage.page import Page, check_limit, cut, read_cursor
from service.storage.tables import sensors, sites

LIST_LIMIT = 1000  # sites or sensors of one page unless told


@dataclass(frozen=True, slots=True)
class Site:
    """A place with sensors."""

    site_id: str
    name: str
    latitude_deg: float
    longitude_deg: float
    time_zone: str  # IANA name; bins local days, never shifts stored times
    created_us: int
    updated_us: int
    archived_us: int | None


@dataclass(frozen=True, slots=True)
class Sensor:
    """A radar as registered; `revision` counts the changes of any of its fields, from 1."""

    ordinal: int
    sensor_id: str
    site_id: str | None
    name: str
    config: SensorConfig
    revision: int
    created_us: int
    updated_us: int
    archived_us: int | None


class SiteChanges(TypedDict, total=False):
    """The fields of a site that may change; those left out stay."""

    name: str
    latitude_deg: float
    longitude_deg: float
    time_zone: str


class SensorChanges(TypedDict, total=False):
    """The fields of a sensor that may change; those left out stay."""

    site_id: str | None
    name: str
    config: SensorConfig


def create_site(  # noqa: PLR0913 - the fields of a site
    connection: Connection,
    site_id: str,
    *,
    name: str,
    latitude_deg: float,
    longitude_deg: float,
    time_zone: str = "UTC",
    now_us: int,
) -> Site:
    """Register a site; raises Conflict when the id exists, archived or not."""
    query = insert_or_ignore(connection, "sites").values(
        site_id=site_id,
        name=name,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        time_zone=time_zone,
        created_us=now_us,
        updated_us=now_us,
    )
    if connection.scalar(query.returning(sites.c.site_id)) is None:
        raise Conflict(f"site {site_id} exists already; the id of an archived site is not given again")
    return read_site(connection, site_id)


def read_site(connection: Connection, site_id: str) -> Site:
    """Return a site that is not archived; raises NotFound."""
    row = (
        connection.execute(select(sites).where(sites.c.site_id == site_id, sites.c.archived_us.is_(None)))
        .mappings()
        .one_or_none()
    )
    if row is None:
        raise NotFound(f"no site {site_id}")
    return Site(**row)


def list_sites(
    connection: Connection,
    *,
    include_archived: bool = False,
    cursor: str | None = None,
    limit: int = LIST_LIMIT,
) -> Page[Site]:
    """Return sites by id."""
    query = select(sites).order_by(sites.c.site_id).limit(check_limit(limit) + 1)
    if not include_archived:
        query = query.where(sites.c.archived_us.is_(None))
    if cursor is not None:
        query = query.where(sites.c.site_id > read_cursor(cursor, str)[0])
    found = [Site(**row) for row in connection.execute(query).mappings()]
    return cut(found, limit, lambda site: (site.site_id,))


def update_site(connection: Connection, site_id: str, changes: SiteChanges, *, now_us: int) -> Site:
    """Change a site and return it as it is now; raises NotFound."""
    read_site(connection, site_id)
    connection.execute(update(sites).where(sites.c.site_id == site_id).values(**changes, updated_us=now_us))
    return read_site(connection, site_id)


def archive_site(connection: Connection, site_id: str, *, now_us: int) -> None:
    """Take a site out of use; raises NotFound, or Conflict while it has sensors."""
    read_site(connection, site_id)
    if list_sensors(connection, site_id=site_id, limit=1).items:
        raise Conflict(f"site {site_id} still has sensors; archive or move them first")
    connection.execute(
        update(sites).where(sites.c.site_id == site_id).values(archived_us=now_us, updated_us=now_us)
    )


def create_sensor(
    connection: Connection,
    config: SensorConfig,
    *,
    site_id: str | None = None,
    name: str | None = None,
    now_us: int,
) -> Sensor:
    """Register the sensor of a configuration (its name: the id, unless given).

    Raises Conflict when the id exists, archived or not, and InvalidInput when the site does not exist.
    """
    sensor_id = config.sensor_id
    _require_site(connection, site_id)
    query = insert_or_ignore(connection, "sensors").values(
        sensor_id=sensor_id,
        site_id=site_id,
        name=sensor_id if name is None else name,
        config=config.canonical_json(),
        revision=1,
        created_us=now_us,
        updated_us=now_us,
        longest_track_us=0,
    )
    if connection.scalar(query.returning(sensors.c.ordinal)) is None:
        raise Conflict(f"sensor {sensor_id} exists already; the id of an archived sensor is not given again")
    return read_sensor(connection, sensor_id)


def read_sensor(connection: Connection, sensor_id: str, *, include_archived: bool = False) -> Sensor:
    """Return a sensor; raises NotFound."""
    query = select(sensors).where(sensors.c.sensor_id == sensor_id)
    if not include_archived:
        query = query.where(sensors.c.archived_us.is_(None))
    row = connection.execute(query).mappings().one_or_none()
    if row is None:
        raise NotFound(f"no sensor {sensor_id}")
    return _sensor(row)


def list_sensors(
    connection: Connection,
    *,
    site_id: str | None = None,
    include_archived: bool = False,
    cursor: str | None = None,
    limit: int = LIST_LIMIT,
) -> Page[Sensor]:
    """Return sensors by id, of one site if given."""
    query = select(sensors).order_by(sensors.c.sensor_id).limit(check_limit(limit) + 1)
    if site_id is not None:
        query = query.where(sensors.c.site_id == site_id)
    if not include_archived:
        query = query.where(sensors.c.archived_us.is_(None))
    if cursor is not None:
        query = query.where(sensors.c.sensor_id > read_cursor(cursor, str)[0])
    found = [_sensor(row) for row in connection.execute(query).mappings()]
    return cut(found, limit, lambda sensor: (sensor.sensor_id,))


def update_sensor(connection: Connection, sensor_id: str, changes: SensorChanges, *, now_us: int) -> Sensor:
    """Change a sensor and return it as it is now.

    Raises NotFound, and InvalidInput for an unknown site or a configuration of another sensor.
    """
    before = read_sensor(connection, sensor_id)
    config = changes.get("config", before.config)
    if config.sensor_id != sensor_id:
        raise InvalidInput.at("/sensor_id", f"is {sensor_id} for good, got {config.sensor_id!r}")
    site_id = changes.get("site_id", before.site_id)
    _require_site(connection, site_id)
    connection.execute(
        update(sensors)
        .where(sensors.c.ordinal == before.ordinal)
        .values(
            site_id=site_id,
            name=changes.get("name", before.name),
            config=config.canonical_json(),
            revision=sensors.c.revision + 1,
            updated_us=now_us,
        )
    )
    return read_sensor(connection, sensor_id)


def archive_sensor(connection: Connection, sensor_id: str, *, now_us: int) -> None:
    """Take a sensor out of use; its rows stay readable. Raises NotFound."""
    sensor = read_sensor(connection, sensor_id)
    connection.execute(
        update(sensors)
        .where(sensors.c.ordinal == sensor.ordinal)
        .values(archived_us=now_us, updated_us=now_us, revision=sensors.c.revision + 1)
    )


def ordinal_of(connection: Connection, sensor_id: str) -> int:
    """Return the integer that stands for a sensor, archived or not, in the large tables; raises NotFound."""
    ordinal: int | None = connection.scalar(select(sensors.c.ordinal).where(sensors.c.sensor_id == sensor_id))
    if ordinal is None:
        raise NotFound(f"no sensor {sensor_id}")
    return ordinal


def _require_site(connection: Connection, site_id: str | None) -> None:
    if site_id is None:
        return
    try:
        read_site(connection, site_id)
    except NotFound as error:
        raise InvalidInput.at("/site_id", str(error)) from error


def _sensor(row: RowMapping) -> Sensor:
    fields = dict(row)
    del fields["longest_track_us"]
    config = SensorConfig.model_validate_json(fields.pop("config"))
    return Sensor(config=config, **fields)
