"""Turn functions of plain loops over arrays into compiled kernels."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numpy as np
from numba import njit

from service.tracking.model import F64

P = ParamSpec("P")
R = TypeVar("R")
_FLOAT = np.dtype(np.float64)


def ready(values: F64) -> F64:
    """Return an array as kernels take it: a copy of other types, read-only and strided ones, else itself.

    For each of those a kernel would be compiled anew.
    """
    if values.dtype is _FLOAT and values.flags.carray:
        return values
    return np.array(values, np.float64, order="C")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile on first call for the types it gets; keep the machine code on disk; run without the GIL."""
    # Nothing calls kernels from C; the type stubs of numba do not know the last option.
    compiled = njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)  # type: ignore[call-overload]
    return cast("Callable[P, R]", compiled(function))


def part(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a helper into the kernels that call it, and for them only.

    It belongs in the kernel's own file: the cache on disk notices a change of that file only. A part should
    not call parts, because each level is optimised again with all that is below it.
    """
    # The type stubs of numba do not know the last two options, which leave out the way in from Python.
    compiled = njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)  # type: ignore[call-overload]
    return cast("Callable[P, R]", compiled(function))
