"""The bodies of the part of the API that is about lanes: maps, their versions, control, lane changes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, Field

from service.errors import InvalidInput
from service.formats.georeference import Pose, to_wgs84
from service.formats.lanes import LaneRecord, lane_fields, read_lanes_json
from service.formats.rfc3339 import format_time
from service.formats.sensor import GivenLane
from service.storage.rows import LaneChangeRow, LaneMapRow
from service.traffic.identity import IdentityParameters, MapDifference, difference
from service.traffic.model import Lane

Point = tuple[float, float]
Source = Literal["learned", "user"]
Mode = Literal["learned", "pinned", "replaced"]
_VERSION = re.compile(r"(\d{1,9})-(\d{1,9})")


class LaneReply(BaseModel):
    """One lane: lines in driving direction, in the plan frame (x right, y forward)."""

    lane_id: str
    index: int = Field(description="as in the `lane` of tracks and states")
    name: str | None = Field(description="given by a user")
    kind: Literal["lane", "turn"] = Field(description="turn: a way through a junction")
    direction: Literal["approaching", "receding", "crossing"]
    points_m: list[Point] = Field(description="centre line")
    width_m: list[float] = Field(description="one a point of the centre line")
    left_m: list[Point] = Field(description="boundary to the left")
    right_m: list[Point]
    length_m: float
    confidence: float
    vehicles: int = Field(description="whose paths the lane was learned from")
    coordinates: list[Point] | None = Field(
        description="centre line as longitude and latitude (WGS84); null where the sensor has no position"
    )


class LaneMapReply(BaseModel):
    """The lanes of a sensor from a moment on; no lanes and no version while they are not known."""

    sensor_id: str
    version: str | None = Field(description="<epoch>-<number>; crossings and changes name the number")
    since: str | None
    frame: int | None
    vehicles: int = Field(description="whose paths the map was learned from")
    source: Source | None
    mode: Mode = Field(description="where the next map comes from: traffic, or what a user put into force")
    accepted: bool = Field(description="a user found this version right")
    lanes: list[LaneReply]


class MapChange(BaseModel):
    """What a map has that the one before has not."""

    added: list[str]
    removed: list[str]
    moved_m: dict[str, float] = Field(description="the largest shift of each lane that moved")
    longer_m: dict[str, float] = Field(description="by how much a lane became longer")


class LaneVersionReply(BaseModel):
    """One version of the lane map, without its lines."""

    version: str
    since: str
    frame: int
    vehicles: int
    source: Source
    lanes: int
    turns: int
    change: MapChange = Field(description="against the version before; the first: against none")


class LaneControlInput(BaseModel):
    """What to do with the lane map.

    accept: note that a version is right. pin: keep a version in force. replace: put these lanes into force.
    learn: go on learning. Names may be given with any of them, or alone (rename).
    """

    action: Literal["accept", "pin", "replace", "learn", "rename"]
    version: str | None = Field(None, description="of accept and pin; the newest without it")
    lanes: Annotated[list[GivenLane], Field(max_length=255)] = []
    names: dict[str, str | None] = Field({}, description="lane_id -> name; null takes a name away")


class LaneChangeReply(BaseModel):
    """A vehicle that went from one lane into another."""

    timestamp: str = Field(description="when its centre crossed the boundary")
    decided_at: str = Field(description="when that was sure")
    track_id: str
    from_lane: str
    to_lane: str
    x_m: float
    y_m: float
    speed_mps: float
    map_version: str

    @classmethod
    def of(cls, row: LaneChangeRow) -> LaneChangeReply:
        """Return the reply for a stored change."""
        return cls(
            timestamp=format_time(row.time_us),
            decided_at=format_time(row.decided_us),
            track_id=str(row.key),
            from_lane=f"L{row.from_lane}",
            to_lane=f"L{row.to_lane}",
            x_m=round(row.x_m, 3),
            y_m=round(row.y_m, 3),
            speed_mps=round(row.speed_mps, 3),
            map_version=f"{row.key.epoch}-{row.map_version}",
        )


def version_text(row: LaneMapRow) -> str:
    """Return the public name of a version."""
    return f"{row.epoch}-{row.version}"


def read_version(text: str, pointer: str = "/version") -> tuple[int, int]:
    """Return epoch and number of a version's name; raises InvalidInput."""
    found = _VERSION.fullmatch(text)
    if found is None:
        raise InvalidInput.at(pointer, f"want <epoch>-<number> such as 1-3, got {text[:40]!r}")
    return int(found[1]), int(found[2])


def lane_reply(lane: LaneRecord, names: Mapping[str, str], pose: Pose | None) -> LaneReply:
    """Return the reply for one lane."""
    coordinates = None
    if pose is not None:
        points = np.array(lane.points_m, dtype=np.float64)
        longitude, latitude = to_wgs84(pose, points[:, 0], points[:, 1])
        coordinates = list(zip(longitude.tolist(), latitude.tolist(), strict=True))
    return LaneReply.model_validate(lane_fields(lane, names) | {"coordinates": coordinates})


def version_reply(row: LaneMapRow, before: LaneMapRow | None) -> LaneVersionReply:
    """Return the reply for a version, compared with the one before."""
    lanes = read_lanes_json(row.lanes)
    return LaneVersionReply(
        version=version_text(row),
        since=format_time(row.time_us),
        frame=row.frame,
        vehicles=row.vehicles,
        source="user" if row.source == "user" else "learned",
        lanes=sum(lane.kind == "lane" for lane in lanes),
        turns=sum(lane.kind == "turn" for lane in lanes),
        change=_change(difference(_lanes(before), _lanes(row), IdentityParameters())),
    )


def _change(found: MapDifference) -> MapChange:
    return MapChange(
        added=[f"L{index}" for index in found.added],
        removed=[f"L{index}" for index in found.removed],
        moved_m={f"L{index}": round(shift, 2) for index, shift in found.moved},
        longer_m={f"L{index}": round(longer, 1) for index, longer in found.resized},
    )


def _lanes(row: LaneMapRow | None) -> list[Lane]:
    """Return what a comparison needs of a map's lanes."""
    return [
        Lane(
            index=lane.index,
            lane_id=lane.lane_id,
            kind="turn" if lane.kind == "turn" else "lane",
            direction="crossing",
            points_m=np.array(lane.points_m, dtype=np.float64),
            width_m=np.array(lane.width_m, dtype=np.float64),
            confidence=lane.confidence,
            vehicles=lane.vehicles,
        )
        for lane in (read_lanes_json(row.lanes) if row is not None else ())
    ]
