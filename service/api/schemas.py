"""The bodies of the administrative part of the API: sites, sensors, keys, sessions, health."""

from __future__ import annotations

from typing import Annotated, Generic, Literal, Self, TypeVar, cast
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, JsonValue

from service.formats.rfc3339 import format_time
from service.formats.sensor import SensorConfig
from service.storage.audit import Act
from service.storage.keys import ApiKey, Scope
from service.storage.sites import Sensor, Site

Item = TypeVar("Item")

Name = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00]*$")]
Identifier = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
Latitude = Annotated[float, Field(ge=-90, le=90)]
Longitude = Annotated[float, Field(ge=-180, le=180)]


def _known_zone(name: str) -> str:
    try:
        ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise ValueError(f"{name!r} is no IANA time zone, such as Europe/Berlin") from None
    return name


TimeZone = Annotated[str, Field(max_length=64), AfterValidator(_known_zone)]


class _Input(BaseModel):
    model_config = ConfigDict(extra="forbid")


class SiteInput(_Input):
    """A place to register."""

    site_id: Identifier
    name: Name
    latitude_deg: Latitude
    longitude_deg: Longitude
    time_zone: TimeZone = "UTC"


class SitePatch(_Input):
    """The fields of a site to change; those left out stay."""

    name: Name = ""
    latitude_deg: Latitude = 0.0
    longitude_deg: Longitude = 0.0
    time_zone: TimeZone = "UTC"


class SiteReply(BaseModel):
    """A place with sensors."""

    site_id: str
    name: str
    latitude_deg: float
    longitude_deg: float
    time_zone: str = Field(description="IANA name; bins local days, never shifts stored times")
    created: str
    updated: str

    @classmethod
    def of(cls, site: Site) -> Self:
        """Return the reply for a stored site."""
        return cls(
            site_id=site.site_id,
            name=site.name,
            latitude_deg=site.latitude_deg,
            longitude_deg=site.longitude_deg,
            time_zone=site.time_zone,
            created=format_time(site.created_us),
            updated=format_time(site.updated_us),
        )


class SensorInput(SensorConfig):
    """A radar to register, as mounted; the content of a site file (SITE.json) is accepted as it is."""

    sensor_id: Identifier
    site_id: Identifier | None = None
    name: Name | None = None

    def config(self) -> SensorConfig:
        """Return the configuration without what only the register knows."""
        return SensorConfig.model_validate(self.model_dump(exclude={"site_id", "name"}))


class SensorReply(SensorConfig):
    """A radar as registered."""

    site_id: str | None
    name: str
    revision: int = Field(description="counts the changes, from 1")
    created: str
    updated: str

    @classmethod
    def of(cls, sensor: Sensor) -> Self:
        """Return the reply for a stored sensor."""
        return cls(
            **sensor.config.model_dump(),
            site_id=sensor.site_id,
            name=sensor.name,
            revision=sensor.revision,
            created=format_time(sensor.created_us),
            updated=format_time(sensor.updated_us),
        )


class KeyInput(_Input):
    """An API key to make."""

    name: Name
    scopes: Annotated[list[Scope], Field(min_length=1)]
    sensor_ids: list[Identifier] | None = Field(
        None, description="sensors for which the key may send frames; null: every sensor"
    )


class KeyReply(BaseModel):
    """What is known of a key; its secret is shown only once."""

    key_id: str
    name: str
    scopes: list[Scope]
    sensor_ids: list[str] | None
    created: str
    last_used: str | None = Field(description="to the minute")
    rotated: str | None = Field(description="when it got its present secret; null: at its creation")

    @classmethod
    def of(cls, key: ApiKey) -> Self:
        """Return the reply for a stored key."""
        return cls(**_key_fields(key))


class NewKeyReply(KeyReply):
    """A key just made, with the secret to send in `Authorization: Bearer` or `X-API-Key`."""

    secret: str

    @classmethod
    def made(cls, key: ApiKey, secret: str) -> Self:
        """Return the reply that shows the secret."""
        return cls(**_key_fields(key), secret=secret)


class ActReply(BaseModel):
    """One administrative act."""

    number: int
    time: str
    actor: str = Field(description='id of the key, "command line", or "nobody" where no key is needed')
    action: str = Field(examples=["key.created"])
    target: str = Field(description="id of what was changed")
    detail: dict[str, JsonValue]

    @classmethod
    def of(cls, act: Act) -> Self:
        """Return the reply for a stored act."""
        return cls(
            number=act.number,
            time=format_time(act.time_us),
            actor=act.actor,
            action=act.action,
            target=act.target,
            detail=cast("dict[str, JsonValue]", act.detail),
        )


class PurgeReply(BaseModel):
    """What was removed for good."""

    sensor_id: str
    rows: dict[str, int] = Field(description="removed rows by table")


class SessionReply(BaseModel):
    """Who the caller is to the service."""

    open: bool = Field(
        description="no key is needed: none exists and only this machine can reach the service"
    )
    key_id: str | None
    scopes: list[Scope]


class Page(BaseModel, Generic[Item]):
    """One page of a list in a stable order."""

    items: list[Item]
    next: str | None = Field(description="cursor of the next page, null on the last one")


class CheckReply(BaseModel):
    """One named check."""

    name: str
    ok: bool
    detail: str


class ReadyReply(BaseModel):
    """Whether the service can take frames and answer."""

    status: Literal["ready", "not ready"]
    checks: list[CheckReply]


class AliveReply(BaseModel):
    """The process answers."""

    status: Literal["ok"]


class SensorHealthReply(BaseModel):
    """How a sensor is."""

    sensor_id: str
    state: Literal["waiting", "live", "stale"]
    failure: str | None = Field(description="why its frames are not tracked any more")
    epoch: int
    frame_age_s: float | None = Field(description="since the newest tracked frame was received")
    stored_age_s: float | None = Field(description="since rows of it were stored")
    clock_ahead_s: float | None = Field(description="the sensor's clock less the host's; transport included")
    clock_skew_s: float | None = Field(description="the same by the least delayed frames of the last 20 s")
    clock_drift_ppm: float | None = Field(description="of the skew, over one to ten minutes")
    clock_jitter_s: float | None = Field(description="unsteadiness of arrival (RFC 3550, 6.4.1)")
    clock_steps: int = Field(description="how often the clock was set, since the service started")
    queue_depth: int = Field(description="records that are logged and not tracked yet")
    lag_s: float = Field(description="how long the oldest of them has waited since it was received")
    unstored_frames: int = Field(description="frames that are tracked and not stored yet")
    waiting_log_bytes: int = Field(
        description="what the log holds of frames that are not tracked yet; bounded for a sensor that failed"
    )


class RestartReply(BaseModel):
    """What a restart of a sensor's tracker leaves out."""

    sensor_id: str
    skipped: int = Field(description="records of the log that are left untracked")


class StorageReply(BaseModel):
    """How much is stored, and since when."""

    log_files: int
    log_oldest_age_s: float | None = Field(description="since the oldest frame that is kept was received")
    log_waiting_records: int = Field(description="records that wait for the disk")
    rows_bytes: int | None = Field(description="of the embedded database; null for one elsewhere")
    disk_free_share: float | None = Field(description="of the disk that holds the log")
    oldest_age_s: dict[str, float] = Field(
        description="since the oldest row of each kind was stored; looked up once a minute, none for no rows"
    )


class TrackerProcessReply(BaseModel):
    """One process that tracks some of the sensors."""

    running: bool
    restarts: int = Field(description="how often it ended by itself and was started again")
    sensors: int


class HealthReply(BaseModel):
    """How the service and its sensors are."""

    status: Literal["ok", "degraded"]
    version: str
    lag_s: float = Field(description="the longest lag of a sensor; /readyz fails above 5 s")
    log_bytes: int
    log_damaged_records: int
    storage: StorageReply
    sensors: list[SensorHealthReply]
    tracker_processes: list[TrackerProcessReply] = Field(
        description="processes that track beside the serving one; none: it tracks itself"
    )


JsonObject = dict[str, JsonValue]


def _key_fields(key: ApiKey) -> dict[str, object]:
    return {
        "key_id": key.key_id,
        "name": key.name,
        "scopes": sorted(key.scopes),
        "sensor_ids": None if key.sensor_ids is None else sorted(key.sensor_ids),
        "created": format_time(key.created_us),
        "last_used": None if key.last_used_us is None else format_time(key.last_used_us),
        "rotated": None if key.rotated_us is None else format_time(key.rotated_us),
    }
