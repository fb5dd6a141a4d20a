"""How likely it is that a vehicle which seems to have changed lanes did so: judged a moment later.

At range a track may slip from its vehicle to the next one, or its place may wander over a boundary. What
tells a change of lanes from that is known two seconds later: how deep the vehicle was in both lanes, how fast
it went across and at what angle, how long it was seen before and behind the boundary, how sure its place is,
and whether another vehicle is so near that one may have been taken for the other. The weights of these are a
logistic regression on simulated and generated recordings, docs/lanes.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, Bool
from service.traffic.curves import beside
from service.traffic.model import Lane, LaneChange, LaneMap, Samples

_US = 1e-6
BEFORE_S, AFTER_S = 2.0, 2.0  # of a change that are looked at
_NEAR_S = (-1.0, 2.0)  # of a change: when another vehicle may be taken for this one
_SLOPE_S, _SLOPE_M = 0.75, 5.0  # on either side of the boundary: of the straight fit of the way across
_JUMP_S = 0.25  # of the fastest step across
_NEAR_CAP_M = 6.0  # farther vehicles do not matter


@dataclass(frozen=True, slots=True)
class ChangeParameters:
    """When a change of lanes is told."""

    least_probability: float = 0.7  # that it was one ...
    least_at_end: float = 0.85  # ... and by the map of a whole recording, which nothing has confirmed
    wait_s: float = 2.0  # after the boundary: what follows shows whether it was one


@dataclass(frozen=True, slots=True)
class Traits:
    """What speaks for a change and against it; metres and seconds."""

    before_m: float  # depth in the lane that was left
    after_m: float  # depth in the lane that was entered
    across_mps: float  # mean speed across the boundary
    angle: float  # metres across for each metre of way
    jump_mps: float  # the fastest step across
    age_s: float  # of the track at the boundary
    left_s: float  # that the track went on to be seen
    std_m: float  # standard deviation of the place across
    neighbour_m: float  # to the nearest other vehicle: half the distance along, or that across
    speed_mps: float


def traits_of(change: LaneChange, lanes: LaneMap, everybody: Samples) -> Traits | None:
    """Return the traits of a change, None where its lanes or its track are not known.

    everybody: samples of all tracks around the time of the change, in order of time for each track.
    """
    old, new = lanes.lane(change.from_lane), lanes.lane(change.to_lane)
    mine = np.flatnonzero(everybody.number == change.number)
    if old is None or new is None or len(mine) < _LEAST:
        return None
    time_s: F64 = np.asarray((everybody.time_us[mine] - change.time_us) * _US, dtype=np.float64)
    x_m, y_m = everybody.x_m[mine].astype(np.float64), everybody.y_m[mine].astype(np.float64)
    past = _past_boundary(x_m, y_m, old, new)
    way_m = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x_m), np.diff(y_m)))])
    way_m -= np.interp(0.0, time_s, way_m)
    known = ~np.isnan(past)
    nearest = int(np.argmin(np.abs(time_s)))
    return Traits(
        before_m=depth(-past[known & (time_s < 0) & (time_s > -BEFORE_S)]),
        after_m=depth(past[known & (time_s > 0) & (time_s < AFTER_S)]),
        across_mps=_slope(time_s, past, known & (np.abs(time_s) <= _SLOPE_S)),
        angle=_slope(way_m, past, known & (np.abs(way_m) <= _SLOPE_M)),
        jump_mps=_jump(time_s, past, known & (np.abs(time_s) <= _SLOPE_S)),
        age_s=max(-float(time_s[0]), 0.0),
        left_s=max(float(time_s[-1]), 0.0),
        std_m=float(everybody.across_std_m[mine[nearest]]),
        neighbour_m=_neighbour(time_s, x_m, y_m, everybody, change),
        speed_mps=float(np.hypot(everybody.vx_mps[mine[nearest]], everybody.vy_mps[mine[nearest]])),
    )


_DEPTH_QUANTILE = 0.9
_LEAST = 4  # samples of a track that can be judged


def _past_boundary(x_m: F64, y_m: F64, old: Lane, new: Lane) -> F64:
    """Return how far past the boundary between two lanes each place is; NaN where a lane is not beside it."""
    points = np.column_stack([x_m, y_m])
    a, b = beside(points, old.points_m), beside(points, new.points_m)
    past = (np.abs(a.right_m) - np.abs(b.right_m)) / 2
    return np.where(a.beyond | b.beyond, np.nan, past)


def depth(past_m: F64) -> float:
    """Return the 0.9 quantile, interpolated as numpy does, which takes ten times as long; 0 for nothing."""
    if not len(past_m):
        return 0.0
    ordered = np.sort(past_m)
    place = _DEPTH_QUANTILE * (len(past_m) - 1)
    below = int(place)
    low, high = float(ordered[below]), float(ordered[min(below + 1, len(past_m) - 1)])
    share = place - below
    return low + (high - low) * share if share < 0.5 else high - (high - low) * (1.0 - share)  # noqa: PLR2004


def _slope(along: F64, past_m: F64, chosen: Bool) -> float:
    """Return the slope of a straight fit, 0 where there is too little for one."""
    t, p = along[chosen], past_m[chosen]
    if len(t) <= 2:  # noqa: PLR2004 - two points fit every line
        return 0.0
    spread = float(np.sum((t - t.mean()) ** 2))
    return float(np.sum((t - t.mean()) * (p - p.mean()))) / spread if spread > 0 else 0.0


def _jump(time_s: F64, past_m: F64, chosen: Bool) -> float:
    t, p = time_s[chosen], past_m[chosen]
    later = np.searchsorted(t, t + _JUMP_S)
    inside = later < len(t)
    if not inside.any():
        return 0.0
    step = p[later[inside]] - p[inside]
    return float(np.max(np.abs(step) / (t[later[inside]] - t[inside])))


def _neighbour(time_s: F64, x_m: F64, y_m: F64, everybody: Samples, change: LaneChange) -> float:
    """Return how near another vehicle came: the larger of half the distance along and that across."""
    when = (everybody.time_us - change.time_us) * _US
    first, last = max(_NEAR_S[0], float(time_s[0])), min(_NEAR_S[1], float(time_s[-1]))
    near = np.flatnonzero((when >= first) & (when <= last))
    near = near[everybody.number[near] != change.number]
    if not len(near):
        return _NEAR_CAP_M
    x = np.interp([-1.0, 1.0], time_s, x_m)
    y = np.interp([-1.0, 1.0], time_s, y_m)
    size = max(math.hypot(x[1] - x[0], y[1] - y[0]), 1e-3)
    ux, uy = (x[1] - x[0]) / size, (y[1] - y[0]) / size
    dx = everybody.x_m[near] - np.interp(when[near], time_s, x_m)
    dy = everybody.y_m[near] - np.interp(when[near], time_s, y_m)
    apart = np.maximum(np.abs(dx * ux + dy * uy) / 2, np.abs(dx * uy - dy * ux))
    return float(min(np.min(apart), _NEAR_CAP_M))


def probability(t: Traits) -> float:
    """Return the probability that the vehicle changed its lane."""
    weighed = (
        _CONSTANT
        + _CROWD * max(_CROWD_M - t.neighbour_m, 0.0)
        + _ACROSS * max(t.across_mps - 1.5, 0.0)
        + _JUMP * max(t.jump_mps - 2.0, 0.0)
        + _ANGLE * max(t.angle - 0.25, 0.0)
        + _LEFT * math.log(t.left_s + 0.1)
        + _BEFORE * min(max(t.before_m, 0.0), 1.0)
        + _AFTER * min(max(t.after_m, 0.0), 1.0)
        + _STD * t.std_m
        + (_SLOW if t.speed_mps < _SLOW_MPS else 0.0)
    )
    return 1.0 / (1.0 + math.exp(-weighed))


# Log odds for each unit: from 332 seeming changes in 23 recordings, 232 of them real
_CONSTANT, _CROWD, _ACROSS, _JUMP, _ANGLE = 0.28, -0.67, -0.83, -0.31, -4.68
_LEFT, _BEFORE, _AFTER, _STD, _SLOW = 0.34, 1.40, 1.13, -2.34, -0.73
_CROWD_M = 4.0  # a neighbour nearer than this may be taken for the vehicle
_SLOW_MPS = 2.0
