"""The bodies of the part of the API that carries data: frames, live view, tracks, states, events."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field, JsonValue

from service.api.problems import ProblemField
from service.formats.rfc3339 import format_time
from service.storage.rows import EventRow, TrackSummary


class DetectionRow(BaseModel):
    """One detection, polar (`range_m`, `azimuth_deg`) or Cartesian (`x_m`, `y_m`, `z_m`)."""

    range_m: float | None = None
    azimuth_deg: float | None = None
    x_m: float | None = None
    y_m: float | None = None
    z_m: float | None = None
    radial_velocity_mps: float | None = None
    snr_db: float | None = None


class DetectionColumns(BaseModel):
    """Detections as columns of equal length, the faster form."""

    range_m: list[float] | None = None
    azimuth_deg: list[float] | None = None
    x_m: list[float] | None = None
    y_m: list[float] | None = None
    z_m: list[float | None] | None = None
    radial_velocity_mps: list[float | None] | None = None
    snr_db: list[float | None] | None = None


class FrameInput(BaseModel):
    """One frame of detections; read by formats/json_frames.py, described here."""

    sensor_id: str | None = Field(None, description="must be the sensor of the path where given")
    timestamp: str = Field(description="RFC 3339, any offset, up to six decimals")
    frame: int | None = Field(None, ge=0, description="sequence number; without it the timestamp is the key")
    boot_id: str | None = Field(None, description="names one run of the sensor, whose numbering starts anew")
    detections: list[DetectionRow] | DetectionColumns


MotionText = Literal["unclassified", "stationary", "moving", "oncoming", "start_stop"]
FrameStatus = Literal["accepted", "duplicate", "late", "conflict", "rejected"]


class FrameReply(BaseModel):
    """What became of one frame."""

    status: FrameStatus
    frame: int | None = None


class BatchItem(FrameReply):
    """What became of one frame of a batch."""

    index: int
    detail: str | None = None
    errors: list[ProblemField] = []


class BatchReply(BaseModel):
    """What became of each frame of a batch, in the order sent; a frame is taken whole or not at all."""

    accepted: int
    duplicate: int
    late: int
    conflict: int
    rejected: int
    results: list[BatchItem]


class LiveTrack(BaseModel):
    """A track after the newest frame, in the sensor's plan frame (x right, y forward)."""

    track_id: str
    status: Literal["tentative", "confirmed", "coasting", "deleted"]
    x_m: float
    y_m: float
    vx_mps: float
    vy_mps: float
    speed_mps: float
    heading_deg: float | None = Field(description="clockwise from the boresight")
    std_x_m: float
    std_y_m: float
    cov_xy_m2: float
    length_m: float | None
    width_m: float | None
    length_class: str | None
    existence: float = Field(description="probability that the track is a vehicle")
    age_s: float
    hits: int
    lane: int | None
    motion: MotionText
    longitude_deg: float | None
    latitude_deg: float | None


class Points(BaseModel):
    """The detections of the newest frame in the plan frame, as columns."""

    x_m: list[float]
    y_m: list[float]
    radial_velocity_mps: list[float | None]
    snr_db: list[float | None]


class LiveView(BaseModel):
    """The newest tracks of a sensor."""

    sensor_id: str
    version: int = Field(description="log position of the newest folded record; 0 before the first")
    epoch: int
    frame: int | None
    timestamp: str | None
    received_at: str | None
    age_s: float | None = Field(description="since the newest frame was received; not part of the ETag")
    state: Literal["waiting", "live", "stale"]
    tracks: list[LiveTrack]
    points: Points | None = None


class TrackReply(BaseModel):
    """A stored track."""

    track_id: str
    sensor_id: str
    ended: bool = Field(description="false also while it is not listed, but may be again: up to 30 s")
    start: str
    end: str
    duration_s: float
    first_frame: int
    last_frame: int
    states: int
    hits: int
    length_m: float | None
    width_m: float | None
    length_class: str | None
    existence: float
    first_x_m: float
    first_y_m: float
    last_x_m: float
    last_y_m: float
    distance_m: float
    mean_speed_mps: float
    max_speed_mps: float


def track_fields(track: TrackSummary) -> dict[str, object]:
    """Return the fields of a TrackReply, rounded to the millimetre."""
    measures = {name: _rounded(getattr(track, name)) for name in _TRACK_MEASURES}
    return {
        "track_id": str(track.key),
        "sensor_id": track.key.sensor_id,
        "ended": track.ended,
        "start": format_time(track.first_time_us),
        "end": format_time(track.last_time_us),
        "duration_s": round((track.last_time_us - track.first_time_us) / 1e6, 3),
        "first_frame": track.first_frame,
        "last_frame": track.last_frame,
        "states": track.states,
        "hits": track.hits,
        "length_class": track.length_class,
    } | measures


_TRACK_MEASURES = (
    "length_m",
    "width_m",
    "existence",
    "first_x_m",
    "first_y_m",
    "last_x_m",
    "last_y_m",
    "distance_m",
    "mean_speed_mps",
    "max_speed_mps",
)
TRACK_COLUMNS = tuple(TrackReply.model_fields)


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3) + 0.0


class StateReply(BaseModel):
    """One state of a track, in the plan frame."""

    track_id: str
    frame: int
    timestamp: str
    status: Literal["tentative", "confirmed", "coasting", "deleted"]
    x_m: float
    y_m: float
    vx_mps: float
    vy_mps: float
    speed_mps: float
    std_x_m: float
    std_y_m: float
    lane: int | None
    motion: MotionText
    longitude_deg: float | None
    latitude_deg: float | None


class EventReply(BaseModel):
    """Something that happened at a sensor, such as a restart of its tracker."""

    event_id: str
    sensor_id: str
    epoch: int
    kind: str
    timestamp: str
    detail: dict[str, JsonValue]

    @classmethod
    def of(cls, event: EventRow) -> EventReply:
        """Return the reply for a stored event."""
        return cls(
            event_id=f"{event.sensor_id}-{event.epoch}-{event.number}",
            sensor_id=event.sensor_id,
            epoch=event.epoch,
            kind=event.kind,
            timestamp=format_time(event.time_us),
            detail=dict(event.detail),
        )
