"""Let the simulated radar look at the true vehicles of a scene directory, beside the scene's own radar."""

from __future__ import annotations

import dataclasses
import gzip
import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from service.formats.sensor import SensorConfig
from service.simulation.radar import Radar, RadarParameters
from service.simulation.roads import SHOULDER_M
from service.simulation.scenery import Scenery, assemble
from service.simulation.statistics import Sightings
from service.simulation.trajectories import TrajectorySampler, read_scene_truth
from service.simulation.vehicles import VehicleStates
from service.tracking.model import F64, I64

RAIL_CLEARANCE_M = 0.3  # of a post from the edge of any lane
POST_STEP = 2  # every second point of a centre line: 4 m
POLE_STEP = 9  # every ninth post: 36 m


def compare_scene(directory: Path, *, seed: int) -> tuple[Sightings, Sightings]:
    """Return how the scene's radar saw its vehicles, and how ours sees the same ones in the same frames."""
    config = SensorConfig.model_validate_json((directory / "site.json").read_bytes())
    truth = read_scene_truth(directory / "truth.csv.gz", config.rate_hz)
    frame = np.rint(truth.time_s * config.rate_hz).astype(np.int64)
    points = _recorded_points(directory, frame, truth.vehicle_id)
    recorded = Sightings(
        frame,
        truth.vehicle_id,
        truth.kind,
        np.hypot(truth.x_m, truth.y_m),
        np.arctan2(truth.x_m, truth.y_m),
        points,
    )
    rng = np.random.default_rng(seed)
    lanes = json.loads((directory / "road_truth.json").read_bytes())["lanes"]
    radar = Radar(_parameters(config), _scenery(lanes, rng), rng)
    sampler = TrajectorySampler(truth)
    frames = np.unique(frame)
    seen = []
    for number in frames.tolist():
        vehicles = sampler.states_at(number / config.rate_hz)
        seen.append(sightings(number, vehicles, radar.observe(vehicles, 1 / config.rate_hz).points))
    return recorded, join(seen)


def sightings(frame: int, vehicles: VehicleStates, points: I64) -> Sightings:
    """Return the rows of one frame."""
    return Sightings(
        np.full(len(vehicles), frame),
        vehicles.vehicle_id,
        vehicles.kind,
        vehicles.ground_range_m(),
        vehicles.azimuth_rad(),
        points,
    )


def join(parts: Sequence[Sightings], *, same_vehicles: bool = True) -> Sightings:
    """Return all rows as one; with other vehicles in each part, ids are kept apart."""
    names = [f.name for f in dataclasses.fields(Sightings)]
    columns = {n: np.concatenate([getattr(part, n) for part in parts]) for n in names}
    if not same_vehicles:
        part_of_row = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        columns["vehicle_id"] = columns["vehicle_id"] + part_of_row * (int(columns["vehicle_id"].max()) + 1)
    return Sightings(**columns)


def _recorded_points(directory: Path, frame: I64, vehicle_id: I64) -> I64:
    """Return how many detections of its frame the labels give to each vehicle."""
    sources: dict[int, list[int]] = {}
    with gzip.open(directory / "labels.jsonl.gz", "rt", encoding="utf-8") as lines:
        for line in lines:
            row = json.loads(line)
            sources[row["frame"]] = row["src"]
    pairs = zip(frame.tolist(), vehicle_id.tolist(), strict=True)
    return np.array([sources[f].count(v) for f, v in pairs])


def _parameters(config: SensorConfig) -> RadarParameters:
    return RadarParameters(
        rate_hz=config.rate_hz,
        mount_height_m=config.mount_height_m,
        scatter_height_m=config.scatter_height_m,
        range_resolution_m=config.resolution.range_m,
        velocity_resolution_mps=config.resolution.velocity_mps,
        azimuth_resolution_rad=math.radians(config.resolution.azimuth_deg),
        threshold_db=config.detection_threshold_db,
    )


def _scenery(lanes: Sequence[dict[str, object]], rng: np.random.Generator) -> Scenery:
    """Return rails beside the outer lanes, with poles at some of their posts."""
    lines = [np.asarray(lane["points"], dtype=np.float64) for lane in lanes]
    half = [float(str(lane["width_m"])) / 2 for lane in lanes]
    everywhere = np.concatenate(lines)
    clear = np.concatenate([np.full(len(p), h + RAIL_CLEARANCE_M) for p, h in zip(lines, half, strict=True)])
    rails = []
    for points, h in zip(lines, half, strict=True):
        for side in (-1, 1):
            posts = _beside(points, side * (h + SHOULDER_M))[::POST_STEP]
            gap = np.hypot(*(posts[:, None, :] - everywhere[None, :, :]).transpose(2, 0, 1))
            posts = posts[(gap > clear[None, :]).all(axis=1)]
            if len(posts) > 1:
                rails.append(posts)
    poles = np.concatenate([np.zeros((0, 2)), *[rail[::POLE_STEP] for rail in rails]])
    return assemble(rails, poles, everywhere[rng.integers(0, len(everywhere), 3)], rng)


def _beside(points: F64, offset_m: float) -> F64:
    """Return the polyline moved to the right of its direction."""
    along = np.gradient(points, axis=0)
    along /= np.hypot(along[:, 0], along[:, 1])[:, None]
    return points + offset_m * np.stack([along[:, 1], -along[:, 0]], axis=1)
