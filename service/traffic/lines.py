"""Count lines as straight segments of the plan frame: on which side of each is a point, and how far."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from service.formats.sensor import CountLine
from service.tracking.model import F64


@dataclass(frozen=True, slots=True)
class Line:
    """A segment from p0 to p1. Whoever goes to the left of that way crosses in direction +1."""

    line_id: str
    x0_m: float
    y0_m: float
    x1_m: float
    y1_m: float

    @property
    def length_m(self) -> float:
        """Return the distance between the ends."""
        return math.hypot(self.x1_m - self.x0_m, self.y1_m - self.y0_m)


def lines_of(drawn: Sequence[CountLine]) -> tuple[Line, ...]:
    """Return the count lines of a configuration, without those that have no length."""
    lines = (Line(line.line_id, *line.p0, *line.p1) for line in drawn)
    return tuple(line for line in lines if line.length_m > 0)


def sides(lines: Sequence[Line], x_m: F64, y_m: F64) -> tuple[F64, F64]:
    """Return for N points and L lines, (N, L) each, the signed distance and the place along the line [m].

    The distance is positive to the left of the way from p0 to p1; the place is 0 at p0.
    """
    x0, y0, ux, uy = directions(tuple(lines))
    dx, dy = x_m[:, None] - x0, y_m[:, None] - y0
    return ux * dy - uy * dx, ux * dx + uy * dy


@lru_cache(maxsize=256)  # sensors of one process
def directions(lines: tuple[Line, ...]) -> F64:
    """Return (4, L) where each line begins, and its unit vector."""
    ends = np.array([(line.x0_m, line.y0_m, line.x1_m, line.y1_m) for line in lines]).reshape(-1, 4).T
    along = ends[2:] - ends[:2]
    return np.concatenate([ends[:2], along / np.hypot(along[0], along[1])])
