"""Write a simulated scene as a directory: site, frames, truth, labels and the true road, gzip where long.

Equal seeds give equal bytes: numbers are rounded as a sensor writes them, gzip headers carry no time.
"""

from __future__ import annotations

import csv
import gzip
import io
import json
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from service.formats.rfc3339 import format_time
from service.simulation.frames import (
    AZIMUTH_DECIMALS,
    RANGE_DECIMALS,
    SNR_DECIMALS,
    VELOCITY_DECIMALS,
    SimulatedFrame,
)
from service.simulation.road_truth import (
    Json,
    count_by_lane,
    crossings,
    in_truth,
    lane_changes,
    lane_truth,
    line_id,
    paths_of,
)
from service.simulation.scenario import SENSOR_ID, START_US, Scenario, scenario_named, simulate
from service.simulation.vehicles import VehicleKind
from service.tracking.model import Frame

REGION_MARGIN_M = (2.0, 5.0)  # by which the region is inside the radar's range limits
REGION_MARGIN_DEG = 5.0
COMPRESSION = 6  # nine costs three times the time for 2 % less
TRUTH_HEADER = "frame,time,id,class,x,y,vx,vy,heading_deg,length,width,lane,n_det,visible"

Progress = Callable[[int, int], None]  # frames done, frames in all


def write_scene(
    scenario_name: str,
    out_dir: Path,
    *,
    seed: int,
    duration_s: float | None = None,
    progress: Progress | None = None,
) -> Json:
    """Simulate a scenario into `out_dir` (made when absent) and return what is in it.

    Without `duration_s` the scenario's own. Raises NotFound for an unknown scenario.
    """
    scenario = scenario_named(scenario_name)
    length_s = scenario.duration_s if duration_s is None else duration_s
    total = round(length_s * scenario.radar.rate_hz)
    frames = []
    for simulated in simulate(scenario, seed=seed, duration_s=length_s):
        frames.append(simulated)
        if progress is not None:
            progress(min((simulated.frame.sequence or 0) + 1, total - 1), total)
    out_dir.mkdir(parents=True, exist_ok=True)
    road = _road_truth(scenario, frames)
    _write_text(out_dir / "site.json", json.dumps(site(scenario, length_s), indent=1) + "\n")
    _write_text(out_dir / "road_truth.json", _one_row_a_line(road))
    _write_gzip(out_dir / "frames.jsonl.gz", (_compact(frame_row(f.frame)) for f in frames))
    _write_gzip(out_dir / "labels.jsonl.gz", (_compact(_label_row(f)) for f in frames))
    _write_gzip(out_dir / "truth.csv.gz", [TRUTH_HEADER, *_truth_lines(scenario, frames)])
    if progress is not None:
        progress(total, total)  # also when the last frames were dropped
    return _summary(scenario, seed, length_s, frames, road)


def site(scenario: Scenario, duration_s: float) -> Json:
    """Return what an installer would know of the scenario's radar: SITE.json of `wayside track`."""
    p = scenario.radar
    return {
        "scene": scenario.name,
        "kind": scenario.kind,
        "sensor_id": SENSOR_ID,
        "rate_hz": p.rate_hz,
        "duration_s": duration_s,
        "mount_height_m": p.mount_height_m,
        "scatter_height_m": p.scatter_height_m,
        "azimuth_offset_deg": round(0.0 - math.degrees(p.azimuth_bias_rad), 6),
        "region": {
            "range_min_m": p.range_min_m + REGION_MARGIN_M[0],
            "range_max_m": p.range_max_m - REGION_MARGIN_M[1],
            "azimuth_max_deg": round(math.degrees(p.azimuth_max_rad) - REGION_MARGIN_DEG, 6),
        },
        "resolution": {
            "range_m": p.range_resolution_m,
            "velocity_mps": p.velocity_resolution_mps,
            "azimuth_deg": round(math.degrees(p.azimuth_resolution_rad), 6),
        },
        "noise_std": {
            "range_m": p.range_std_m,
            "velocity_mps": p.velocity_std_mps,
            "azimuth_deg": round(math.degrees(p.azimuth_std_rad), 6),
            "azimuth_floor_deg": round(math.degrees(p.azimuth_floor_rad), 6),
            "at_snr_db": p.noise_snr_db,
        },
        "detection_threshold_db": p.threshold_db,
        "count_lines": [
            {"line_id": line_id(s), "p0": ends[0], "p1": ends[1]}
            for s in scenario.road.count_lines_m
            for ends in [np.round(scenario.road.count_line(s), 2).tolist()]
        ],
    }


def frame_row(frame: Frame) -> Json:
    """Return the frame as a row-wise polar JSON object, rounded as a sensor writes it."""
    columns = (
        _rounded(frame.range_m, RANGE_DECIMALS),
        _rounded(np.degrees(frame.azimuth_rad.astype(np.float64)), AZIMUTH_DECIMALS),
        _rounded(frame.radial_velocity_mps, VELOCITY_DECIMALS),
        _rounded(frame.snr_db, SNR_DECIMALS),
    )
    names = ("range_m", "azimuth_deg", "radial_velocity_mps", "snr_db")
    return {
        "sensor_id": frame.sensor_id,
        "timestamp": format_time(frame.time_us),
        "frame": frame.sequence,
        "detections": [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)],
    }


def _rounded(column: np.ndarray[tuple[int], np.dtype[np.floating]], decimals: int) -> list[float]:
    return [v + 0.0 for v in np.round(column.astype(np.float64), decimals).tolist()]  # + 0.0: no minus zero


def _label_row(simulated: SimulatedFrame) -> Json:
    return {"frame": simulated.frame.sequence, "src": simulated.source.tolist()}


def _truth_lines(scenario: Scenario, frames: Sequence[SimulatedFrame]) -> list[str]:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    lanes = [lane.lane_id for lane in scenario.road.lanes]
    for f in frames:
        time = format_time(f.frame.time_us)[11:-1]
        v = f.vehicles
        for i in np.flatnonzero(in_truth(v.x_m, v.y_m, scenario.radar.azimuth_max_rad)):
            place = [f"{q[i]:.2f}" for q in (v.x_m, v.y_m, v.vx_mps, v.vy_mps)]
            heading = f"{math.degrees(v.heading_rad[i]) % 360:.1f}"
            box = [heading, float(v.length_m[i]), float(v.width_m[i]), lanes[v.lane[i]]]
            label = VehicleKind(v.kind[i]).label
            seen = [f.points[i], f"{f.visible[i]:.1f}"]
            writer.writerow([f.frame.sequence, time, v.vehicle_id[i], label, *place, *box, *seen])
    return text.getvalue().splitlines()


def _road_truth(scenario: Scenario, frames: Sequence[SimulatedFrame]) -> dict[str, list[Json] | Json]:
    paths = paths_of(frames, START_US)
    crossed = crossings(scenario.road, paths, START_US)
    return {
        "lanes": lane_truth(scenario.road, scenario.radar.azimuth_max_rad),
        "crossings": crossed,
        "lane_changes": lane_changes(scenario.road, paths, START_US),
        "counts": dict(count_by_lane(crossed)),
    }


def _one_row_a_line(road: dict[str, list[Json] | Json]) -> str:
    parts = []
    for name, value in road.items():
        if isinstance(value, list):
            parts.append(f' "{name}": [\n  ' + ",\n  ".join(_compact(row) for row in value) + "\n ]")
        else:
            parts.append(f' "{name}": {_compact(value)}')
    return "{\n" + ",\n".join(parts) + "\n}\n"


def _compact(value: Json) -> str:
    return json.dumps(value, separators=(",", ":"))


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def _write_gzip(path: Path, lines: Iterable[str]) -> None:
    with path.open("wb") as raw, gzip.GzipFile("", "wb", COMPRESSION, raw, mtime=0) as packed:
        for line in lines:
            packed.write(line.encode() + b"\n")


def _summary(
    scenario: Scenario,
    seed: int,
    duration_s: float,
    frames: Sequence[SimulatedFrame],
    road: dict[str, list[Json] | Json],
) -> Json:
    limit = scenario.radar.azimuth_max_rad
    shown = [int(in_truth(f.vehicles.x_m, f.vehicles.y_m, limit).sum()) for f in frames]
    return {
        "scenario": scenario.name,
        "seed": seed,
        "duration_s": duration_s,
        "frames": len(frames),
        "detections": sum(len(f.frame) for f in frames),
        "vehicles_per_frame": round(float(np.mean(shown)), 1) if shown else 0.0,
        "vehicles_at_once": max(shown, default=0),
        "crossings": len(road["crossings"]),
        "lane_changes": len(road["lane_changes"]),
    }
