"""Tell whether a track goes along inside an older one: its ghost, or a second track on the same vehicle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.traffic.count_parameters import CountParameters
from service.traffic.window import Scan


def is_ghost(window: Sequence[Scan], number: int, older: Sequence[int], p: CountParameters) -> bool:
    """Return whether one of the older tracks was beside this one for most of its life in the window."""
    mine = [(scan, i) for scan in window if (i := _place(scan, number)) >= 0]
    if not mine:
        return False
    for other in older:
        pairs = [(scan, i, j) for scan, i in mine if (j := _place(scan, other)) >= 0]
        if len(pairs) < max(p.ghost_share * len(mine), 1):
            continue
        along, across = _offsets(pairs)
        if along < p.ghost_along_m and across < p.ghost_across_m:
            return True
    return False


def _offsets(pairs: Sequence[tuple[Scan, int, int]]) -> tuple[float, float]:
    """Return the medians of how far two tracks are apart, along and across the way of the second."""
    table = np.array(
        [
            (s.x_m[i] - s.x_m[j], s.y_m[i] - s.y_m[j], s.vx_mps[i] + s.vx_mps[j], s.vy_mps[i] + s.vy_mps[j])
            for s, i, j in pairs
        ]
    )
    dx, dy, vx, vy = table.T
    speed = np.maximum(np.hypot(vx, vy), 1e-3)
    along, across = (dx * vx + dy * vy) / speed, (dx * vy - dy * vx) / speed
    return float(np.median(np.abs(along))), float(np.median(np.abs(across)))


def _place(scan: Scan, number: int) -> int:
    i = int(np.searchsorted(scan.number, number))
    return i if i < len(scan.number) and scan.number[i] == number else -1
