"""Live use must find its kernels compiled, whatever kind of array it brings."""

from __future__ import annotations

import gc
import subprocess
import sys

import numpy as np
import pytest

from service import warmup
from service.tracking.association import marginals
from service.tracking.association_kernels import solve
from service.tracking.clustering import cluster_window
from service.tracking.clustering_kernels import density_clusters, split_clusters
from service.tracking.clustering_parameters import ClusteringParameters

LEFT_OVER = """
import importlib, pkgutil
from numba.core.registry import CPUDispatcher
import service.tracking, service.traffic
from service.warmup import warm_up

warm_up(lambda name, seconds: None)
packages = (service.tracking, service.traffic)
names = [m.name for p in packages for m in pkgutil.iter_modules(p.__path__, p.__name__ + ".")]
values = [f for name in names for f in vars(importlib.import_module(name)).values()]
found = [f for f in values if isinstance(f, CPUDispatcher)]
entries = [f for f in found if "no_cpython_wrapper" not in f.targetoptions]
kernels = {f"{f.__module__}.{f.__name__}": f.signatures for f in entries}
print(len(kernels), *(name for name, signatures in kernels.items() if not signatures))
"""


@pytest.fixture
def warm() -> list[str]:
    names: list[str] = []
    warmup.warm_up(lambda name, _: names.append(name))
    return names


def read_only(*shape):
    array = np.zeros(shape, np.float32, order="F")
    array.setflags(write=False)
    return array


def test_every_kernel_is_reported_once(warm):
    assert warm == [name for name, _ in warmup.KERNELS]


@pytest.mark.parametrize(
    ("usual", "meanwhile"), [((700, 10, 10), 20_000), ((90_000, 5, 5), 90_000), ((0, 10, 10), 0)]
)
def test_garbage_is_looked_for_seldom_meanwhile_and_as_before_afterwards(usual, meanwhile):
    before = gc.get_threshold()
    gc.set_threshold(*usual)
    seen: list[int] = []
    try:
        warmup.warm_up(lambda *_: seen.append(gc.get_threshold()[0]))
        afterwards = gc.get_threshold()
    finally:
        gc.set_threshold(*before)

    assert set(seen) == {meanwhile}
    assert afterwards == usual


def test_no_input_makes_a_kernel_compile_again(warm):
    kernels = (solve, density_clusters, split_clusters)
    compiled = [len(kernel.signatures) for kernel in kernels]

    marginals(read_only(4, 3), read_only(4), temper=2, max_width=np.int32(14))
    marginals(np.zeros((8, 6))[::2, ::2], np.zeros(8)[::2])
    for count in (0, 5):
        point = read_only(count)
        parameters = ClusteringParameters(min_points=4, split_gain=14, split_min_points=2)
        cluster_window(
            x_m=point,
            y_m=point,
            radial_velocity_mps=point,
            age_s=point,
            azimuth_std_rad=point,
            weights=point + 1,
            road_direction=read_only(2),
            parameters=parameters,
        )

    assert [len(kernel.signatures) for kernel in kernels] == compiled


def test_main_prints_a_line_for_each_kernel(capsys):
    warmup.main()

    lines = capsys.readouterr().err.splitlines()[1:]
    assert len(lines) == len(warmup.KERNELS)
    assert lines[0].startswith(f"kernel 1/{len(warmup.KERNELS)}: association, ")


@pytest.mark.slow
def test_the_warm_up_compiles_every_kernel():
    result = subprocess.run([sys.executable, "-c", LEFT_OVER], capture_output=True, text=True, check=True)

    count, *left = result.stdout.split()
    assert int(count) > 5
    assert left == []
