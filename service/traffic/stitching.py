"""Join the pieces of one vehicle: a track that begins where another, lost a moment ago, would be now.

Each vehicle is a chain of tracks, named by the number of its first. Ends are kept for three seconds; a start
takes the end that fits best, each end is taken once. Expected is the end moved by the mean of both
velocities, which on an arc of a circle is the chord, so that no road needs to be known.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from service.tracking.model import F64, I64, Bool
from service.traffic.count_parameters import CountParameters
from service.traffic.window import Scan

Array = TypeVar("Array", F64, I64)

_SLOW_MPS = 0.5  # below, the direction of a velocity means little and the axes of the cost are taken alike


@dataclass(frozen=True, slots=True)
class Vehicles:
    """The vehicles of the last seconds, (V,) each, by the number of their newest track."""

    number: I64  # of the track that carries the vehicle now
    vehicle: I64  # of its first track: its name
    first_us: I64  # when its first track was listed
    track_us: I64  # when its newest track was listed
    last_us: I64  # when it was measured last
    hits: I64  # frames in which it was measured
    x_m: F64  # there
    y_m: F64
    vx_mps: F64
    vy_mps: F64

    def take(self, index: I64 | Bool) -> Vehicles:
        """Return the vehicles at `index` (integers or a mask)."""
        return Vehicles(*(getattr(self, item.name)[index] for item in dataclasses.fields(self)))


@dataclass(frozen=True, slots=True)
class Joined:
    """The vehicles after a scan, (V,), and where each comes from."""

    vehicles: Vehicles
    origin: I64  # (V,) its place among those before, -1: new
    measured: I64  # (V,) its place in the scan, -1: not measured now
    from_us: I64  # (V,) its last measurement before; of a new one its birth, from where it is moved back
    from_x_m: F64
    from_y_m: F64
    from_number: I64  # of the track that carried it there


def no_vehicles() -> Vehicles:
    """Return the state before the first scan."""
    i, f = np.zeros(0, dtype=np.int64), np.zeros(0)
    return Vehicles(i, i, i, i, i, i, f, f, f, f)


def join(before: Vehicles, scan: Scan, p: CountParameters) -> Joined:
    """Return the vehicles after a scan: pieces joined, those lost for longer than a gap forgotten."""
    gap_us = round(p.stitch_gap_s * 1e6)
    place = _find(scan.number, before.number)  # of each vehicle in the scan
    known = np.isin(scan.number, before.number)
    takes = _takes(before, np.flatnonzero(place < 0), scan, np.flatnonzero(~known), p)
    for start, end in takes:
        place[end] = start
    fresh = np.setdiff1d(np.flatnonzero(~known), [start for start, _ in takes])
    stay = (place >= 0) | (scan.time_us - before.last_us <= gap_us)
    origin = np.concatenate([np.flatnonzero(stay), np.full(len(fresh), -1)])
    measured = np.concatenate([place[stay], fresh])
    number = np.where(measured >= 0, scan.number[measured] if len(scan.number) else 0, 0)
    number = np.where(measured >= 0, number, before.number[origin] if len(before.number) else 0)
    order = np.argsort(number, kind="stable")
    origin, measured, number = origin[order], measured[order], number[order]
    return _joined(before, scan, origin, measured, number)


def _joined(before: Vehicles, scan: Scan, origin: I64, measured: I64, number: I64) -> Joined:
    new, seen = origin < 0, measured >= 0
    old = _columns(before, origin)
    last_us = np.where(seen, scan.time_us, old.last_us)
    changed = number != old.number
    vehicles = Vehicles(
        number=number,
        vehicle=np.where(new, number, old.vehicle),
        first_us=np.where(new, scan.time_us, old.first_us),
        track_us=np.where(new | changed, scan.time_us, old.track_us),
        last_us=last_us,
        hits=old.hits * ~new + seen,
        x_m=_newest(scan.x_m, measured, old.x_m),
        y_m=_newest(scan.y_m, measured, old.y_m),
        vx_mps=_newest(scan.vx_mps, measured, old.vx_mps),
        vy_mps=_newest(scan.vy_mps, measured, old.vy_mps),
    )
    age_us = scan.time_us - _newest(scan.born_us, measured, vehicles.track_us)
    return Joined(
        vehicles=vehicles,
        origin=origin,
        measured=measured,
        from_us=np.where(new, scan.time_us - age_us, old.last_us),
        from_x_m=np.where(new, vehicles.x_m - vehicles.vx_mps * age_us / 1e6, old.x_m),
        from_y_m=np.where(new, vehicles.y_m - vehicles.vy_mps * age_us / 1e6, old.y_m),
        from_number=np.where(new, number, old.number),
    )


def _columns(before: Vehicles, origin: I64) -> Vehicles:
    """Return the vehicles at `origin`; what stands at -1 means nothing."""
    if len(before.number):
        return before.take(origin)
    blank = no_vehicles()
    return Vehicles(
        *(np.zeros(len(origin), dtype=getattr(blank, item.name).dtype) for item in dataclasses.fields(blank))
    )


def _newest(column: Array, measured: I64, old: Array) -> Array:
    return np.where(measured >= 0, column[measured], old) if len(column) else old


def _find(numbers: I64, wanted: I64) -> I64:
    """Return where each wanted number stands in the ascending `numbers`, -1 where it does not."""
    where = np.searchsorted(numbers, wanted)
    where[where == len(numbers)] = 0
    if not len(numbers):
        return np.full(len(wanted), -1)
    return np.where(numbers[where] == wanted, where, -1)


def _takes(
    before: Vehicles, ends: I64, scan: Scan, starts: I64, p: CountParameters
) -> Sequence[tuple[int, int]]:
    """Return pairs of a start in the scan and the end before it that belong together, the best first."""
    if not len(ends) or not len(starts):
        return ()
    cost = stitch_cost(before.take(ends), scan, starts, p)
    pairs: list[tuple[int, int]] = []
    while cost.size and (best := float(np.min(cost))) < p.stitch_cost:
        start, end = np.argwhere(cost == best)[0]
        pairs.append((int(starts[start]), int(ends[end])))
        cost[start], cost[:, end] = np.inf, np.inf
    return pairs


def stitch_cost(ends: Vehicles, scan: Scan, starts: I64, p: CountParameters) -> F64:
    """Return (starts, ends) how badly each start goes on with each end; infinite where it cannot."""
    gap_s = (scan.time_us - ends.last_us) / 1e6
    vx, vy = scan.vx_mps[starts][:, None], scan.vy_mps[starts][:, None]
    mean_x, mean_y = (vx + ends.vx_mps) / 2, (vy + ends.vy_mps) / 2
    off_x = scan.x_m[starts][:, None] - ends.x_m - mean_x * gap_s
    off_y = scan.y_m[starts][:, None] - ends.y_m - mean_y * gap_s
    speed = np.hypot(mean_x, mean_y)
    unit_x, unit_y = mean_x / np.maximum(speed, _SLOW_MPS), mean_y / np.maximum(speed, _SLOW_MPS)
    along = off_x * unit_x + off_y * unit_y
    across = np.sqrt(np.maximum(off_x**2 + off_y**2 - along**2, 0.0))
    apart = np.hypot(vx - ends.vx_mps, vy - ends.vy_mps)
    cost = (along / (p.stitch_along_m + p.stitch_along_mps * gap_s)) ** 2
    cost += (across / (p.stitch_across_m + p.stitch_across_mps * gap_s)) ** 2
    cost += (apart / p.stitch_speed_mps) ** 2
    opposite = vx * ends.vx_mps + vy * ends.vy_mps < -(_SLOW_MPS**2)
    cost[opposite | (gap_s > p.stitch_gap_s) | (gap_s <= 0)] = np.inf
    return np.asarray(cost)
