"""Compile the tracker's kernels into the cache, or load them from it, before the first frame needs them."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from service.tracking.association import marginals
from service.tracking.clustering import dbscan, split_lateral
from service.tracking.clustering_parameters import ClusteringParameters
from service.tracking.filters.registry import filter_names, make_filter


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


# Name and a call with the smallest input that makes the kernel compile for the types of live use.
KERNELS: tuple[tuple[str, Callable[[], None]], ...] = (
    ("association", _association),
    ("density clusters", _density_clusters),
    ("lateral split", _lateral_split),
    *((f"filter {name}", partial(_filter, name)) for name in filter_names()),
)


def warm_up(report: Callable[[str, float], None]) -> None:
    """Make every kernel ready, and report the name and the seconds of each as it is done."""
    for name, call in KERNELS:
        start = time.perf_counter()
        call()
        report(name, time.perf_counter() - start)


def main() -> None:
    """Make every kernel ready, with a line of progress for each."""
    done = 0

    def print_line(name: str, seconds: float) -> None:
        nonlocal done
        done += 1
        sys.stdout.write(f"kernel {done}/{len(KERNELS)}: {name}, {seconds:.1f} s\n")
        sys.stdout.flush()

    warm_up(print_line)


if __name__ == "__main__":
    main()
