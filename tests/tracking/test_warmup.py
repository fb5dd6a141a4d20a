"""After the warm-up no kernel is left to compile in the middle of traffic."""

from __future__ import annotations

import subprocess
import sys

import pytest

LEFT_OVER = """
import importlib, pkgutil
from numba.core.registry import CPUDispatcher
import service.tracking
from service.tracking.warmup import warm_up

warm_up()
names = [m.name for m in pkgutil.iter_modules(service.tracking.__path__, "service.tracking.")]
values = [f for name in names for f in vars(importlib.import_module(name)).values()]
found = [f for f in values if isinstance(f, CPUDispatcher)]
kernels = {f"{f.__module__}.{f.__name__}": f.signatures for f in found if "no_cpython_wrapper" not in f.targetoptions}
print(len(kernels), *(name for name, signatures in kernels.items() if not signatures))
"""


@pytest.mark.slow
def test_the_warm_up_compiles_every_kernel():
    result = subprocess.run([sys.executable, "-c", LEFT_OVER], capture_output=True, text=True, check=True)

    count, *left = result.stdout.split()
    assert int(count) > 5
    assert left == []


@pytest.mark.slow
def test_the_warm_up_says_what_it_does():
    result = subprocess.run(
        [sys.executable, "-m", "service.tracking.warmup"], capture_output=True, text=True, check=True
    )

    assert result.stderr.startswith("Preparing the tracker")
    assert result.stderr.endswith("ready\n")
