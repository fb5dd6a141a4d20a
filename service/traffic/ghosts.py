"""Tell whether a track is the ghost of an older one: a second track on its vehicle, or a late echo of it.

An echo that goes from a vehicle to a neighbour and back arrives late, on the bearing of the vehicle: it seems
to drive some metres behind it, at its speed, and as both come near it leaves the road sideways, where one
that follows would stay on the way that the vehicle has gone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from service.tracking.model import F64, I64
from service.traffic.count_parameters import CountParameters
from service.traffic.measured import VX, VY, X, Y
from service.traffic.window import Past

_STANDING_MPS = 1e-3  # a slower pair has no direction
_LEAST = 10  # samples: half a second


def is_ghost(past: Past, number: int, older: Sequence[int], p: CountParameters) -> bool:
    """Return whether one of the older tracks was beside this one for most of its life in the window."""
    for i, j, _ in _together(past, number, older, p.ghost_share, 1):
        along, across = _offsets(past.real.take(i, axis=1), past.real.take(j, axis=1))
        if along < p.ghost_along_m and across < p.ghost_across_m:
            return True
    return False


def is_bounce(past: Past, number: int, nearer: Sequence[int], p: CountParameters) -> bool:
    """Return whether a track keeps on the bearing of a nearer one and leaves the way that it went."""
    for i, j, theirs in _together(past, number, nearer, p.ghost_share, _LEAST):
        x, y, other_x, other_y = *past.real[[X, Y]][:, i], *past.real[[X, Y]][:, j]
        range_m, other_range_m = np.hypot(x, y), np.hypot(other_x, other_y)
        behind_m = range_m - other_range_m
        across_m = (x * other_y - y * other_x) / other_range_m
        if (
            behind_m.min() < p.bounce_from_m
            or behind_m.max() > p.bounce_to_m
            or np.ptp(behind_m) > p.bounce_spread_m
            or _median(np.abs(across_m)) >= p.bounce_across_m
        ):
            continue
        aside_m = _aside(past.real[:, i], past.real[:, theirs])
        if len(aside_m) < _LEAST:
            continue
        quarter = len(aside_m) // 4
        first, last = float(aside_m[:quarter].mean()), float(aside_m[-quarter:].mean())
        if (
            abs(last - first) >= p.bounce_leaves_m
            and abs(last) >= p.bounce_leaves_m
            and last * (last - first) > 0
        ):
            return True
    return False


def _together(
    past: Past, number: int, others: Sequence[int], share: float, least: int
) -> Iterator[tuple[I64, I64, I64]]:
    """Yield the samples of a track and of another in the same scans, and all of the other's, for each other.

    Left out are those that were seen with it for less than a share of its samples, or for fewer than `least`.
    """
    mine = np.flatnonzero(past.number == number)
    at = np.full(len(past.time_us), -1, dtype=np.int64)  # place of this track's sample, by scan
    at[past.scan[mine]] = mine
    for other in others:
        theirs = np.flatnonzero(past.number == other)
        i = at[past.scan[theirs]]
        both = i >= 0
        if np.count_nonzero(both) >= max(share * len(mine), least):
            yield i[both], theirs[both], theirs


def _aside(mine: F64, other: F64) -> F64:
    """Return how far to the right of the way of the other each place is, of those that are beside it."""
    away = np.hypot(mine[X, :, None] - other[X], mine[Y, :, None] - other[Y])
    place = np.argmin(away, axis=1)
    beside = place > 0  # before its first place the way is not known
    mine, nearest = mine[:, beside], other[:, place[beside]]
    dx, dy, vx, vy = mine[X] - nearest[X], mine[Y] - nearest[Y], nearest[VX], nearest[VY]
    return np.asarray((dx * vy - dy * vx) / np.maximum(np.hypot(vx, vy), _STANDING_MPS))


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
