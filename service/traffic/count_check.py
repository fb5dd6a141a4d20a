"""Hold a count by hand against the measured volume: difference, relative error and GEH.

GEH = sqrt(2 (m - c)^2 / (m + c)) of hourly volumes m (measured) and c (counted); counts of other intervals
are scaled to an hour first. Below 5 is the usual target. Source: UK Design Manual for Roads and Bridges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

GEH_TARGET = 5.0
_S_PER_HOUR = 3600.0


@dataclass(frozen=True, slots=True)
class Check:
    """One comparison."""

    counted: int
    measured: int
    difference: int  # measured less counted
    relative_error: float | None  # of the count, None where nothing was counted
    geh: float
    within_target: bool


def check(counted: int, measured: int, interval_s: float) -> Check:
    """Return how a measured volume compares with the one counted by hand in the same interval."""
    scale = _S_PER_HOUR / interval_s
    m, c = measured * scale, counted * scale
    geh = math.sqrt(2 * (m - c) ** 2 / (m + c)) if m + c > 0 else 0.0
    relative = (measured - counted) / counted if counted else None
    return Check(counted, measured, measured - counted, relative, geh, geh < GEH_TARGET)
