"""Time the kernels: microseconds, and multiples of one numpy 6x6 product measured in the same run.

    OMP_NUM_THREADS=1 python -m benchmarks.kernels [--seed N] [--repeats N]

`solve` is the compiled kernel alone, `marginals` the function around it. The multiple takes out most of what
a slow or busy machine adds; each figure is the median over problems of the median over repeats, and `worst`
the largest of the latter.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent))  # so that it also runs as a script

from association_scenes import dense, queue

from service.tracking.association import SAFE_RANGE, assign_maximum, marginals
from service.tracking.association_kernels import solve
from service.tracking.clustering import cluster_window, compensate, dbscan, features, road_axes
from service.tracking.clustering_parameters import ClusteringParameters

F64 = NDArray[np.float64]

PROBLEMS = 12
ROAD = np.array([0.0, 1.0])
LANES = 4
LANE_M = 3.5
FRAME_S = 0.05


def seconds(call: Callable[[], object], repeats: int) -> float:
    """Return the median time of a call."""
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        taken.append(time.perf_counter() - start)
    return float(np.median(taken))


@dataclass(frozen=True)
class Row:
    name: str
    calls: Sequence[Callable[[], object]]
    bar_us: float | None
    note: str = ""


def association_rows(rng: np.random.Generator) -> list[Row]:
    """Return clusters of the sizes of the acceptance bars, and a whole frame of small ones."""
    cases: list[tuple[str, Callable[[], tuple[F64, F64]], float | None, float | None]] = [
        ("10 tracks", lambda: queue(rng, 10), 10.0, None),
        ("16 tracks", lambda: queue(rng, 16), 30.0, None),
        ("32 tracks", lambda: queue(rng, 32, detection=0.7, clutter_per_m2=2e-2), 150.0, None),
        ("64 tracks, dense", lambda: dense(rng, 64), 5000.0, None),
        ("frame of 32 in eights", lambda: side_by_side([queue(rng, 8) for _ in range(4)]), None, 500.0),
    ]
    rows = []
    for name, make, kernel_bar_us, call_bar_us in cases:
        problems = [make() for _ in range(PROBLEMS)]
        approximated = sum(marginals(*problem).approximated for problem in problems)
        note = f"approximated {approximated} of {PROBLEMS}"
        rows.append(Row(f"solve, {name}", [bare_solve(*p) for p in problems], kernel_bar_us, note))
        rows.append(Row(f"marginals, {name}", [partial(marginals, *p) for p in problems], call_bar_us))
    rows.append(Row(f"assign_maximum, {name}", [partial(assign_maximum, *p) for p in problems], None))
    return rows


def bare_solve(log_weight: F64, log_miss: F64) -> Callable[[], object]:
    """Return a call of the kernel with its arrays ready."""
    price, beta, miss = np.zeros(log_weight.shape[1]), np.empty_like(log_weight), np.empty_like(log_miss)
    component = np.empty(len(log_miss), np.int64)
    return partial(solve, log_weight, log_miss, price, SAFE_RANGE, 1.0, 14, beta, miss, component)


def side_by_side(clusters: Sequence[tuple[F64, F64]]) -> tuple[F64, F64]:
    """Return one association problem made of several that share nothing."""
    whole = np.full(np.sum([weight.shape for weight, _ in clusters], axis=0), -np.inf)
    row = column = 0
    for weight, _ in clusters:
        whole[row : row + weight.shape[0], column : column + weight.shape[1]] = weight
        row, column = row + weight.shape[0], column + weight.shape[1]
    return whole, np.concatenate([miss for _, miss in clusters])


def window(rng: np.random.Generator, per_frame: int, parameters: ClusteringParameters) -> dict[str, F64]:
    """Return the points of a window: vehicles on four lanes from 20 to 150 m, 4.3 points each and frame."""
    vehicles = max(1, round(per_frame / 4.3))
    slots = rng.permutation(LANES * 26)[:vehicles]  # 26 places of 5 m in a lane; more vehicles stand twice
    slots = np.resize(slots, vehicles)
    lane_m, y_m = (slots % LANES - 1.5) * LANE_M, 20.0 + slots // LANES * 5.0
    speed_mps = -rng.normal(15.0, 2.0, vehicles)
    frames = []
    for age_s in FRAME_S * np.arange(parameters.window_frames):
        of = rng.integers(vehicles, size=per_frame)
        x = lane_m[of] + rng.uniform(-0.9, 0.9, per_frame)
        y = y_m[of] + rng.uniform(-2.2, 2.2, per_frame) - speed_mps[of] * age_s
        range_m = np.hypot(x, y) + rng.normal(0.0, 0.15, per_frame)
        azimuth_rad = np.arctan2(x, y) + rng.normal(0.0, np.radians(0.3), per_frame)
        frames.append(
            {
                "x_m": range_m * np.sin(azimuth_rad),
                "y_m": range_m * np.cos(azimuth_rad),
                "radial_velocity_mps": speed_mps[of] * np.cos(azimuth_rad) + rng.normal(0.0, 0.1, per_frame),
                "age_s": np.full(per_frame, age_s),
                "azimuth_std_rad": np.full(per_frame, np.radians(0.3)),
                "weights": np.ones(per_frame),
            }
        )
    return {name: np.concatenate([frame[name] for frame in frames]) for name in frames[0]}


def scaled_features(points: dict[str, F64], parameters: ClusteringParameters) -> F64:
    """Return the features that `cluster_window` clusters."""
    doppler, age = points["radial_velocity_mps"], points["age_s"]
    x, y = compensate(points["x_m"], points["y_m"], doppler, age, ROAD, parameters)
    along, across = road_axes(x, y, ROAD)
    return features(along, across, np.hypot(x, y), doppler, age, points["azimuth_std_rad"], parameters)


def clustering_rows(rng: np.random.Generator) -> list[Row]:
    """Return DBSCAN alone and the whole of a window's clustering, for 50 to 500 points a frame."""
    parameters = ClusteringParameters()
    bars_us = {260: 1000.0}
    rows = []
    for per_frame in (50, 100, 200, 260, 300, 500):
        windows = [window(rng, per_frame, parameters) for _ in range(PROBLEMS // 2)]
        ready = [(scaled_features(points, parameters), points["weights"]) for points in windows]
        limit = parameters.min_points
        alone = [partial(dbscan, *problem, limit) for problem in ready]
        whole = [
            partial(cluster_window, **points, road_direction=ROAD, parameters=parameters)
            for points in windows
        ]
        note = f"{parameters.window_frames * per_frame} points, {dbscan(*ready[0], limit).max() + 1} clusters"
        rows.append(Row(f"dbscan, {per_frame} a frame", alone, bars_us.get(per_frame), note))
        rows.append(Row(f"cluster_window, {per_frame} a frame", whole, None))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=60)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    print(f"{'kernel':40s} {'us':>8s} {'worst':>8s} {'6x6':>7s} {'bar us':>8s}")
    for row in association_rows(rng) + clustering_rows(rng):
        unit_s = seconds(partial(np.matmul, np.eye(6), np.eye(6)), 2000)  # under the same load
        taken_s = [seconds(call, options.repeats) for call in row.calls]
        bar = "" if row.bar_us is None else f"{row.bar_us:.0f}"
        middle_s = float(np.median(taken_s))
        figures = f"{middle_s * 1e6:8.1f} {max(taken_s) * 1e6:8.1f} {middle_s / unit_s:7.0f} {bar:>8s}"
        print(f"{row.name:40s} {figures}  {row.note}")


if __name__ == "__main__":
    main()
