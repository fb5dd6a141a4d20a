"""Who was given up in the last minute, and where: a vehicle that is listed again goes on from there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.traffic.measured import X, Y
from service.traffic.stitching import Joined, Vehicles

_KEPT_US = 60_000_000  # a number may come back after half of that


@dataclass(frozen=True, slots=True)
class Ended:
    """A vehicle that was given up: how it was named, and where it was seen last."""

    number: int
    vehicle: int
    last_us: int
    x_m: float
    y_m: float


def given_up(ended: tuple[Ended, ...], before: Vehicles, joined: Joined, now_us: int) -> tuple[Ended, ...]:
    """Return the vehicles given up in the last minute, after a scan; before: the vehicles before it."""
    if joined.origin is None:
        return ended
    gone = np.ones(len(before), dtype=np.bool_)
    gone[joined.origin[joined.origin >= 0]] = False
    fresh = [
        Ended(
            int(before.number[k]), int(before.vehicle[k]), int(before.last_us[k]),
            float(before.real[X, k]), float(before.real[Y, k]),
        )
        for k in np.flatnonzero(gone).tolist()
    ]  # fmt: skip
    if not fresh and (not ended or ended[0].last_us >= now_us - _KEPT_US):
        return ended
    return (*(x for x in ended if x.last_us >= now_us - _KEPT_US), *fresh)


def resumed(joined: Joined, ended: Sequence[Ended]) -> Joined:
    """Return the vehicles after a scan with those that are listed again coming from where they were lost."""
    if joined.origin is None or not ended:
        return joined
    known = {x.number: x for x in ended}
    rows = [
        (row, known[number])
        for row in np.flatnonzero(joined.origin < 0).tolist()
        if (number := int(joined.vehicles.number[row])) in known
    ]
    if not rows:
        return joined
    from_us, x_m, y_m = joined.from_us.copy(), joined.from_x_m.copy(), joined.from_y_m.copy()
    for row, x in rows:
        from_us[row], x_m[row], y_m[row] = x.last_us, x.x_m, x.y_m
    return replace(joined, from_us=from_us, from_x_m=x_m, from_y_m=y_m)
