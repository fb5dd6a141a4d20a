"""Write the lanes and lane changes that a recording tells of into the folder of its results."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import orjson

from service.cli.output import json_text
from service.formats.georeference import pose_of
from service.formats.lanes import lane_fields, lanes_geojson

if TYPE_CHECKING:
    from service.formats.sensor import SensorConfig
    from service.storage.rows import LaneChangeRow
    from service.traffic.model import LaneMap


def write_lanes(folder: Path, config: SensorConfig, lane_map: LaneMap) -> dict[str, object]:
    """Write lanes.json and lanes.geojson; return counts.

    lane_map: what the whole recording tells of. The lanes in tracks.jsonl are of the map that was in force at
    the time, which had seen less; a lane has the same number in both.
    """
    from service.pipeline.traffic_rows import lane_record

    lanes = [lane_record(lane) for lane in lane_map.lanes]
    names = config.lanes.names
    fields = [lane_fields(lane, names) | {"points": [list(p) for p in lane.points_m]} for lane in lanes]
    through = [lane for lane in fields if lane["kind"] == "lane"]
    turns = [lane for lane in fields if lane["kind"] == "turn"]
    content = {
        "sensor_id": config.sensor_id,
        "from_version": lane_map.version,
        "vehicles": lane_map.vehicles,
        "lanes": through,
        "turns": turns,
    }
    (folder / "lanes.json").write_text(json_text(content) + "\n")
    pose = pose_of(config)
    places: dict[str, object] = {
        "type": "FeatureCollection",
        "features": [],
    }  # without a position no place on earth is known
    if pose is not None:
        places = lanes_geojson(lanes, pose, names)
    (folder / "lanes.geojson").write_text(json_text(places) + "\n")
    return {"lanes": len(through), "turns": len(turns)}


def change_lines(changes: Iterable[LaneChangeRow]) -> bytes:
    """Return changes.jsonl, by the time of crossing the boundary."""
    from service.api.lane_schemas import LaneChangeReply

    ordered = sorted(changes, key=lambda row: (row.time_us, row.key.epoch, row.key.number))
    return b"".join(orjson.dumps(LaneChangeReply.of(row).model_dump()) + b"\n" for row in ordered)
