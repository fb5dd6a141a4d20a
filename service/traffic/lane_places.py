"""Where vehicles are on the lanes: how they stand to count lines along theirs, and in which lane one crossed.

Both go by the place on the lanes of a map itself, without the hysteresis of a vehicle's lane from frame to
frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from service.tracking.kernel import kernel, part
from service.tracking.model import F64, I64, Bool
from service.traffic.cells import Ruler
from service.traffic.lines import Line, directions
from service.traffic.model import NO_LANE

_ALONG_COSINE = math.cos(math.radians(30.0))  # between a vehicle's way and the lane that it drives along
_ACROSS_COSINE = math.cos(math.radians(50.0))  # between the way across a line and the lane it is crossed in
_AGAINST_M = 1.0  # that a lane of the other direction must be nearer


@dataclass(frozen=True, slots=True)
class Way:
    """How a vehicle stands to a line along its lane."""

    ahead_m: float  # to the line, in the direction in which it drives; negative: behind it
    x_m: float  # where it crosses, or has crossed
    y_m: float
    lane: int
    direction: int


@dataclass(frozen=True, slots=True)
class Stands:
    """How N vehicles stand to L lines: (N, L) as in `Way`, NaN where a vehicle's lane does not lead over."""

    ahead_m: F64
    x_m: F64
    y_m: F64
    direction: I64
    lane: I64  # (N,)

    def ways(self, row: int) -> Iterator[tuple[int, Way]]:
        """Yield each line that the lane of a vehicle leads over, and how the vehicle stands to it."""
        for line in np.flatnonzero(~np.isnan(self.ahead_m[row])).tolist():
            at = row, line
            yield (
                line,
                Way(
                    ahead_m=float(self.ahead_m[at]),
                    x_m=float(self.x_m[at]),
                    y_m=float(self.y_m[at]),
                    lane=int(self.lane[row]),
                    direction=int(self.direction[at]),
                ),
            )

    def beside(self, line: int, way: Way, across_m: float) -> Bool:
        """Return (N,) which vehicles go over a line the same way, no farther than that from it."""
        away_m = np.hypot(self.x_m[:, line] - way.x_m, self.y_m[:, line] - way.y_m)
        return np.asarray((self.direction[:, line] == way.direction) & (away_m < across_m))


def ways(state: F64, lines: Sequence[Line], ruler: Ruler) -> Iterator[tuple[int, Way]]:
    """Yield what `Stands.ways` does, of one vehicle; state: x_m, y_m, vx_mps, vy_mps and more."""
    return stands(state[:, None], lines, ruler).ways(0)


def stands(real: F64, lines: Sequence[Line], ruler: Ruler) -> Stands:
    """Return how vehicles stand to lines; real: rows x_m, y_m, vx_mps, vy_mps and more, one column each."""
    shape = real.shape[1], len(lines)
    found = Stands(
        np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape, np.nan),
        np.zeros(shape, dtype=np.int64), np.full(shape[0], NO_LANE, dtype=np.int64),
    )  # fmt: skip
    _stand(
        np.ascontiguousarray(real[:4].T), np.array(ruler.lane, dtype=np.int64), ruler.first, ruler.points_m,
        ruler.half_width_m, ruler.turn, directions(tuple(lines)),
        np.array([line.length_m for line in lines]),
        found.ahead_m, found.x_m, found.y_m, found.direction, found.lane,
    )  # fmt: skip
    return found


@kernel
def _stand(  # noqa: PLR0913, PLR0917 - arrays are a kernel's language
    state: F64, index: I64, first: I64, points: F64, half_width: F64, turn: Bool, lines: F64, length: F64,
    ahead: F64, x_m: F64, y_m: F64, direction: I64, found: I64,
) -> None:  # fmt: skip
    """Write how vehicles stand to lines into the last five, as `Stands` has them.

    state (N, 4); lines (4, L): where each begins and its unit vector; length (L,).
    """
    for row in range(len(state)):
        lane, left, along, forward, nearest = -1, 0.0, 0.0, 1.0, math.inf
        for k in range(len(turn)):
            if not turn[k]:
                inside, at, beside, cosine = _foot(
                    state[row, :2], state[row, 2:], first[k], first[k + 1], points
                )
                cost = abs(beside) + (_AGAINST_M if cosine < 0.0 else 0.0)
                fits = inside and abs(cosine) >= _ALONG_COSINE and abs(beside) <= half_width[k]
                if fits and cost < nearest:
                    lane, left, along, nearest = k, beside, at, cost
                    forward = 1.0 if cosine > 0.0 else -1.0
        if lane < 0:
            continue
        found[row] = index[lane]
        for i in range(len(length)):
            ux, uy, behind = lines[2, i], lines[3, i], 0.0
            for k in range(first[lane], first[lane + 1] - 1):
                ex, ey = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
                dx, dy = points[k, 0] - lines[0, i], points[k, 1] - lines[1, i]
                step, before = math.sqrt(ex * ex + ey * ey), ux * dy - uy * dx
                after = before + ux * ey - uy * ex
                if (before >= 0.0) != (after >= 0.0):
                    share = before / (before - after)
                    x, y = dx + share * ex, dy + share * ey
                    if 0.0 <= ux * x + uy * y <= length[i]:
                        ahead[row, i] = forward * (behind + share * step - along)
                        x_m[row, i] = lines[0, i] + x - left * ey / step
                        y_m[row, i] = lines[1, i] + y + left * ex / step
                        direction[row, i] = 1 if (after - before) * forward > 0.0 else -1
                        break
                behind += step


def lanes_at(place_m: F64, way: F64, lane: I64, ruler: Ruler, *, stay: bool = False) -> I64:
    """Return the lane (N,) of places (N, 2) on lines: the nearest that goes that way, else the one it had.

    way: (N, 2) unit vectors across the lines; lane: (N,) that the vehicles had; stay: it keeps those that lie
    inside of it.
    """
    found = lane.copy()
    _lanes_at(
        place_m, way, found, np.array(ruler.lane, dtype=np.int64), ruler.first, ruler.points_m,
        ruler.half_width_m, ruler.turn, stay,
    )  # fmt: skip
    return found


@kernel
def _lanes_at(  # noqa: PLR0913, PLR0917 - arrays are a kernel's language
    place: F64, way: F64, found: I64, index: I64, first: I64, points: F64, half_width: F64, turn: Bool,
    stay: bool,  # noqa: FBT001 - a kernel has no names for its arguments
) -> None:  # fmt: skip
    """Write the lane of each place over the one that its vehicle had."""
    for i in range(len(place)):
        lane, best, nearest, mine = found[i], NO_LANE, math.inf, math.inf
        for k in range(len(index)):
            inside, _, left, cosine = _foot(place[i], way[i], first[k], first[k + 1], points)
            away = abs(left)
            if not inside or abs(cosine) < _ACROSS_COSINE:
                continue
            if index[k] == lane:
                mine = away
                if turn[k] or (stay and away <= half_width[k]):
                    best = NO_LANE  # ways through a junction lie upon one another
                    break
            if away > half_width[k] or turn[k]:
                continue
            cost = away + (_AGAINST_M if cosine < 0.0 else 0.0)
            if cost < nearest:
                best, nearest = index[k], cost
        if best != NO_LANE and (lane == NO_LANE or nearest < mine):
            found[i] = best


@part
def _foot(place: F64, way: F64, first: int, end: int, points: F64) -> tuple[bool, float, float, float]:
    """Return whether a place is beside a polyline, how far along and to its left, the cosine to a way."""
    best, where, share, behind, length = 1e30, first, 0.0, 0.0, 0.0
    for k in range(first, end - 1):
        ex, ey = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
        px, py = place[0] - points[k, 0], place[1] - points[k, 1]
        square = ex * ex + ey * ey
        u = (px * ex + py * ey) / square if square > 0.0 else 0.0
        c = min(max(u, 0.0), 1.0)
        away = (px - c * ex) ** 2 + (py - c * ey) ** 2
        if away < best:
            best, where, share, behind = away, k, u, length
        length += math.sqrt(square)
    ex, ey = points[where + 1, 0] - points[where, 0], points[where + 1, 1] - points[where, 1]
    px, py = place[0] - points[where, 0], place[1] - points[where, 1]
    step = math.sqrt(ex * ex + ey * ey)
    outside = (where == first and share < 0.0) or (where == end - 2 and share > 1.0)
    along = behind + min(max(share, 0.0), 1.0) * step
    speed = max(math.sqrt(way[0] ** 2 + way[1] ** 2), 1e-9)
    return not outside, along, (ex * py - ey * px) / step, (ex * way[0] + ey * way[1]) / (step * speed)
