"""Who was given up in the last minute, and where: a vehicle that is listed again goes on from there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.tracking.model import I64
from service.traffic.measured import X, Y
from service.traffic.stitching import Joined, Vehicles

_KEPT_US = 60_000_000  # a number may come back after half of that
_BACK_M, _ASIDE_M, _ASIDE_SHARE = 2.0, 2.0, 0.05  # what the way to where it is seen again may be off
_SLOW_MPS = 0.5  # a slower one has no direction


@dataclass(frozen=True, slots=True)
class Ended:
    """A vehicle that was given up: how it was named, and where it was seen last."""

    number: int
    vehicle: int
    last_us: int
    x_m: float
    y_m: float


def left(before: Vehicles, joined: Joined) -> I64:
    """Return the places of the vehicles before a scan that are given up in it."""
    if joined.origin is None:
        return np.zeros(0, dtype=np.int64)
    gone = np.ones(len(before), dtype=np.bool_)
    gone[joined.origin[joined.origin >= 0]] = False
    return np.flatnonzero(gone)


def given_up(ended: tuple[Ended, ...], before: Vehicles, joined: Joined, now_us: int) -> tuple[Ended, ...]:
    """Return the vehicles given up in the last minute, after a scan; before: the vehicles before it."""
    fresh = tuple(
        Ended(
            int(before.number[k]), int(before.vehicle[k]), int(before.last_us[k]),
            float(before.real[X, k]), float(before.real[Y, k]),
        )
        for k in left(before, joined).tolist()
    )  # fmt: skip
    if ended and ended[0].last_us < now_us - _KEPT_US:
        ended = tuple(x for x in ended if x.last_us >= now_us - _KEPT_US)
    return ended + fresh


def resumed(joined: Joined, ended: Sequence[Ended], since_us: int, now_us: int) -> Joined:
    """Return the vehicles after a scan with where those begin their way that were not there before.

    One that is listed again comes from where it was lost, if there were frames all the while: since_us, from
    when on. Another begins where it is: the way from its birth to there would be right, too, but so many
    false tracks begin that the sums are no better for it.
    """
    rows = np.flatnonzero(joined.origin < 0).tolist() if joined.origin is not None else []
    if not rows:
        return joined
    known = {x.number: x for x in ended if x.last_us >= since_us}
    from_us, x_m, y_m = joined.from_us.copy(), joined.from_x_m.copy(), joined.from_y_m.copy()
    for row in rows:
        from_us[row], (x_m[row], y_m[row]) = now_us, joined.vehicles.real[[X, Y], row]
        x = known.get(int(joined.vehicles.number[row]))
        if x is not None and _leads_to(x, *joined.vehicles.real[:, row].tolist()):
            from_us[row], x_m[row], y_m[row] = x.last_us, x.x_m, x.y_m
    return replace(joined, from_us=from_us, from_x_m=x_m, from_y_m=y_m)


def _leads_to(x: Ended, x_m: float, y_m: float, vx_mps: float, vy_mps: float) -> bool:
    """Return whether a vehicle can have driven straight on to a place from where it was lost."""
    dx, dy, speed = x_m - x.x_m, y_m - x.y_m, math.hypot(vx_mps, vy_mps)
    if speed < _SLOW_MPS:
        return math.hypot(dx, dy) <= _ASIDE_M
    along, across = (dx * vx_mps + dy * vy_mps) / speed, (dx * vy_mps - dy * vx_mps) / speed
    return along >= -_BACK_M and abs(across) <= _ASIDE_M + _ASIDE_SHARE * along
