"""How vehicles stand to count lines along their lanes: how far ahead, and where they go over them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from service.tracking.kernel import kernel, part
from service.tracking.model import F64, I64, Bool
from service.traffic.cells import Ruler
from service.traffic.lines import Line, directions
from service.traffic.measured import VX, VY, X, Y

_LEAST_COSINE = math.cos(math.radians(30.0))  # between a vehicle's way and its lane
_AGAINST_M = 1.0  # that a lane of the other direction must be nearer


@dataclass(frozen=True, slots=True)
class Way:
    """How a vehicle stands to a line along its lane."""

    ahead_m: float  # to the line, in the direction in which it drives; negative: behind it
    x_m: float  # where it crosses, or has crossed
    y_m: float
    lane: int
    direction: int


def ways(state: F64, lines: Sequence[Line], ruler: Ruler) -> Iterator[tuple[int, Way]]:
    """Yield each line that the lane of a vehicle leads over, and how the vehicle stands to it.

    state: x_m, y_m, vx_mps, vy_mps and more.
    """
    k, left_m, along_m, forward, met = lane_over(state, lines, ruler)
    for line, (at_m, x_m, y_m, ux, uy, leftward) in enumerate(met.tolist()):
        if not math.isnan(at_m):
            yield (
                line,
                Way(
                    ahead_m=forward * (at_m - along_m),
                    x_m=x_m - left_m * uy,
                    y_m=y_m + left_m * ux,
                    lane=ruler.lane[k],
                    direction=1 if leftward * forward > 0 else -1,
                ),
            )


def lane_over(state: F64, lines: Sequence[Line], ruler: Ruler) -> tuple[int, float, float, float, F64]:
    """Return the place in the ruler of the lane that a vehicle drives in, and how it lies to the lines.

    What `_over` returns, and the table that it writes; state as in `ways`.
    """
    met = np.full((len(lines), 6), np.nan)
    line_m = np.array([line.length_m for line in lines])
    found = _over(
        state[[X, Y]], state[[VX, VY]], ruler.first, ruler.points_m, ruler.half_width_m, ruler.turn,
        directions(tuple(lines)), line_m, met,
    )  # fmt: skip
    return *found, met


@kernel
def _over(  # noqa: PLR0913, PLR0917 - arrays are a kernel's language
    place: F64, way: F64, first: I64, points: F64, half_width: F64, turn: Bool, lines: F64, length: F64,
    met: F64,
) -> tuple[int, float, float, float]:  # fmt: skip
    """Return the lane that a vehicle drives in, how far to its left and along it, and 1 forward, -1 back.

    Lane -1: none but turns. lines (4, L): where each begins and its unit vector; length (L,).
    Written into met (L, 6), of each line that the lane goes over: how far along the lane, where (x, y), the
    lane's unit vector there, and by how much it goes to the left of the line.
    """
    lane, left, along, forward, nearest = -1, 0.0, 0.0, 1.0, math.inf
    for k in range(len(turn)):
        if not turn[k]:
            inside, at, beside, cosine = _foot(place, way, first[k], first[k + 1], points)
            cost = abs(beside) + (_AGAINST_M if cosine < 0.0 else 0.0)
            fits = inside and abs(cosine) >= _LEAST_COSINE and abs(beside) <= half_width[k]
            if fits and cost < nearest:
                lane, left, along, nearest = k, beside, at, cost
                forward = 1.0 if cosine > 0.0 else -1.0
    if lane < 0:
        return lane, left, along, forward
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
                    met[i, 0], met[i, 1], met[i, 2] = behind + share * step, lines[0, i] + x, lines[1, i] + y
                    met[i, 3], met[i, 4], met[i, 5] = ex / step, ey / step, after - before
                    break
            behind += step
    return lane, left, along, forward


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
