"""Join the pieces of one vehicle: a track that begins where another, lost a moment ago, would be now.

Each vehicle is a chain of tracks, named by the number of its first. Ends are kept for three seconds; a start
takes the end that fits best, each end is taken once. Expected is the end moved by the mean of both
velocities, which on an arc of a circle is the chord, so that no road needs to be known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, Bool
from service.traffic.count_parameters import CountParameters
from service.traffic.measured import PLANE, VX, VY, X, Y
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
    place, stay, starts = _found(before.whole, scan.number, scan.time_us, round(p.stitch_gap_s * 1e6))
    same = not len(starts) and bool(stay.all())
    if len(starts):
        for start, end in _takes(before, np.flatnonzero(place < 0), scan, starts, p):
            place[end], stay[end] = start, True
            starts = starts[starts != start]
    whole, real, links, from_m = _carried(
        before.whole, before.real, place, stay, starts, scan.number, scan.real, scan.born_us, scan.time_us
    )
    return Joined(
        vehicles=Vehicles(whole, real),
        origin=None if same else links[_ORIGIN],
        measured=links[_MEASURED],
        from_us=links[_FROM_US],
        from_x_m=from_m[X],
        from_y_m=from_m[Y],
        from_number=links[_FROM_NUMBER],
    )


@kernel
def _found(whole: I64, number: I64, time_us: int, gap_us: int) -> tuple[I64, Bool, I64]:
    """Return the place in the scan of each vehicle, -1 for none, who is not forgotten, and who begins."""
    place, stay = np.full(whole.shape[1], -1), np.zeros(whole.shape[1], np.bool_)
    starts, count, k = np.empty(len(number), np.int64), 0, 0
    for i in range(whole.shape[1]):
        while k < len(number) and number[k] < whole[NUMBER, i]:
            starts[count] = k
            count += 1
            k += 1
        if k < len(number) and number[k] == whole[NUMBER, i]:
            place[i] = k
            k += 1
        stay[i] = place[i] >= 0 or time_us - whole[LAST_US, i] <= gap_us
    for rest in range(k, len(number)):
        starts[count] = rest
        count += 1
    return place, stay, starts[:count]


# rows of `links`
_ORIGIN, _MEASURED, _FROM_US, _FROM_NUMBER = range(4)


@kernel
def _carried(  # noqa: PLR0913, PLR0917 - one pass over the vehicles; arrays are its language
    before: I64, before_real: F64, place: I64, stay: Bool, starts: I64, number: I64, scanned: F64,
    born_us: I64, time_us: int,
) -> tuple[I64, F64, I64, F64]:  # fmt: skip
    """Return the vehicles after a scan by number: both tables, links to those before, and places then."""
    order, count = np.empty((3, len(stay) + len(starts)), np.int64), 0  # number, origin, measured
    for i in range(len(stay) + len(starts)):
        origin = i if i < len(stay) else -1
        if origin >= 0 and not stay[i]:
            continue
        measured = place[i] if origin >= 0 else starts[i - len(stay)]
        mine = number[measured] if measured >= 0 else before[NUMBER, i]
        k = count  # nearly all are in order already
        while k > 0 and order[0, k - 1] > mine:
            for row in range(3):
                order[row, k] = order[row, k - 1]
            k -= 1
        order[0, k], order[1, k], order[2, k] = mine, origin, measured
        count += 1
    whole, real = np.empty((_WHOLE_ROWS, count), np.int64), np.empty((_REAL_ROWS, count))
    links, from_m = np.empty((4, count), np.int64), np.empty((2, count))
    for k in range(count):
        mine, origin, measured = order[0, k], order[1, k], order[2, k]
        for row in range(_REAL_ROWS):
            real[row, k] = scanned[row, measured] if measured >= 0 else before_real[row, origin]
        links[_ORIGIN, k], links[_MEASURED, k] = origin, measured
        whole[NUMBER, k] = mine
        if origin < 0:
            whole[VEHICLE, k] = mine
            whole[FIRST_US, k] = whole[TRACK_US, k] = whole[LAST_US, k] = time_us
            links[_FROM_US, k], links[_FROM_NUMBER, k] = born_us[measured], mine
            age_us = time_us - born_us[measured]
            from_m[X, k] = real[X, k] - real[VX, k] * age_us / 1e6
            from_m[Y, k] = real[Y, k] - real[VY, k] * age_us / 1e6
            continue
        whole[VEHICLE, k], whole[FIRST_US, k] = before[VEHICLE, origin], before[FIRST_US, origin]
        whole[TRACK_US, k] = before[TRACK_US, origin] if mine == before[NUMBER, origin] else time_us
        whole[LAST_US, k] = time_us if measured >= 0 else before[LAST_US, origin]
        links[_FROM_US, k], links[_FROM_NUMBER, k] = before[LAST_US, origin], before[NUMBER, origin]
        from_m[X, k], from_m[Y, k] = before_real[X, origin], before_real[Y, origin]
    return whole, real, links, from_m


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
