"""Turn a vehicle's length into its length class."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence

LENGTH_CLASSES = ("motorcycle", "short", "medium", "long")

# 6.5, 21.5 and 49 ft: bins of length-based vehicle classification (FHWA Traffic Monitoring Guide 2022)
LENGTH_BOUNDS_M = (1.98, 6.55, 14.9)


def length_class(length_m: float | None, bounds_m: Sequence[float] = LENGTH_BOUNDS_M) -> str | None:
    """Return the class of a length (a bound belongs to the longer class), None when unknown."""
    if length_m is None or math.isnan(length_m):
        return None
    return LENGTH_CLASSES[bisect_right(bounds_m, length_m)]
