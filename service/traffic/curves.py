"""Curves in the plane as polylines: length along them, and where points stand beside them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.kernel import kernel
from service.tracking.model import F64, Bool
from service.traffic.steps import Steps

_STEP_WORK = 300_000  # pairs of a point and a piece of a curve: less than a millisecond


@dataclass(frozen=True, slots=True)
class Beside:
    """Where N points stand beside a curve."""

    along_m: F64  # (N,) from the curve's start to the foot point
    right_m: F64  # (N,) distance to the right of the curve
    heading_rad: F64  # (N,) of the curve there
    beyond: Bool  # (N,) the nearest place is an end of the curve


def along(points_m: F64) -> F64:
    """Return the distance from the start to each of the points (P, 2) along the polyline, (P,)."""
    steps = np.hypot(*np.diff(points_m, axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])


def headings(points_m: F64) -> F64:
    """Return the heading at each point (P,), clockwise from +y, from central differences."""
    step = np.gradient(points_m, axis=0)
    return np.asarray(np.unwrap(np.arctan2(step[:, 0], step[:, 1])))


def wrap(angle_rad: F64) -> F64:
    """Return angles in [-pi, pi)."""
    return np.asarray((angle_rad + math.pi) % (2.0 * math.pi) - math.pi)


def beside(points_m: F64, curve_m: F64) -> Beside:
    """Return where points (N, 2) stand beside a curve (P, 2)."""
    place = np.empty((4, len(points_m)))
    _feet(np.ascontiguousarray(points_m), np.ascontiguousarray(curve_m), along(curve_m), place)
    return Beside(place[0], place[1], place[2], place[3] > 0)


def beside_in_steps(points_m: F64, curve_m: F64) -> Steps[Beside]:
    """Return where points (N, 2) stand beside a curve (P, 2), as `beside` does."""
    length, points, curve = along(curve_m), np.ascontiguousarray(points_m), np.ascontiguousarray(curve_m)
    place = np.empty((4, len(points)))
    share = max(_STEP_WORK // len(curve), 1)
    for begin in range(0, len(points), share):
        part = points[begin : begin + share]
        feet = np.empty((4, len(part)))
        _feet(part, curve, length, feet)
        place[:, begin : begin + share] = feet
        yield len(part) * len(curve)
    return Beside(place[0], place[1], place[2], place[3] > 0)


def at(curve_m: F64, along_m: F64, right_m: F64) -> F64:
    """Return the points (K, 2) that stand `right_m` beside the curve at `along_m`, (K,) each."""
    length = along(curve_m)
    heading = headings(curve_m)
    h = np.interp(along_m, length, heading)
    x = np.interp(along_m, length, curve_m[:, 0]) + right_m * np.cos(h)
    y = np.interp(along_m, length, curve_m[:, 1]) - right_m * np.sin(h)
    return np.column_stack([x, y])


def resample(points_m: F64, step_m: float) -> F64:
    """Return points at equal distances along a polyline, both ends included."""
    length = along(points_m)
    count = max(round(length[-1] / step_m), 1) + 1
    wanted = np.linspace(0.0, length[-1], count)
    return np.column_stack([np.interp(wanted, length, points_m[:, k]) for k in (0, 1)])


@kernel
def _feet(points: F64, curve: F64, length: F64, out: F64) -> None:
    """Write along, right, heading and beyond (0 or 1) of each point into the rows of `out`."""
    last = len(curve) - 2
    for i in range(len(points)):
        best, where, share = 1e30, 0, 0.0
        for k in range(last + 1):
            ex, ey = curve[k + 1, 0] - curve[k, 0], curve[k + 1, 1] - curve[k, 1]
            px, py = points[i, 0] - curve[k, 0], points[i, 1] - curve[k, 1]
            square = ex * ex + ey * ey
            u = (px * ex + py * ey) / square if square > 0.0 else 0.0
            c = min(max(u, 0.0), 1.0)
            away = (px - c * ex) ** 2 + (py - c * ey) ** 2
            if away < best:
                best, where, share = away, k, u
        ex, ey = curve[where + 1, 0] - curve[where, 0], curve[where + 1, 1] - curve[where, 1]
        px, py = points[i, 0] - curve[where, 0], points[i, 1] - curve[where, 1]
        size = math.sqrt(ex * ex + ey * ey)
        if size == 0.0:
            size = 1.0
        inside = min(max(share, 0.0), 1.0)
        out[0, i] = length[where] + inside * size
        right = (px * ey - py * ex) / size
        # beside a corner the foot is the corner itself: the distance keeps its sign
        out[1, i] = math.copysign(math.sqrt(best), right)
        out[2, i] = math.atan2(ex, ey)
        ends = (where == 0 and share < 0.0) or (where == last and share > 1.0)
        out[3, i] = 1.0 if ends else 0.0
