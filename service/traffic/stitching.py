"""Join the pieces of one vehicle: a track that begins where another, lost a moment ago, would be now.

Each vehicle is a chain of tracks, named by the number of its first. Ends are kept for three seconds; a start
takes the end that fits best, each end is taken once. Expected is the end moved by the mean of both
velocities, which on an arc of a circle is the chord, so that no road needs to be known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, I64, Bool
from service.traffic.count_parameters import CountParameters
from service.traffic.measured import PLANE, VX, VY, X, Y
from service.traffic.vehicles import find
from service.traffic.window import Scan

_SLOW_MPS = 0.5  # below, the direction of a velocity means little and the axes of the cost are taken alike
# rows of `whole`
NUMBER, VEHICLE, FIRST_US, TRACK_US, LAST_US = range(5)
_WHOLE_ROWS, _REAL_ROWS = 5, 4


@dataclass(frozen=True, slots=True)
class Vehicles:
    """The vehicles of the last seconds, V of them by the number of their newest track."""

    whole: I64  # (5, V), one row for each property below
    real: F64  # (4, V) x_m, y_m, vx_mps, vy_mps where it was measured last

    def __len__(self) -> int:
        return int(self.whole.shape[1])

    @property
    def number(self) -> I64:
        """Return the number of the track that carries the vehicle now."""
        return np.asarray(self.whole[NUMBER])

    @property
    def vehicle(self) -> I64:
        """Return the number of its first track: its name."""
        return np.asarray(self.whole[VEHICLE])

    @property
    def first_us(self) -> I64:
        """Return when its first track was listed."""
        return np.asarray(self.whole[FIRST_US])

    @property
    def track_us(self) -> I64:
        """Return when its newest track was listed."""
        return np.asarray(self.whole[TRACK_US])

    @property
    def last_us(self) -> I64:
        """Return when it was measured last."""
        return np.asarray(self.whole[LAST_US])

    def take(self, index: I64 | Bool) -> Vehicles:
        """Return the vehicles at `index` (integers or a mask)."""
        where = np.flatnonzero(index) if index.dtype == np.bool_ else index
        return Vehicles(self.whole.take(where, axis=1), self.real.take(where, axis=1))


@dataclass(frozen=True, slots=True)
class Joined:
    """The vehicles after a scan, (V,), and where each comes from."""

    vehicles: Vehicles
    origin: I64 | None  # (V,) its place among those before, -1: new; None: they are the same ones
    measured: I64  # (V,) its place in the scan, -1: not measured now
    from_us: I64  # (V,) its last measurement before; of a new one its birth, from where it is moved back
    from_x_m: F64
    from_y_m: F64
    from_number: I64  # of the track that carried it there


def no_vehicles() -> Vehicles:
    """Return the state before the first scan."""
    return Vehicles(np.zeros((_WHOLE_ROWS, 0), dtype=np.int64), np.zeros((_REAL_ROWS, 0)))


def join(before: Vehicles, scan: Scan, p: CountParameters) -> Joined:
    """Return the vehicles after a scan: pieces joined, those lost for longer than a gap forgotten."""
    gap_us = round(p.stitch_gap_s * 1e6)
    place = find(scan.number, before.number)  # of each vehicle in the scan
    fresh = find(before.number, scan.number) < 0
    starts = np.flatnonzero(fresh)
    stay = (place >= 0) | (scan.time_us - before.last_us <= gap_us)
    if not len(starts) and stay.all():
        return _same(before, scan, place)
    takes = _takes(before, np.flatnonzero(place < 0), scan, starts, p)
    for start, end in takes:
        place[end], stay[end], fresh[start] = start, True, False
    starts = np.flatnonzero(fresh)
    origin = np.concatenate([np.flatnonzero(stay), np.full(len(starts), -1)])
    measured = np.concatenate([place[stay], starts])
    number = np.where(measured >= 0, scan.number[measured] if len(scan.number) else 0, 0)
    number = np.where(measured >= 0, number, before.number[origin] if len(before) else 0)
    order = np.argsort(number, kind="stable")
    origin, measured, number = origin[order], measured[order], number[order]
    return _joined(before, scan, origin, measured, number)


def _same(before: Vehicles, scan: Scan, measured: I64) -> Joined:
    """Return the vehicles of before, carried on by the same tracks."""
    seen = measured >= 0
    whole = before.whole.copy()
    whole[LAST_US][seen] = scan.time_us
    real = _newest(scan, measured, seen, before.real)
    return Joined(
        Vehicles(whole, real), None, measured, before.last_us, before.real[X], before.real[Y], before.number
    )


def _joined(before: Vehicles, scan: Scan, origin: I64, measured: I64, number: I64) -> Joined:
    new, seen = origin < 0, measured >= 0
    # what stands at -1 means nothing
    blank = Vehicles(
        np.zeros((_WHOLE_ROWS, len(origin)), dtype=np.int64), np.zeros((_REAL_ROWS, len(origin)))
    )
    old = before.take(origin) if len(before) else blank
    whole = old.whole.copy()
    whole[NUMBER] = number
    whole[VEHICLE][new] = number[new]
    whole[FIRST_US][new] = scan.time_us
    whole[TRACK_US][new | (number != old.number)] = scan.time_us
    whole[LAST_US][seen] = scan.time_us
    real = _newest(scan, measured, seen, old.real)
    born_us = np.where(seen, scan.born_us[measured], whole[TRACK_US]) if len(scan.number) else whole[TRACK_US]
    age_us = scan.time_us - born_us
    return Joined(
        vehicles=Vehicles(whole, real),
        origin=origin,
        measured=measured,
        from_us=np.where(new, scan.time_us - age_us, old.last_us),
        from_x_m=np.where(new, real[X] - real[VX] * age_us / 1e6, old.real[X]),
        from_y_m=np.where(new, real[Y] - real[VY] * age_us / 1e6, old.real[Y]),
        from_number=np.where(new, number, old.number),
    )


def _newest(scan: Scan, measured: I64, seen: Bool, old: F64) -> F64:
    """Return places and velocities (4, V): those of the scan where a vehicle is in it."""
    return np.where(seen, scan.real[PLANE].take(measured, axis=1), old) if len(scan.number) else old


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
    x, y, vx, vy = scan.real[PLANE][:, starts, None]
    end_x, end_y, end_vx, end_vy = ends.real
    mean_x, mean_y = (vx + end_vx) / 2, (vy + end_vy) / 2
    off_x, off_y = x - end_x - mean_x * gap_s, y - end_y - mean_y * gap_s
    speed = np.hypot(mean_x, mean_y)
    unit_x, unit_y = mean_x / np.maximum(speed, _SLOW_MPS), mean_y / np.maximum(speed, _SLOW_MPS)
    along = off_x * unit_x + off_y * unit_y
    across = np.sqrt(np.maximum(off_x**2 + off_y**2 - along**2, 0.0))
    apart = np.hypot(vx - end_vx, vy - end_vy)
    cost = (along / (p.stitch_along_m + p.stitch_along_mps * gap_s)) ** 2
    cost += (across / (p.stitch_across_m + p.stitch_across_mps * gap_s)) ** 2
    cost += (apart / p.stitch_speed_mps) ** 2
    opposite = vx * end_vx + vy * end_vy < -(_SLOW_MPS**2)
    cost[opposite | (gap_s > p.stitch_gap_s) | (gap_s <= 0)] = np.inf
    return np.asarray(cost)
