"""Compile every kernel of the tracker, or load it from the cache, by tracking a made-up road for a moment.

`python -m service.tracking.warmup` does so from a script.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

from service.tracking import tracker
from service.tracking.model import F64, Frame
from service.tracking.parameters import TrackerParameters

FRAMES = 60  # until tracks are confirmed, contend for points, and standing points are looked at
FRAME_US = 50_000
SPEED_MPS = 12.0
BODY_X_M = np.array([-0.8, 0.0, 0.8, -0.8, 0.8])  # points of one vehicle about its middle
BODY_Y_M = np.array([-2.0, -2.0, -2.0, 1.0, 1.0])
FIRST_X_M = np.array([0.0, 2.4, -3.0])  # the first two side by side, so that they share points
FIRST_Y_M = np.array([90.0, 89.0, 60.0])
POST_X_M, POST_Y_M = np.array([8.0, 8.0]), np.array([30.0, 55.0])


def warm_up(
    parameters: TrackerParameters | None = None, told: Callable[[int, int], None] | None = None
) -> None:
    """Track a made-up road; `told` hears the frames done and in all."""
    chosen = parameters or TrackerParameters()
    state = tracker.initial_state(chosen)
    for number in range(FRAMES):
        frame = _frame(number)
        state, _, _ = tracker.step(state, frame, chosen)
        if told is not None:
            told(number + 1, FRAMES)
    tracker.coast(state, FRAMES * FRAME_US, chosen)


def _frame(number: int) -> Frame:
    """Return three vehicles that approach, and two posts."""
    y_m = FIRST_Y_M - SPEED_MPS * number * FRAME_US / 1e6
    x = np.concatenate([(FIRST_X_M[:, None] + BODY_X_M).ravel(), POST_X_M])
    y = np.concatenate([(y_m[:, None] + BODY_Y_M).ravel(), POST_Y_M])
    speed = np.where(np.arange(len(x)) < len(FIRST_X_M) * len(BODY_X_M), SPEED_MPS, 0.0)
    return _polar(x, y, speed, number)


def _polar(x: F64, y: F64, speed: F64, number: int) -> Frame:
    range_m = np.hypot(x, y)
    return Frame(
        sensor_id="warm-up",
        time_us=number * FRAME_US,
        sequence=number,
        boot_id=None,
        range_m=range_m.astype(np.float32),
        azimuth_rad=np.arctan2(x, y).astype(np.float32),
        radial_velocity_mps=(-speed * y / range_m).astype(np.float32),
        snr_db=np.full(len(x), 20.0, dtype=np.float32),
    )


def main() -> None:
    """Warm up with a line on standard error that says what takes so long the first time."""
    sys.stderr.write("Preparing the tracker (the first time its kernels are compiled: about a minute) ")
    sys.stderr.flush()

    def dot(done: int, total: int) -> None:
        if done in {1, total // 4, total // 2, total}:
            sys.stderr.write(".")
            sys.stderr.flush()

    warm_up(told=dot)
    sys.stderr.write(" ready\n")


if __name__ == "__main__":
    main()
