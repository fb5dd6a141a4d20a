"""Lanes as the log's rows, the files and the API have them: plain JSON in the plan frame, and GeoJSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from service.formats.georeference import Pose, to_wgs84

_CENTIMETRE = 2  # decimals


@dataclass(frozen=True, slots=True)
class LaneRecord:
    """One lane of a map, as plain values; points in driving direction, in the plan frame."""

    index: int
    lane_id: str
    kind: str  # lane, turn
    direction: str  # approaching, receding, crossing
    points_m: tuple[tuple[float, float], ...]
    width_m: tuple[float, ...]  # one a point
    confidence: float
    vehicles: int


def lanes_json(lanes: Iterable[LaneRecord]) -> str:
    """Return lanes as one line of JSON, the same for the same lanes; centimetres are enough for a lane."""
    return json.dumps([_plain(lane) for lane in lanes], sort_keys=True, separators=(",", ":"))


def read_lanes_json(text: str) -> tuple[LaneRecord, ...]:
    """Return the lanes that `lanes_json` wrote."""
    return tuple(
        LaneRecord(
            index=int(item["index"]),
            lane_id=str(item["lane_id"]),
            kind=str(item["kind"]),
            direction=str(item["direction"]),
            points_m=tuple((float(x), float(y)) for x, y in item["points_m"]),
            width_m=tuple(float(width) for width in item["width_m"]),
            confidence=float(item["confidence"]),
            vehicles=int(item["vehicles"]),
        )
        for item in json.loads(text)
    )


def lane_fields(lane: LaneRecord, names: Mapping[str, str]) -> dict[str, object]:
    """Return a lane as the API and lanes.json give it, with its line also as `points` for other readers."""
    return {
        "lane_id": lane.lane_id,
        "index": lane.index,
        "name": names.get(lane.lane_id),
        "kind": lane.kind,
        "direction": lane.direction,
        "points_m": [list(point) for point in lane.points_m],
        "width_m": list(lane.width_m),
        "left_m": _boundary(lane, -0.5),
        "right_m": _boundary(lane, 0.5),
        "length_m": round(_length_m(lane), _CENTIMETRE),
        "confidence": round(lane.confidence, 3),
        "vehicles": lane.vehicles,
    }


def lanes_geojson(lanes: Sequence[LaneRecord], pose: Pose, names: Mapping[str, str]) -> dict[str, object]:
    """Return a FeatureCollection (RFC 7946: WGS84, longitude first) of centre lines in driving direction."""
    features = []
    for lane in lanes:
        points = np.array(lane.points_m, dtype=np.float64)
        longitude, latitude = to_wgs84(pose, points[:, 0], points[:, 1])
        about = lane_fields(lane, names)
        for name in ("points_m", "left_m", "right_m"):
            del about[name]
        features.append(
            {
                "type": "Feature",
                "id": lane.lane_id,
                "geometry": {
                    "type": "LineString",
                    "coordinates": [
                        list(pair) for pair in zip(longitude.tolist(), latitude.tolist(), strict=True)
                    ],
                },
                "properties": about,
            }
        )
    return {"type": "FeatureCollection", "features": features}


def _plain(lane: LaneRecord) -> dict[str, object]:
    return {
        "index": lane.index,
        "lane_id": lane.lane_id,
        "kind": lane.kind,
        "direction": lane.direction,
        "points_m": [list(point) for point in lane.points_m],
        "width_m": list(lane.width_m),
        "confidence": round(lane.confidence, 3),
        "vehicles": lane.vehicles,
    }


def rounded_points(
    points_m: np.ndarray[tuple[int, int], np.dtype[np.float64]],
) -> tuple[tuple[float, float], ...]:
    """Return points (P, 2) in centimetres, without negative zero."""
    return tuple((x, y) for x, y in (np.round(points_m, _CENTIMETRE) + 0.0).tolist())


def _length_m(lane: LaneRecord) -> float:
    return float(np.hypot(*np.diff(np.array(lane.points_m), axis=0).T).sum())


def _boundary(lane: LaneRecord, share: float) -> list[list[float]]:
    """Return the line at a share of the width to the right of the middle."""
    points = np.array(lane.points_m, dtype=np.float64)
    step = np.gradient(points, axis=0)
    size = np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-9)
    right = np.column_stack([step[:, 1], -step[:, 0]]) / size[:, None]
    moved = points + share * np.array(lane.width_m)[:, None] * right
    return [list(point) for point in rounded_points(moved)]
