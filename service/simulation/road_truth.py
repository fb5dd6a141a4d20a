"""The true lanes of a simulated road, and what its vehicles did: crossings of lines, lane changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.formats.rfc3339 import format_time
from service.simulation.frames import US, SimulatedFrame
from service.simulation.roads import Lane, Road
from service.simulation.vehicles import VehicleKind
from service.tracking.model import F64, I64, Bool

NEAREST_M, FARTHEST_M = 12.0, 160.0  # ground range of truth rows and lane points
VIEW_MARGIN_RAD = np.radians(5.0)  # beyond the radar's azimuth limit
SIDE_MARGIN_RAD = np.radians(3.0)
SHORTEST_LANE_POINTS = 8
STAY_S = 1.0  # a vehicle that is back sooner did not change lanes
CHANGE_RANGE_M = (15.0, 155.0)
SETTLED_M = 0.4  # from a centre line
LONGEST_CHANGE_S = 6.0  # between the boundary and either end of the manoeuvre

Json = dict[str, object]


@dataclass(frozen=True, slots=True)
class Path:
    """One vehicle through the recording: F rows in time order."""

    vehicle_id: int
    label: str
    time_s: F64
    x_m: F64
    y_m: F64
    speed_mps: F64
    lane: I64


def paths_of(frames: Sequence[SimulatedFrame], start_us: int) -> list[Path]:
    """Return the paths of all vehicles by id."""
    if not frames:
        return []
    times = np.concatenate([np.full(len(f.vehicles), (f.frame.time_us - start_us) / US) for f in frames])

    def column(name: str) -> F64:
        return np.concatenate([getattr(f.vehicles, name) for f in frames])

    ids, kind, lane = (column(n).astype(np.int64) for n in ("vehicle_id", "kind", "lane"))
    x, y, speed = column("x_m"), column("y_m"), np.hypot(column("vx_mps"), column("vy_mps"))
    order = np.argsort(ids, kind="stable")  # rows are in time order already
    blocks = np.split(order, np.flatnonzero(np.diff(ids[order])) + 1) if len(order) else []
    return [
        Path(int(ids[b[0]]), VehicleKind(kind[b[0]]).label, times[b], x[b], y[b], speed[b], lane[b])
        for b in blocks
    ]


def lane_truth(road: Road, azimuth_max_rad: float) -> list[Json]:
    """Return the lanes as far as the radar sees them, with their centre lines in driving direction."""
    rows: list[Json] = []
    for lane in road.lanes:
        points = road.lane_points(lane)
        inside = np.flatnonzero(_in_sight(points[:, 0], points[:, 1], azimuth_max_rad + SIDE_MARGIN_RAD))
        if len(inside) < SHORTEST_LANE_POINTS:
            continue
        points = points[inside[0] : inside[-1] + 1]
        rows.append(
            {
                "lane_id": lane.lane_id,
                "direction": lane.direction_name,
                "kind": "through",
                "width_m": lane.width_m,
                "points": np.round(points, 2).tolist(),
            }
        )
    return rows


def in_truth(x_m: F64, y_m: F64, azimuth_max_rad: float) -> Bool:
    """Return which vehicles are listed in the truth of a scene."""
    return _in_sight(x_m, y_m, azimuth_max_rad + VIEW_MARGIN_RAD)


def _in_sight(x_m: F64, y_m: F64, azimuth_max_rad: float) -> Bool:
    ground = np.hypot(x_m, y_m)
    ranged = (ground > NEAREST_M) & (ground < FARTHEST_M)
    return np.asarray(ranged & (np.abs(np.arctan2(x_m, y_m)) <= azimuth_max_rad))


def line_id(s_m: float) -> str:
    """Return the name of the count line at an arc length."""
    return f"C{s_m:.0f}"


def crossings(road: Road, paths: Sequence[Path], start_us: int) -> list[Json]:
    """Return every crossing of a count line by a centre, in time order."""
    found = []
    for path in paths:
        s, _ = road.locate(path.x_m, path.y_m)
        for at in road.count_lines_m:
            for k in np.flatnonzero((s[:-1] - at) * (s[1:] - at) < 0):
                share = (at - s[k]) / (s[k + 1] - s[k])
                row = _crossing(road, path, int(k), float(share))
                stamp = _timestamp(start_us, float(str(row["t"])))
                found.append({"line_id": line_id(at), "timestamp": stamp, **row})
    return sorted(found, key=_time_of)


def _crossing(road: Road, path: Path, k: int, share: float) -> Json:
    def between(column: F64) -> float:
        return float(column[k] + share * (column[k + 1] - column[k]))

    time_s = round(between(path.time_s), 3)
    return {
        "t": time_s,
        "id": path.vehicle_id,
        "cls": path.label,
        "lane_id": road.lanes[path.lane[k]].lane_id,
        "x": round(between(path.x_m), 2),
        "y": round(between(path.y_m), 2),
        "speed_mps": round(between(path.speed_mps), 2),
    }


def lane_changes(road: Road, paths: Sequence[Path], start_us: int) -> list[Json]:
    """Return every lane change in sight, in time order, with the ends of the manoeuvre as far as recorded."""
    found = []
    for path in paths:
        _, offset = road.locate(path.x_m, path.y_m)
        for k in np.flatnonzero(np.diff(path.lane)) + 1:
            back = np.flatnonzero(path.lane[k:] != path.lane[k])
            until = path.time_s[k + back[0]] if len(back) else np.inf
            ground = float(np.hypot(path.x_m[k], path.y_m[k]))
            in_range = CHANGE_RANGE_M[0] < ground < CHANGE_RANGE_M[1] and path.y_m[k] > 0
            if in_range and until - path.time_s[k] >= STAY_S:
                found.append(_lane_change(road, path, int(k), offset, start_us))
    return sorted(found, key=_time_of)


def _lane_change(road: Road, path: Path, k: int, offset: F64, start_us: int) -> Json:
    old, new = road.lanes[path.lane[k - 1]], road.lanes[path.lane[k]]
    first, last = _manoeuvre(path, k, offset, old, new)
    time_s = round(float(path.time_s[k]), 3)
    return {
        "id": path.vehicle_id,
        "t": time_s,
        "timestamp": _timestamp(start_us, time_s),
        "t_start": round(float(path.time_s[first]), 3),
        "t_end": round(float(path.time_s[last]), 3),
        "from_lane": old.lane_id,
        "to_lane": new.lane_id,
        "x": round(float(path.x_m[k]), 2),
        "y": round(float(path.y_m[k]), 2),
    }


def _manoeuvre(path: Path, k: int, offset: F64, old: Lane, new: Lane) -> tuple[int, int]:
    """Return the rows where the centre leaves the old centre line and reaches the new one."""
    since = np.searchsorted(path.time_s, path.time_s[k] - LONGEST_CHANGE_S)
    settled = np.flatnonzero(np.abs(offset[since:k] - old.offset_m) <= SETTLED_M)
    first = since + settled[-1] if len(settled) else since
    until = np.searchsorted(path.time_s, path.time_s[k] + LONGEST_CHANGE_S, side="right") - 1
    settled = np.flatnonzero(np.abs(offset[k : until + 1] - new.offset_m) <= SETTLED_M)
    return int(first), int(k + settled[0] if len(settled) else until)


def count_by_lane(crossed: Sequence[Json]) -> dict[str, dict[str, int]]:
    """Return the number of crossings of each line and lane."""
    counts: dict[str, dict[str, int]] = {}
    for row in crossed:
        line = counts.setdefault(str(row["line_id"]), {})
        line[str(row["lane_id"])] = line.get(str(row["lane_id"]), 0) + 1
    return counts


def _time_of(row: Json) -> float:
    return float(str(row["t"]))


def _timestamp(start_us: int, time_s: float) -> str:
    return format_time(start_us + round(time_s * US))
