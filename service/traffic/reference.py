"""Find the course of a road from the headings of the paths along it: the reference curve.

Headings are integrated, because lanes run parallel: the curve then does not bend where one lane carries more
traffic than another, as a curve through the mean positions would.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, Bool
from service.traffic.curves import Beside, along, beside_in_steps, headings, resample, wrap
from service.traffic.lane_lines import smoothed
from service.traffic.steps import Steps


@dataclass(frozen=True, slots=True)
class ReferenceParameters:
    """How the course of a road is fitted."""

    rounds: int = 3  # of projecting and integrating
    step_m: float = 5.0  # between points of the curve
    stiffness: float = 10.0  # of the smoothing, against the paths at a point
    paths_that_count: float = 50.0  # more points at one place weigh no more
    extend_m: float = 20.0  # beyond the ends of the longest path
    parallel_deg: float = 15.0  # paths within this angle of the course run along it
    reach_m: float = 30.0  # ... and within this distance


def follows(place: Beside, heading_rad: F64, p: ReferenceParameters) -> Bool:
    """Return which points run along the curve beside which they stand."""
    angle = np.abs(wrap(heading_rad - place.heading_rad))
    near = np.abs(place.right_m) < p.reach_m
    return np.asarray(~place.beyond & near & (angle < math.radians(p.parallel_deg)))


_SORT_WORK = 40  # to sort a point by place and angle


def course(points_m: F64, heading_rad: F64, leader_m: F64, p: ReferenceParameters) -> Steps[F64]:
    """Return the course (K, 2) of the road along which the leader path (P, 2) drives.

    points_m (N, 2) with heading_rad (N,): all paths, those of other roads too.
    """
    curve = _extended(resample(leader_m, p.step_m), p)
    for _ in range(p.rounds):
        place = yield from beside_in_steps(points_m, curve)
        mine = follows(place, heading_rad, p)
        if not mine.any():
            return curve
        curve = _turned(curve, place, heading_rad, mine, p)
        yield len(points_m) * _SORT_WORK
    return curve


def _extended(curve: F64, p: ReferenceParameters) -> F64:
    """Return the curve with a straight piece at both ends."""
    count = max(round(p.extend_m / p.step_m), 1)
    steps = p.step_m * np.arange(1, count + 1)[:, None]
    reach = min(2, len(curve) - 1)
    first, last = curve[0] - curve[reach], curve[-1] - curve[-1 - reach]
    first, last = first / np.hypot(*first), last / np.hypot(*last)
    return np.concatenate([(curve[0] + first * steps)[::-1], curve, curve[-1] + last * steps])


def _turned(curve: F64, place: Beside, heading_rad: F64, mine: Bool, p: ReferenceParameters) -> F64:
    """Return the curve with the headings of the paths along it."""
    length = along(curve)
    node = np.rint(np.interp(place.along_m[mine], length, np.arange(len(curve)))).astype(np.int64)
    turn = wrap(heading_rad[mine] - place.heading_rad[mine])
    order = np.lexsort((turn, node))
    node, turn = node[order], turn[order]
    count = np.bincount(node, minlength=len(curve))
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    seen = count > 0
    median = np.zeros(len(curve))
    median[seen] = turn[first[seen] + (count[seen] - 1) // 2]
    heading = headings(curve) + smoothed(median, np.minimum(count, p.paths_that_count), p.stiffness)
    step = np.diff(length)
    between = 0.5 * (heading[1:] + heading[:-1])
    moved = np.column_stack([np.cumsum(step * np.sin(between)), np.cumsum(step * np.cos(between))])
    new = curve[0] + np.concatenate([np.zeros((1, 2)), moved])
    return np.asarray(new + np.mean(curve - new, axis=0))
