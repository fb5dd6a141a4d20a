"""Place count lines across learned lanes where nobody has drawn any: one for each carriageway."""

from __future__ import annotations

import numpy as np

from service.tracking.model import F64
from service.traffic.count_parameters import CountParameters
from service.traffic.lines import Line
from service.traffic.model import Lane, LaneMap


def place_lines(lanes: LaneMap, p: CountParameters) -> tuple[Line, ...]:
    """Return a line across the lanes of each direction, at right angles to them, named auto-1, auto-2, ...

    Each lies at the range `auto_range_m`, or at the nearest range that its lanes reach. From p0 to p1 it goes
    to the right of the way of the traffic, so that everybody crosses in direction +1.
    """
    groups: dict[str, list[Lane]] = {}
    for lane in lanes.lanes:
        if lane.kind == "lane" and lane.direction != "crossing":
            groups.setdefault(lane.direction, []).append(lane)
    placed = [_across(groups[name], p) for name in sorted(groups)]
    return tuple(
        Line(f"auto-{k}", *(round(float(value), 3) for value in ends))
        for k, ends in enumerate(placed, start=1)
    )


def _across(lanes: list[Lane], p: CountParameters) -> tuple[float, float, float, float]:
    """Return x, y of the ends of the line across some lanes."""
    place, heading = _foot(lanes[0].points_m, p.auto_range_m)
    right = np.array([heading[1], -heading[0]])
    offsets = [float(np.dot(_nearest(lane.points_m, place) - place, right)) for lane in lanes]
    p0 = place + right * (min(offsets) - p.auto_margin_m)
    p1 = place + right * (max(offsets) + p.auto_margin_m)
    return p0[0], p0[1], p1[0], p1[1]


def _foot(points_m: F64, range_m: float) -> tuple[F64, F64]:
    """Return the point of a polyline whose range is nearest to the wanted one, and its unit direction."""
    k = int(np.argmin(np.abs(np.hypot(points_m[:, 0], points_m[:, 1]) - range_m)))
    step = points_m[min(k + 1, len(points_m) - 1)] - points_m[max(k - 1, 0)]
    return points_m[k], step / np.hypot(*step)


def _nearest(points_m: F64, place: F64) -> F64:
    return np.asarray(points_m[int(np.argmin(np.hypot(*(points_m - place).T)))])
