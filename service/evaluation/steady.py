"""Make frames of a steady road: so many vehicles on parallel lanes, each giving the same few points.

Vehicles drive towards the radar, leave at the near end and enter at the far end, so that the load never
changes. Equal arguments give equal frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, Frame
from service.tracking.parameters import SensorModel

NEAR_M, FAR_M = 20.0, 150.0
_LANE_WIDTH_M = 3.5
_ROOM_M = 10.0  # road that one vehicle needs at the least
_SLOW_MPS, _FAST_MPS = 12.0, 20.0  # speeds of the first and the last lane
_POINTS = np.array(
    [[-0.7, 0.1], [0.0, 0.0], [0.7, 0.1], [0.9, 2.0]]
)  # x, y [m] from the middle of the near face
_SNR_DB = (15.0, 25.0)
_START_US = 1_700_000_000_000_000


@dataclass(frozen=True, slots=True)
class Load:
    """How many vehicles there are, and how many points in every frame."""

    vehicles: int
    points: int

    @property
    def clutter(self) -> int:
        """Return the points that come from no vehicle."""
        return self.points - len(_POINTS) * self.vehicles


def steady_frames(load: Load, frames: int, sensor: SensorModel, rng: np.random.Generator) -> list[Frame]:
    """Return `frames` frames at the sensor's rate; half of the clutter stands still, half is random.

    Raises ValueError when the points are too few for the vehicles.
    """
    if load.clutter < 0:
        raise ValueError(f"{load.points} points are too few for {load.vehicles} vehicles of {len(_POINTS)}")
    per_lane = int((FAR_M - NEAR_M) // _ROOM_M)
    lanes = math.ceil(load.vehicles / per_lane)
    lane = np.arange(load.vehicles) % lanes
    place = np.arange(load.vehicles) // lanes
    speed = _SLOW_MPS + (_FAST_MPS - _SLOW_MPS) * lane / max(1, lanes - 1)
    x = (lane - (lanes - 1) / 2) * _LANE_WIDTH_M
    y0 = NEAR_M + (FAR_M - NEAR_M) * (place + 0.37 * lane) / math.ceil(load.vehicles / lanes)
    posts = _scattered(load.clutter // 2, rng)
    out: list[Frame] = []
    for k in range(frames):
        y = NEAR_M + np.mod(y0 - NEAR_M - speed * k / sensor.rate_hz, FAR_M - NEAR_M)
        face = np.stack([x, y], axis=1)[:, None, :] + _POINTS
        alarms = _scattered(load.clutter - len(posts), rng)
        points = np.concatenate([face.reshape(-1, 2), posts, alarms])
        velocity = np.zeros((len(points), 2))
        velocity[: face.shape[0] * face.shape[1], 1] = -np.repeat(speed, len(_POINTS))
        out.append(_observe(points, velocity, k, sensor, rng))
    return out


def _scattered(count: int, rng: np.random.Generator) -> F64:
    """Return points anywhere in view, (count, 2) metres."""
    ground = rng.uniform(NEAR_M, FAR_M, count)
    azimuth = rng.uniform(-0.5, 0.5, count)
    return np.stack([ground * np.sin(azimuth), ground * np.cos(azimuth)], axis=1)


def _observe(
    points_m: F64, velocity_mps: F64, index: int, sensor: SensorModel, rng: np.random.Generator
) -> Frame:
    """Return the points as the radar measures them, with its noise, sorted by range."""
    count = len(points_m)
    ground = np.hypot(points_m[:, 0], points_m[:, 1])
    slant = np.hypot(ground, sensor.mount_height_m - sensor.scatter_height_m)
    closing = np.sum(points_m * velocity_mps, axis=1) / slant
    azimuth = np.arctan2(points_m[:, 0], points_m[:, 1]) - sensor.azimuth_offset_rad
    range_m = slant + rng.normal(0.0, sensor.range_std_m, count)
    order = np.argsort(range_m)
    columns = (
        range_m,
        azimuth + rng.normal(0.0, sensor.azimuth_std_rad, count),
        closing + rng.normal(0.0, sensor.velocity_std_mps, count),
        rng.uniform(*_SNR_DB, count),
    )
    time_us = _START_US + round(index * 1e6 / sensor.rate_hz)
    return Frame("radar-1", time_us, index + 1, None, *(c[order].astype(np.float32) for c in columns))
