"""A sensor that runs for long takes no more memory than one that ran for a while."""

from __future__ import annotations

import gc
import sys

import numpy as np
import pytest

from service.formats.sensor import CountLine, SensorConfig
from service.pipeline.fold import start, step
from service.pipeline.records import FrameRecord
from service.tracking import snapshot, tracker
from service.tracking.model import Frame
from tests.pipeline.recordings import START_US

RATE_HZ = 10
PASS_S = 6.0  # of a vehicle through the view
VEHICLES = 4
MINUTE = 60 * RATE_HZ  # frames
PARTS = ("order", "collected", "tracker", "traffic")
CONFIG = SensorConfig(
    sensor_id="radar-1",
    rate_hz=RATE_HZ,
    count_lines=(CountLine(line_id="C60", p0=(-8.0, 60.0), p1=(8.0, 60.0)),),
    # What fills in the first minutes of dense traffic, small enough for two minutes of thin traffic.
    parameters={
        "traffic.evidence.paths": "40",
        "traffic.mapping.young_paths": "20",
        "traffic.mapping.backlog": "20",
    },
)


def frame(k: int) -> Frame:
    """Vehicles that drive away on two lanes, one behind the other, of five points each; again and again."""
    t_s = k / RATE_HZ
    place = np.arange(VEHICLES)
    y = 25.0 + 20.0 * ((t_s + place * PASS_S / VEHICLES) % PASS_S)
    x = np.where(place % 2 == 0, -1.75, 1.75)
    spread = np.array([-1.6, -0.8, 0.0, 0.8, 1.6])
    xs, ys = np.repeat(x, 5) + 0.3 * np.tile(spread, VEHICLES), (y[:, None] + spread).ravel()
    r = np.hypot(xs, ys)
    f = np.float32
    return Frame(
        sensor_id="radar-1",
        time_us=START_US + round(1e6 * t_s),
        sequence=k + 1,
        boot_id=None,
        range_m=r.astype(f),
        azimuth_rad=np.arctan2(xs, ys).astype(f),
        radial_velocity_mps=(20.0 * ys / r).astype(f),
        snr_db=np.full(len(xs), 20.0, f),
    )


def sizes(state) -> list[int]:
    return [len(snapshot.dump(getattr(state, part))) for part in PARTS]


@pytest.mark.slow
def test_the_state_of_a_sensor_is_no_larger_after_twice_the_time():
    state = start("radar-1", 1, CONFIG, tracker, first_position=1)
    largest, blocks, crossings = [], [], 0
    for k in range(6 * MINUTE):
        state, output = step(state, k + 1, FrameRecord(frame(k), 0), tracker)
        crossings += len(output.rows.crossings)
        if k % MINUTE == 0:
            largest.append(sizes(state))
        elif k % RATE_HZ == 0:
            largest[-1] = np.maximum(largest[-1], sizes(state)).tolist()
        if (k + 1) % MINUTE == 0:
            gc.collect()
            blocks.append(sys.getallocatedblocks())

    assert state.traffic.map.lanes
    assert crossings > 0
    assert state.traffic.mapping.evidence.next_path > 160  # four times as many as are kept
    earlier, later = np.max(largest[1:3], axis=0), np.max(largest[4:], axis=0)
    assert (later <= 1.05 * earlier).all(), dict(zip(PARTS, zip(earlier, later, strict=True), strict=True))
    assert blocks[5] - blocks[2] < MINUTE  # far from one object more for each frame of three minutes
