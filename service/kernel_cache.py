"""Settle, before numpy and numba are imported, how kernels are compiled and kept, and the threads of BLAS.

Both libraries read these environment variables once, at their import; what the user has set stays as it is.
"""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import MutableMapping
from pathlib import Path

# Sums split over threads depend on how many there are: one thread gives the same answer on every run.
_THREAD_LIMITS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

# Higher levels and LLVM's vectoriser of loops take about a tenth longer to compile, and these kernels, loops
# of scalars with branches, are no faster by it.
_COMPILER = {"NUMBA_OPT": "1", "NUMBA_LOOP_VECTORIZE": "0"}


def prepare(environment: MutableMapping[str, str]) -> None:
    """Set the limits of threads, numba's optimisation and its cache directory where `environment` names none.

    The directory is that of WAYSIDE_KERNEL_CACHE, else one in the user's cache directory, else, for a user
    without a home, a private temporary one.
    """
    for name in _THREAD_LIMITS:
        environment.setdefault(name, "1")
    for name, value in _COMPILER.items():
        environment.setdefault(name, value)
    if environment.get("NUMBA_CACHE_DIR"):
        return
    named = environment.get("WAYSIDE_KERNEL_CACHE")
    environment["NUMBA_CACHE_DIR"] = named or str(_default_directory(environment))


def _default_directory(environment: MutableMapping[str, str]) -> Path:
    home = environment.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 - never raises
    directory = Path(home) / "wayside" / "kernels"
    if _is_writable(directory):
        return directory
    shared = Path(tempfile.gettempdir()) / f"wayside-kernels-{os.getuid()}"
    return shared if _is_private(shared) else Path(tempfile.mkdtemp(prefix="wayside-kernels-"))


def _is_writable(directory: Path) -> bool:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(directory, os.W_OK | os.X_OK)


def _is_private(directory: Path) -> bool:
    """Tell whether nobody else can write there: numba's cache holds pickles, which run code when read."""
    try:
        directory.mkdir(mode=0o700, exist_ok=True)
    except OSError:
        return False
    status = directory.lstat()
    others_write = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not others_write
