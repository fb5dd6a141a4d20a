"""Compile the tracker's kernels into the cache, or load them from it, before the first frame needs them."""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np

from service.formats.sensor import GivenLane, LaneControl, SensorConfig
from service.tracking import tracker
from service.tracking.association import marginals
from service.tracking.clustering import dbscan, split_lateral
from service.tracking.clustering_parameters import ClusteringParameters
from service.tracking.filters.registry import filter_names, make_filter
from service.tracking.model import F64, Frame
from service.tracking.parameters import TrackerParameters
from service.traffic import monitor
from service.traffic.curves import beside
from service.traffic.lane_places import lanes_at, stands
from service.traffic.model import Moment
from service.traffic.parameters import traffic_setup

FRAMES = 60  # until tracks are confirmed, contend for points, and standing points are looked at
FRAME_US = 50_000
SPEED_MPS = 12.0
BODY_X_M = np.array([-0.8, 0.0, 0.8, -0.8, 0.8])  # points of one vehicle about its middle
BODY_Y_M = np.array([-2.0, -2.0, -2.0, 1.0, 1.0])
FIRST_X_M = np.array([0.0, 2.4, -3.0])  # the first two side by side, so that they share points
FIRST_Y_M = np.array([90.0, 89.0, 60.0])
POST_X_M, POST_Y_M = np.array([8.0, 8.0]), np.array([30.0, 55.0])
ROW_X_M = np.concatenate(
    [np.arange(-26.0, -21.5, 0.5), np.arange(-19.5, -15.0, 0.5)]
)  # two cars from the side
ROW_Y_M = np.full(len(ROW_X_M), 70.0)
# The compiler makes millions of small objects, nearly all freed by their counts of references: to look for
# cycles every 700 as usual is a tenth of its time; every 20,000 keeps 30 MB longer.
COLLECT_EVERY = 20_000


def _association() -> None:
    marginals(np.zeros((2, 2)), np.zeros(2))


def _density_clusters() -> None:
    dbscan(np.zeros((2, 4)), np.ones(2), 2.0)


def _lateral_split() -> None:
    split_lateral(np.zeros(2, np.int64), np.zeros(2), np.ones(2), np.ones(2), ClusteringParameters())


def _filter(name: str) -> None:
    chosen = make_filter(name)
    state = chosen.start(np.ones((1, 6)), np.eye(6)[None])
    prediction = chosen.predict(state, 0.05)
    expected = chosen.expected(prediction)
    chosen.update(prediction, expected.z_hat[:, None], np.eye(3)[None, None], np.ones((1, 1)), np.zeros(1))


def _whole_step() -> None:
    """Track a made-up road for a moment: it reaches every kernel of the chain."""
    chosen = TrackerParameters()
    state = tracker.initial_state(chosen)
    lane = GivenLane(index=1, points_m=((0.0, 150.0), (0.0, 20.0)))
    setup = traffic_setup(SensorConfig(lanes=LaneControl(mode="replaced", lanes=(lane,))))
    traffic = monitor.initial_state()
    for number in range(FRAMES):
        state, estimates, _ = tracker.step(state, _frame(number), chosen)
        traffic, _, _ = monitor.step(traffic, Moment(number * FRAME_US, number, tick=False), estimates, setup)
    tracker.coast(state, FRAMES * FRAME_US, chosen)
    beside(np.zeros((1, 2)), np.array([[0.0, 0.0], [1.0, 0.0]]))
    lanes_at(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros(1, dtype=np.int64), traffic.counts.ruler)
    stands(np.zeros((4, 1)), traffic.counts.lines, traffic.counts.ruler)


def _frame(number: int) -> Frame:
    """Return three vehicles that approach, two that stand in a row across, and two posts."""
    y_m = FIRST_Y_M - SPEED_MPS * number * FRAME_US / 1e6
    x = np.concatenate([(FIRST_X_M[:, None] + BODY_X_M).ravel(), POST_X_M, ROW_X_M])
    y = np.concatenate([(y_m[:, None] + BODY_Y_M).ravel(), POST_Y_M, ROW_Y_M])
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


# Name and a call with the smallest input that makes the kernel compile for the types of live use.
KERNELS: tuple[tuple[str, Callable[[], None]], ...] = (
    ("association", _association),
    ("density clusters", _density_clusters),
    ("lateral split", _lateral_split),
    *((f"filter {name}", partial(_filter, name)) for name in filter_names()),
    ("tracker", _whole_step),
)


def warm_up(report: Callable[[str, float], None]) -> None:
    """Make every kernel ready, and report the name and the seconds of each as it is done."""
    with _seldom_collected():
        for name, call in KERNELS:
            start = time.perf_counter()
            call()
            report(name, time.perf_counter() - start)


@contextmanager
def _seldom_collected() -> Iterator[None]:
    """Let the garbage collector run seldom meanwhile; off stays off."""
    usual = gc.get_threshold()
    gc.set_threshold(max(usual[0], COLLECT_EVERY) if usual[0] else 0, *usual[1:])
    try:
        yield
    finally:
        gc.set_threshold(*usual)


def main() -> None:
    """Make every kernel ready, with a line of progress for each on standard error."""
    sys.stderr.write("Preparing the tracker's kernels: compiled the first time, about a minute\n")
    done = 0

    def print_line(name: str, seconds: float) -> None:
        nonlocal done
        done += 1
        sys.stderr.write(f"kernel {done}/{len(KERNELS)}: {name}, {seconds:.1f} s\n")
        sys.stderr.flush()

    warm_up(print_line)


if __name__ == "__main__":
    main()
