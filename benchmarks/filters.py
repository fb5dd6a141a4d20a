"""Time the filters: predict + expected + update of a bank, in microseconds and 6x6 products.

    OMP_NUM_THREADS=1 python -m benchmarks.filters [--seed N] [--repeats N] [--measurements J]

Times are of the processor, so that other programs count little; the unit is one numpy 6x6 product measured
in the same run, which takes out most of what a slow machine adds. Each figure is the least of some means over
repeats: other load only ever adds. The last column tells whether the bar is reached.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from service.tracking.filters.base import Filter, FilterState
from service.tracking.filters.registry import filter_names, make_filter
from service.tracking.measurement import predict_measurement

F64 = NDArray[np.float64]

PERIOD_S = 0.05
STD = np.array([0.15, math.radians(0.3), 0.1])
R = np.diag(STD**2)
WARM_UP_STEPS = 15  # beyond the first measurements of a track, which search no softening factor
BANKS = (1, 20, 64)
ROUNDS = 9
CHEAP = {"astekf", "ekf", "ukf"}
BAR_TRACKS = 64  # the bank for which there are bars: microseconds a track and step, on a quiet core
BAR_US, CHEAP_BAR_US = 60.0, 25.0


def seconds(call: Callable[[], object], repeats: int) -> float:
    """Return the least of some means of the processor's time of a call."""
    means = []
    for _ in range(ROUNDS):
        start = time.process_time()
        for _ in range(repeats):
            call()
        means.append((time.process_time() - start) / repeats)
    return min(means)


Scan = tuple[F64, F64, F64, F64]  # z, R, beta, miss of `Filter.update`


def step(chosen: Filter, state: FilterState, scan: Scan) -> FilterState:
    """Do for a bank what the tracker does each frame."""
    prediction = chosen.predict(state, PERIOD_S)
    chosen.expected(prediction)
    return chosen.update(prediction, *scan)


def scene(chosen: Filter, tracks: int, many: int, rng: np.random.Generator) -> tuple[FilterState, Scan]:
    """Return tracks that have been followed for a while, and the measurements of their next frame."""
    mean = rng.normal([-5, 0, 0, 90, -12, 0], [4, 1, 0, 25, 4, 0], (tracks, 6))
    state = chosen.start(mean, np.broadcast_to(np.diag([1.0, 4.0, 1.0] * 2), (tracks, 6, 6)))
    own_R = np.broadcast_to(R, (tracks, many, 3, 3))
    beta, miss = np.full((tracks, many), 1.0 / many), np.zeros(tracks)
    for _ in range(WARM_UP_STEPS):
        mean = mean + PERIOD_S * mean[:, [1, 2, 2, 4, 5, 5]] * [1, 1, 0, 1, 1, 0]
        z = predict_measurement(mean)[:, None] + STD * rng.standard_normal((tracks, many, 3))
        before, scan = state, (z, own_R, beta, miss)
        state = step(chosen, before, scan)
    return before, scan


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--measurements", type=int, default=1)
    options = parser.parse_args()
    head = f"{'step us':>8s} {'us/track':>8s} {'6x6/track':>9s} {'unit us':>7s} {'bar us/track':>12s}"
    print(f"{'filter':14s} {'tracks':>6s} {head}")
    for name in filter_names():
        for tracks in BANKS:
            chosen = make_filter(name)
            arguments = scene(chosen, tracks, options.measurements, np.random.default_rng(options.seed))
            unit_s = seconds(partial(np.matmul, np.eye(6), np.eye(6)), 10 * options.repeats)
            taken_s = seconds(partial(step, chosen, *arguments), options.repeats)
            limit_us = CHEAP_BAR_US if name in CHEAP else BAR_US
            verdict = "met" if taken_s * 1e6 / tracks <= limit_us else "missed"
            bar = f"{limit_us:.0f} {verdict}" if tracks == BAR_TRACKS else ""
            figures = f"{taken_s * 1e6:8.1f} {taken_s * 1e6 / tracks:8.2f} {taken_s / unit_s / tracks:9.1f}"
            print(f"{name:14s} {tracks:6d} {figures} {unit_s * 1e6:7.2f} {bar:>12s}")


if __name__ == "__main__":
    main()
