"""Tell whether a track goes along inside an older one: its ghost, or a second track on the same vehicle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.tracking.model import F64
from service.traffic.count_parameters import CountParameters
from service.traffic.measured import VX, VY, X, Y
from service.traffic.window import Past

_STANDING_MPS = 1e-3  # a slower pair has no direction


def is_ghost(past: Past, number: int, older: Sequence[int], p: CountParameters) -> bool:
    """Return whether one of the older tracks was beside this one for most of its life in the window."""
    if not older:
        return False
    mine = np.flatnonzero(past.number == number)
    at = np.full(len(past.time_us), -1, dtype=np.int64)  # place of this track's sample, by scan
    at[past.scan[mine]] = mine
    for other in older:
        theirs = np.flatnonzero(past.number == other)
        i = at[past.scan[theirs]]
        both = i >= 0
        i, j = i[both], theirs[both]
        if len(i) < max(p.ghost_share * len(mine), 1):
            continue
        along, across = _offsets(past.real.take(i, axis=1), past.real.take(j, axis=1))
        if along < p.ghost_along_m and across < p.ghost_across_m:
            return True
    return False


def _offsets(mine: F64, other: F64) -> tuple[float, float]:
    """Return the medians of how far two tracks are apart, along and across the way of both."""
    dx, dy, vx, vy = mine[X] - other[X], mine[Y] - other[Y], mine[VX] + other[VX], mine[VY] + other[VY]
    speed = np.maximum(np.hypot(vx, vy), _STANDING_MPS)
    along, across = (dx * vx + dy * vy) / speed, (dx * vy - dy * vx) / speed
    return _median(np.abs(along)), _median(np.abs(across))


def _median(values: F64) -> float:
    """Return the median of finite values; numpy's own takes five times as long in checks."""
    ordered = np.sort(values)
    return 0.5 * float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])
