"""Turn a vehicle's length into its length class."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence

LENGTH_CLASSES = ("motorcycle", "short", "medium", "long")

# 21.5 and 49 ft: bins of length-based vehicle classification (FHWA Traffic Monitoring Guide 2022). Its third,
# 6.5 ft (1.98 m) for motorcycles, is below their whole length of about 2 to 2.6 m, which is measured here.
LENGTH_BOUNDS_M = (2.6, 6.55, 14.9)


def length_class(length_m: float | None, bounds_m: Sequence[float]) -> str | None:
    """Return the class of a length by three ascending bounds (each belongs to the longer class)."""
    if length_m is None or math.isnan(length_m):
        return None
    return LENGTH_CLASSES[bisect_right(bounds_m, length_m)]
