"""Learn the lanes of a road from the paths of vehicles: course by course, then cut at junctions.

The longest path leads: its course is fitted to all that drive along it, and lane lines are found beside it.
What ran along it is done with; the longest of the rest leads next, until nothing long is left. So two
carriageways are two courses, and a vehicle that turns tells of the lane it came by, of its turn, and of the
lane it left by.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from service.tracking.model import F64, I64, Bool
from service.traffic.curves import along, at, beside, beside_in_steps
from service.traffic.evidence import Evidence
from service.traffic.junctions import JunctionParameters, pieces
from service.traffic.lane_lines import Line, LineParameters, lane_lines, offsets
from service.traffic.reference import ReferenceParameters, course, follows
from service.traffic.steps import CALL_WORK, Steps

_FEWEST = 2  # points of a line
_LINE_WORK = 20  # of a point beside a line, in pairs of a point and a piece of a curve


@dataclass(frozen=True, slots=True)
class LearningParameters:
    """How lanes are learned."""

    reference: ReferenceParameters = field(default_factory=ReferenceParameters)
    lines: LineParameters = field(default_factory=LineParameters)
    junctions: JunctionParameters = field(default_factory=JunctionParameters)
    courses: int = 24  # at most
    run_m: float = 24.0  # shorter pieces of paths lead no course
    neighbour_m: float = 5.5  # lanes farther apart are no neighbours
    width_m: float = 3.5  # of a lane without neighbours
    confidence: float = 0.4  # lanes below are not told of at all
    end_share: float = 0.2  # of a lane's paths that reach to where it ends
    point_step_m: float = 4.0  # of a centre line
    twice_m: float = 1.5  # lanes nearer than this, and in the same direction, are one
    same_way: float = 0.9  # cosine between their directions
    twice_share: float = 0.5  # of the length


@dataclass(frozen=True, slots=True)
class Learned:
    """A lane as it was found, not yet known by a number."""

    points_m: F64  # (P, 2) in driving direction
    width_m: F64  # (P,)
    confidence: float
    paths: int
    turn: bool = False


def learn(evidence: Evidence, p: LearningParameters) -> Steps[list[Learned]]:
    """Return the lanes that the evidence tells of."""
    points = np.column_stack([evidence.x_m, evidence.y_m]).astype(np.float64)
    heading = evidence.heading_rad.astype(np.float64)
    left = np.ones(len(points), dtype=np.bool_)
    lanes: list[Learned] = []
    for _ in range(p.courses):
        leader = _longest_run(evidence.path, left)
        if leader is None or len(leader) < _FEWEST or along(points[leader])[-1] < p.run_m:
            break
        index = np.flatnonzero(left)
        curve = yield from course(points[index], heading[index], points[leader], p.reference)
        place = yield from beside_in_steps(points[index], curve)
        mine = follows(place, heading[index], p.reference)
        left[leader] = False
        left[index[mine]] = False
        mine_at = index[mine]
        lanes += yield from _lanes_beside(
            curve, evidence.path[mine_at], place.along_m[mine], place.right_m[mine], p
        )
    lanes = yield from _once(lanes, p)
    return (yield from _in_pieces(lanes, p))


def _in_pieces(lanes: list[Learned], p: LearningParameters) -> Steps[list[Learned]]:
    """Return the lanes cut at junctions."""
    out = []
    cut = yield from pieces([lane.points_m for lane in lanes], p.junctions)
    for lane, parts in zip(lanes, cut, strict=True):
        length = along(lane.points_m)
        for part in parts:
            count = max(round((part.end_m - part.start_m) / p.point_step_m), 1) + 1
            where = np.linspace(part.start_m, part.end_m, count)
            points = np.column_stack([np.interp(where, length, lane.points_m[:, k]) for k in (0, 1)])
            width = np.interp(where, length, lane.width_m)
            out.append(Learned(points, width, lane.confidence, lane.paths, part.turn))
    return out


def _longest_run(path: I64, left: Bool) -> I64 | None:
    """Return the points of the longest piece of a path of which all is left."""
    index = np.flatnonzero(left)
    if not len(index):
        return None
    new = (np.diff(index) != 1) | (np.diff(path[index]) != 0)
    bounds = np.concatenate([[0], np.flatnonzero(new) + 1, [len(index)]])
    longest = int(np.argmax(np.diff(bounds)))
    return index[bounds[longest] : bounds[longest + 1]]


def _lanes_beside(
    curve: F64, path: I64, along_m: F64, right_m: F64, p: LearningParameters
) -> Steps[list[Learned]]:
    _, number = np.unique(path, return_inverse=True)
    if not len(number):
        return []
    window = p.lines.window_m
    first = math.floor(along_m.min() / window)
    middles = (np.arange(first, math.ceil(along_m.max() / window)) + 0.5) * window
    offset = offsets(number, along_m, right_m, middles, p.lines)
    yield len(number) * len(curve)
    lines = yield from lane_lines(offset, middles, p.lines)
    lanes = []
    for k, line in enumerate(lines):
        ends = _ends(line, number, along_m, right_m, p)
        lane = _lane(curve, line, ends, _widths(lines, k, p), p)
        if lane.confidence >= p.confidence:
            lanes.append(lane)
        yield len(number) * _LINE_WORK
    return lanes


def _ends(line: Line, number: I64, along_m: F64, right_m: F64, p: LearningParameters) -> tuple[float, float]:
    """Return from where to where along the course a good many of a line's paths reach."""
    near = np.abs(np.interp(along_m, line.along_m, line.right_m) - right_m) < p.lines.core_m
    near &= np.abs(along_m - np.clip(along_m, line.along_m[0], line.along_m[-1])) <= p.lines.window_m
    count = int(number.max(initial=-1)) + 1
    first, last = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(first, number[near], along_m[near])
    np.maximum.at(last, number[near], along_m[near])
    seen = np.isfinite(first)
    if not seen.any():
        return float(line.along_m[0]), float(line.along_m[-1])
    rank = int(p.end_share * seen.sum())
    return float(np.sort(first[seen])[rank]), float(np.sort(last[seen])[::-1][rank])


def _widths(lines: list[Line], k: int, p: LearningParameters) -> F64:
    """Return the width of a lane (W,): the mean distance to its neighbours on either side."""
    me = lines[k]
    gaps = []
    for other in (*lines[:k], *lines[k + 1 :]):
        gap = np.abs(np.interp(me.along_m, other.along_m, other.right_m, np.nan, np.nan) - me.right_m)
        gaps.append(np.where(gap < p.neighbour_m, gap, np.nan))
    if not gaps:
        return np.full(len(me.along_m), p.width_m)
    nearest = np.sort(np.array(gaps), axis=0)[:2]
    known = np.isfinite(nearest)
    mean = np.where(known, nearest, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return np.where(known.any(axis=0), mean, p.width_m)


def _lane(curve: F64, line: Line, ends: tuple[float, float], width: F64, p: LearningParameters) -> Learned:
    start, end = min(ends[0], line.along_m[0]), max(ends[1], line.along_m[-1])
    count = max(round((end - start) / p.point_step_m), 1) + 1
    where = np.linspace(start, end, count)
    points = at(curve, where, np.interp(where, line.along_m, line.right_m))
    error = line.spread_m / math.sqrt(max(line.paths, 1))
    mean_width = float(np.mean(width))
    confidence = (
        (1.0 - math.exp(-line.paths / 3.0))
        * min(max(1.0 - error / 0.5, 0.0), 1.0)
        * min(1.0, line.windows / 4.0)
        * math.exp(-(((mean_width - p.width_m) / 0.8) ** 2) / 4.0)
    )
    return Learned(points, np.interp(where, line.along_m, width), confidence, line.paths)


def _once(lanes: list[Learned], p: LearningParameters) -> Steps[list[Learned]]:
    """Return the lanes without those that lie on one found before them."""
    kept: list[Learned] = []
    for lane in lanes:
        double = np.zeros(len(lane.points_m), dtype=np.bool_)
        for other in kept:
            place = beside(lane.points_m, other.points_m)
            step = np.gradient(lane.points_m, axis=0)
            same = np.cos(np.arctan2(step[:, 0], step[:, 1]) - place.heading_rad) > p.same_way
            double |= ~place.beyond & same & (np.abs(place.right_m) < p.twice_m)
        if double.mean() < p.twice_share:
            kept.append(lane)
        yield len(kept) * CALL_WORK
    return kept
