"""Frames of two radars in batches, with everything that a stream of frames can do wrong in it."""

from __future__ import annotations

import random
from dataclasses import dataclass

import numpy as np

from service.formats.sensor import CountLine, SensorConfig
from service.tracking.model import Frame

START_US = 1_747_029_600_000_000  # 2025-05-12T06:00:00Z
PERIOD_US = 50_000
BATCH_MOST = 6
HOUR_US = 3_600_000_000
SENSORS = ("radar-1", "radar-2")
POINTS_OF_A_VEHICLE = 5
VEHICLES = 4


@dataclass(frozen=True, slots=True)
class Batch:
    """What is posted at once."""

    sensor_id: str
    frames: tuple[Frame, ...]


def configs() -> list[SensorConfig]:
    """Return the radars of the workload."""
    lines = tuple(CountLine(line_id=f"C{y}", p0=(-8.0, y), p1=(8.0, y)) for y in (50.0, 80.0, 110.0))
    return [SensorConfig(sensor_id=sensor_id, count_lines=lines) for sensor_id in SENSORS]


def batches(frames: int, seed: int) -> list[Batch]:
    """Return `frames` frames of each radar as they are posted: equal arguments give equal bytes."""
    rng = random.Random(seed)  # noqa: S311 - no secret
    waiting = {sensor_id: recording(sensor_id, frames, seed) for sensor_id in SENSORS}
    made: list[Batch] = []
    while any(waiting.values()):
        sensor_id = rng.choice([name for name, rest in waiting.items() if rest])
        count = rng.randint(1, BATCH_MOST)
        made.append(Batch(sensor_id, tuple(waiting[sensor_id][:count])))
        waiting[sensor_id] = waiting[sensor_id][count:]
    return made


def recording(sensor_id: str, count: int, seed: int) -> list[Frame]:
    """Return frames with a gap, a swap, a repeat, a silence, a reboot and a clock that is set back."""
    rng = np.random.default_rng((seed, SENSORS.index(sensor_id)))
    speed_mps, lane_m = rng.uniform(9.0, 15.0, VEHICLES), 3.5 * np.arange(VEHICLES) - 5.0
    start_m = rng.uniform(30.0, 60.0, VEHICLES)
    made: list[Frame] = []
    for k in range(count):
        late_us = 3_300_000 if k >= count // 2 else 0  # a silence: ticks end what was there
        set_back_us = HOUR_US if k >= 3 * count // 4 else 0
        number = k + 1 if k < 5 * count // 8 else k + 1 - 5 * count // 8  # a reboot: it counts from 1 again
        time_us = START_US + k * PERIOD_US + late_us - set_back_us
        at_s = k * PERIOD_US / 1e6
        made.append(_frame(sensor_id, time_us, number, start_m + speed_mps * at_s, lane_m, speed_mps, rng))
    swap, gap, repeat = count // 6, count // 4, count // 3
    made[swap], made[swap + 1] = made[swap + 1], made[swap]
    made.insert(repeat, made[repeat - 2])
    return made[:gap] + made[gap + 2 :]


def _frame(  # noqa: PLR0913, PLR0917 - the columns of a picture
    sensor_id: str,
    time_us: int,
    number: int,
    y_m: np.ndarray,
    x_m: np.ndarray,
    speed_mps: np.ndarray,
    rng: np.random.Generator,
) -> Frame:
    count = POINTS_OF_A_VEHICLE * len(y_m)
    x = np.repeat(x_m, POINTS_OF_A_VEHICLE) + rng.uniform(-0.7, 0.7, count)
    y = 25.0 + (np.repeat(y_m, POINTS_OF_A_VEHICLE) - 25.0 + rng.uniform(-1.8, 1.8, count)) % 115.0
    distance = np.hypot(x, y)
    columns = (
        distance,
        np.arctan2(x, y),
        np.repeat(speed_mps, POINTS_OF_A_VEHICLE) * y / distance,
        rng.uniform(14.0, 26.0, count),
    )
    return Frame(sensor_id, time_us, number, None, *(column.astype(np.float32) for column in columns))
