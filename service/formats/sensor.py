"""Turn what an installer knows (SITE.json, the body of a sensor in the API) into a sensor configuration.

One schema for the file, the API and the control records of the log; angles in degrees, as on every wire.
"""

from __future__ import annotations

import json
import math
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from service.formats.length_class import LENGTH_BOUNDS_M
from service.tracking.fitting import fit_to_sensor
from service.tracking.parameters import SensorModel, TrackerParameters
from service.tracking.profiles import profile_parameters

LINE_LEAST_M = 0.5  # of a count line: nothing on wheels is narrower
TRAFFIC_PREFIX = "traffic."  # of the keys of `parameters` that are of traffic analysis, not of the tracker

SensorId = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$", examples=["radar-1"])]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Schema(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class Region(_Schema):
    """Where vehicles are tracked, in the sensor's plan frame."""

    range_min_m: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 20.0
    range_max_m: Positive = 150.0
    azimuth_max_deg: Annotated[float, Field(gt=0, le=90)] = 45.0


class Resolution(_Schema):
    """Widths of the radar's resolution cells."""

    range_m: Positive = 0.75
    velocity_mps: Positive = 0.25
    azimuth_deg: Positive = 1.5


class NoiseStd(_Schema):
    """Standard deviations of a detection at `at_snr_db`."""

    range_m: Positive = 0.15
    velocity_mps: Positive = 0.10
    azimuth_deg: Positive = 0.3
    azimuth_floor_deg: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.1
    at_snr_db: Finite = 20.0


class CountLine(_Schema):
    """A line across the road; vehicles are counted as their centre crosses it."""

    line_id: Annotated[str, Field(min_length=1, max_length=64)]
    p0: tuple[Finite, Finite]
    p1: tuple[Finite, Finite]

    @model_validator(mode="after")
    def _has_a_length(self) -> CountLine:
        length_m = math.dist(self.p0, self.p1)
        if length_m < LINE_LEAST_M:
            raise ValueError(
                f"a line needs {LINE_LEAST_M:g} m at least between p0 and p1, has {length_m:g} m"
            )
        return self


class GivenLane(_Schema):
    """A lane that a user put into force: its centre line in driving direction, in the plan frame."""

    index: Annotated[int, Field(ge=1, le=255)]
    points_m: Annotated[tuple[tuple[Finite, Finite], ...], Field(min_length=2, max_length=1000)]
    width_m: Annotated[float, Field(gt=0, le=20)] = 3.5
    kind: Literal["lane", "turn"] = "lane"
    vehicles: Annotated[int, Field(ge=0)] = 0  # that it was learned from, when it was


class LaneControl(_Schema):
    """Where the lane map comes from: learned from traffic, pinned as it was learned, or drawn by a user."""

    mode: Literal["learned", "pinned", "replaced"] = "learned"
    lanes: Annotated[tuple[GivenLane, ...], Field(max_length=255)] = ()  # in force unless they are learned
    names: dict[str, str] = {}  # lane_id -> what people call it
    accepted: str | None = None  # "<epoch>-<version>" of the map that a user found right

    @model_validator(mode="after")
    def _one_lane_an_index(self) -> LaneControl:
        indices = [lane.index for lane in self.lanes]
        if len(set(indices)) != len(indices):
            raise ValueError("two lanes have the same index")
        return self


class SensorConfig(_Schema):
    """A radar as mounted: pose, conventions, noise, region, count lines, and how it is tracked."""

    sensor_id: SensorId = "radar-1"
    latitude_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    longitude_deg: Annotated[float, Field(ge=-180, le=180)] | None = None
    heading_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0  # boresight, clockwise from north
    rate_hz: Annotated[float, Field(gt=0, le=200)] = 20.0
    mount_height_m: Annotated[float, Field(ge=0, le=100)] = 6.0
    scatter_height_m: Annotated[float, Field(ge=0, le=20)] = 0.6
    azimuth_offset_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0  # added to each measured azimuth
    azimuth_positive: Literal["right", "left"] = "right"
    radial_velocity_positive: Literal["receding", "approaching"] = "receding"
    travel_heading_deg: Annotated[float, Field(ge=-360, le=360)] | None = None
    region: Region = Region()
    resolution: Resolution = Resolution()
    noise_std: NoiseStd = NoiseStd()
    detection_threshold_db: Finite = 12.0
    count_lines: tuple[CountLine, ...] = ()
    lanes: LaneControl = LaneControl()
    length_bounds_m: tuple[Positive, Positive, Positive] = (
        LENGTH_BOUNDS_M  # motorcycle | short | medium | long
    )
    profile: Literal["fast", "default", "quality"] = "default"  # which values the tracker starts from
    filter: str = "astekf"
    parameters: dict[str, str] = {}  # dotted key -> text, as in `wayside track --set key=value`

    @model_validator(mode="after")
    def _names_lines_once(self) -> SensorConfig:
        names = [line.line_id for line in self.count_lines]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"count_lines: the line_id {twice[0]!r} is there twice")
        return self

    @field_validator("length_bounds_m")
    @classmethod
    def _bounds_ascend(cls, bounds: tuple[float, float, float]) -> tuple[float, float, float]:
        if not bounds[0] < bounds[1] < bounds[2]:
            raise ValueError("the bounds of the length classes must ascend")
        return bounds

    def sensor_model(self) -> SensorModel:
        """Return the part of the configuration that the tracking core needs, in radians."""
        return SensorModel(
            rate_hz=self.rate_hz,
            mount_height_m=self.mount_height_m,
            scatter_height_m=self.scatter_height_m,
            azimuth_offset_rad=math.radians(self.azimuth_offset_deg),
            range_min_m=self.region.range_min_m,
            range_max_m=self.region.range_max_m,
            azimuth_max_rad=math.radians(self.region.azimuth_max_deg),
            range_resolution_m=self.resolution.range_m,
            velocity_resolution_mps=self.resolution.velocity_mps,
            azimuth_resolution_rad=math.radians(self.resolution.azimuth_deg),
            range_std_m=self.noise_std.range_m,
            velocity_std_mps=self.noise_std.velocity_mps,
            azimuth_std_rad=math.radians(self.noise_std.azimuth_deg),
            azimuth_floor_rad=math.radians(self.noise_std.azimuth_floor_deg),
            noise_snr_db=self.noise_std.at_snr_db,
            detection_threshold_db=self.detection_threshold_db,
        )

    def tracker_parameters(self) -> TrackerParameters:
        """Return the tracker's parameters with this configuration's overrides; raises InvalidInput."""
        parameters = fit_to_sensor(profile_parameters(self.profile, self.sensor_model(), self.filter))
        for key in sorted(self.parameters):
            if key.startswith(TRAFFIC_PREFIX):
                continue  # service.traffic.parameters reads them
            parameters = parameters.with_setting(key, self.parameters[key])
        return parameters

    def canonical_json(self) -> str:
        """Return the configuration as one line of JSON with sorted keys, as control records keep it."""
        return json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
