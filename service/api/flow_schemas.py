"""The bodies of the part of the API that counts: crossings, traffic measures, movements, counts by hand."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from service.api.track_schemas import TrackReply

LengthClass = Literal["motorcycle", "short", "medium", "long"]
Direction = Literal[-1, 1]


class CrossingReply(BaseModel):
    """One vehicle over one count line; place and time are those of the centre of its box."""

    crossing_id: str
    sensor_id: str
    line_id: str
    timestamp: str
    lane_id: str | None
    lane_map_version: int | None
    direction: Direction = Field(
        description="+1: to the left of the way from p0 to p1 of the line, -1: right"
    )
    track_id: str
    vehicle_id: str = Field(description="id of the first track of the same vehicle, where its track broke")
    frame: int
    x_m: float
    y_m: float
    speed_mps: float
    signed_speed_mps: float = Field(description="negative in direction -1")
    length_m: float | None
    length_class: LengthClass | None
    headway_s: float | None = Field(description="front bumper to front bumper, in lane and direction")
    gap_s: float | None = Field(description="rear bumper of the leader to front bumper")
    probability: float = Field(description="that the crossing is real")


class FlowRow(BaseModel):
    """Traffic measures of one line, lane, direction and length class in one interval."""

    row: str = Field(description="opens into its evidence: GET .../flow/{row}/evidence")
    sensor_id: str
    line_id: str
    lane_id: str | None = Field(description="null: all lanes, or vehicles in no known lane, see lane_scope")
    lane_scope: Literal["lane", "all_lanes", "no_lane"] = Field(description="what the row is of")
    direction: Direction | None = Field(description="null: both")
    length_class: LengthClass | None = Field(description="null: all")
    start: str
    end: str
    interval_s: int
    coverage: float = Field(description="frames received of those expected, 0 to 1")
    observed: float = Field(description="share of the time without stretches of more than 1 s without frames")
    n: int
    volume: int
    volume_low: int = Field(description="bounds of the true volume, 95 %")
    volume_high: int
    flow_vph: float
    time_mean_speed_mps: float | None
    space_mean_speed_mps: float | None
    p85_speed_mps: float | None
    occupancy_percent: float
    density_per_km: float
    mean_length_m: float | None
    mean_headway_s: float | None
    mean_gap_s: float | None
    peak_hour_factor: float | None
    virtual_length_m: float
    speed_histogram: list[int] | None = Field(
        None, description="vehicles in bins of 2.5 m/s from 0, last open"
    )
    quality: list[Literal["partial", "low_sample", "length_assumed"]]
    definitions: str


class FlowReply(BaseModel):
    """Traffic measures; an interval in which nothing was received is absent, which is not a volume of 0."""

    sensor_id: str
    interval: str
    time_zone: str
    items: list[FlowRow]


class CellRow(BaseModel):
    """Edie's measures of one cell of a lane in one interval."""

    sensor_id: str
    lane_id: str | None
    lane_map_version: int
    cell: int = Field(description="counted along the lane in driving direction")
    start: str
    end: str
    interval_s: int
    coverage: float
    observed: float
    length_m: float
    distance_m: float = Field(description="driven in the cell by all vehicles")
    time_s: float = Field(description="spent in the cell by all vehicles")
    flow_vph: float
    density_per_km: float
    speed_mps: float | None
    definitions: str


class CellReply(BaseModel):
    """Edie's measures of the cells in which somebody drove."""

    sensor_id: str
    interval: str
    time_zone: str
    items: list[CellRow]


class CoverageRow(BaseModel):
    """How much of one interval was received."""

    start: str
    end: str
    coverage: float
    observed: float


class CoverageReply(BaseModel):
    """How complete the data of a sensor are, interval by interval, also where nothing came."""

    sensor_id: str
    interval: str
    time_zone: str
    items: list[CoverageRow]


class MovementRow(BaseModel):
    """Vehicles of one class that entered over one gate and left over another; counted when they entered."""

    start: str
    end: str
    entry: str
    exit: str | None = Field(description="null: seen at no other gate")
    length_class: LengthClass | None
    volume: int
    expected: float = Field(description="sum of the probabilities that the vehicles are real")


class MovementReply(BaseModel):
    """The entry-exit matrix of each interval, its cells with vehicles in them."""

    sensor_id: str
    interval: str
    time_zone: str
    items: list[MovementRow]


class FrameRange(BaseModel):
    """Where in the log the crossings lie."""

    first: int | None
    last: int | None
    start: str | None
    end: str | None


class EvidenceReply(BaseModel):
    """What one flow row was computed from."""

    flow: FlowRow
    crossings: list[CrossingReply]
    tracks: list[TrackReply]
    frames: FrameRange


class ManualCountInput(BaseModel):
    """Vehicles counted by hand in one interval; without lane, direction or class: all of them."""

    line_id: Annotated[str, Field(min_length=1, max_length=64)]
    start: str = Field(description="RFC 3339", examples=["2025-05-12T06:00:00Z"])
    interval_s: Annotated[int, Field(ge=60, le=86_400, multiple_of=60)] = 900
    lane_id: Annotated[str, Field(pattern=r"^L[1-9][0-9]{0,2}$")] | None = None
    direction: Direction | None = None
    length_class: LengthClass | None = None
    counted: Annotated[int, Field(ge=0, le=1_000_000)]


class CheckRow(BaseModel):
    """A count by hand and the measured volume; the comparison is null where nothing was received."""

    line_id: str
    lane_id: str | None
    direction: Direction | None
    length_class: LengthClass | None
    start: str
    end: str
    interval_s: int
    coverage: float
    counted: int
    measured: int | None
    difference: int | None = Field(description="measured less counted")
    relative_error: float | None
    geh: float | None = Field(description="of hourly volumes; below 5 is the usual target")
    within_target: bool | None


class CheckReply(BaseModel):
    """Counts by hand held against the measured volumes."""

    sensor_id: str
    items: list[CheckRow]
