"""Find two tracks that are the halves of one vehicle: they drive off together and stay as far apart.

A truck or bus that stands or crawls when it is found may be taken for two vehicles. At a stand nothing tells
it from two cars bumper to bumper. Of two cars the one behind sets off a second later, and keeps a distance
that grows with its speed (as in all car-following models, such as Treiber et al., Phys. Rev. E 62, 2000); the
halves of a vehicle have one speed and, at any speed, no room between them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.extent import ExtentParameters
from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, U8, Bool, TrackStatus
from service.tracking.state import Tandems, Tracks

_TENTATIVE = int(TrackStatus.TENTATIVE)
_SIDE_ON_COS = 0.5  # of the angle between a box and the line of sight


@dataclass(frozen=True, slots=True)
class TandemParameters:
    """How near, how alike and for how long two tracks must drive to be one vehicle."""

    frames: int = 11  # in a row; 0: none are ever united
    least_mps: float = 2.5  # speed of both
    gap_s: float = 0.35  # from the rear of the box ahead to the front of the other, at their speed ...
    gap_m: float = 2.5  # ... and at any
    overlap_m: float = 1.0  # more than this, and they are beside one another
    like_mps: float = 0.2  # most that their speeds along the line of sight differ ...
    any_mps: float = 1.0  # ... and in any direction, in which they are not as well known
    across_m: float = 1.6  # from the way of either to the other
    # motorcycles follow more closely, and beside others in a lane; but the end of a truck may look as narrow
    narrow_m: float = 1.2
    truck_m: float = 6.0
    silent_frames: int = 1  # that either may have been so long
    length_max_m: float = 19.0  # of both together


def pairs_now(tandems: Tandems, tracks: Tracks, p: TandemParameters) -> Tandems:
    """Return the pairs of confirmed tracks that drive as one now, and for how many frames they have."""
    ahead, behind = _as_one(
        tracks.mean, tracks.heading_rad, tracks.length_m, tracks.width_m, tracks.empty, tracks.status,
        (p.least_mps, p.gap_s, p.gap_m, p.overlap_m, p.like_mps, p.any_mps, p.across_m, p.narrow_m,
         p.truck_m, float(p.silent_frames), p.length_max_m),
    )  # fmt: skip
    if not len(ahead) and not len(tandems.ahead):
        return tandems
    columns = (tandems.ahead, tandems.behind, tandems.frames)
    seen = {(a, b): count for a, b, count in zip(*(column.tolist() for column in columns), strict=True)}
    first, second = tracks.number[ahead], tracks.number[behind]
    pairs = zip(first.tolist(), second.tolist(), strict=True)
    return Tandems(first, second, np.array([seen.get(pair, 0) + 1 for pair in pairs], dtype=np.int64))


def unite(
    tandems: Tandems, tracks: Tracks, p: TandemParameters, size: ExtentParameters
) -> tuple[Tracks, Bool]:
    """Return the tracks, those that have driven as one for long enough united, and which (T,) to drop for it.

    The half nearer to the radar stays, since it is seen better, and reaches as far as the other's points.
    """
    drop = np.zeros(len(tracks), dtype=np.bool_)
    sure = tandems.frames >= p.frames
    if p.frames <= 0 or not sure.any():
        return tracks, drop
    mean, length, width = tracks.mean.copy(), tracks.length_m.copy(), tracks.width_m.copy()
    ring = tracks.extent_m.copy()
    place = {number: i for i, number in enumerate(tracks.number.tolist())}
    for pair in zip(tandems.ahead[sure].tolist(), tandems.behind[sure].tolist(), strict=True):
        near, far = sorted((place[n] for n in pair), key=lambda i: math.hypot(mean[i, 0], mean[i, 3]))
        if drop[near] or drop[far]:
            continue
        drop[far] = True
        s, c = math.sin(tracks.heading_rad[near]), math.cos(tracks.heading_rad[near])
        u = s * (mean[far, 0] - mean[near, 0]) + c * (mean[far, 3] - mean[near, 3])
        half, further = 0.5 * float(length[near]), _reach_m(tracks, far, abs(u), size)
        whole = min(max(half + further, 2.0 * half), p.length_max_m)
        shift = math.copysign(0.5 * whole - half, u)
        mean[near, 0] += s * shift
        mean[near, 3] += c * shift
        length[near], width[near] = whole, size.wide_m if whole > size.wide_from_m else width[near]
        # what it remembers is of a half: it would shrink again before points of the other half are its own
        ring[near] = whole - max(size.end_margin_m, size.end_margin_share * whole)
    return tracks.but(mean=mean, length_m=length, width_m=width, extent_m=ring), drop


def _reach_m(tracks: Tracks, i: int, along_m: float, size: ExtentParameters) -> float:
    """Return how far the points of box i reach, away from another whose centre is so far before its own.

    End-on its near face is known, and how long it is was but assumed where few points told it; side-on both
    ends are seen.
    """
    half = 0.5 * float(tracks.length_m[i])
    aspect = float(tracks.heading_rad[i]) - math.atan2(float(tracks.x_m[i]), float(tracks.y_m[i]))
    known = tracks.extent_m[i][np.isfinite(tracks.extent_m[i])]
    if abs(math.cos(aspect)) < _SIDE_ON_COS:
        return along_m + half
    told = float(np.percentile(known, size.percentile)) if len(known) else 0.0
    return along_m - half + min(told + size.end_margin_m, 2.0 * half)


@kernel
def _as_one(
    mean: F64,
    heading: F64,
    length: F64,
    width: F64,
    empty: I64,
    status: U8,
    q: tuple[float, ...],
) -> tuple[I64, I64]:
    """Return pairs of confirmed tracks, one close behind the other in its lane and as fast."""
    least, gap_s, gap_m, most_overlap, like, like_any, lane_across, narrow, truck, silent, longest = q
    ahead, behind = np.empty(len(heading), np.int64), np.empty(len(heading), np.int64)
    pairs = 0
    for i in range(len(heading)):  # the one behind, and j the one ahead of it that is nearest
        speed = math.hypot(mean[i, 1], mean[i, 4])
        if speed <= least or empty[i] > silent or status[i] == _TENTATIVE:
            continue
        s, c = math.sin(heading[i]), math.cos(heading[i])
        g = max(math.hypot(mean[i, 0], mean[i, 3]), 1e-6)
        nearest, chosen = np.inf, -1
        for j in range(len(heading)):
            dx, dy = mean[j, 0] - mean[i, 0], mean[j, 3] - mean[i, 3]
            if i == j or abs(c * dx - s * dy) >= lane_across or abs(dy) > longest or abs(dx) > longest:
                continue  # nearly always
            if status[j] == _TENTATIVE or empty[j] > silent:
                continue
            if min(width[i], width[j]) < narrow and max(length[i], length[j]) < truck:
                continue
            along, both = s * dx + c * dy, 0.5 * (length[i] + length[j])
            if not max(both - most_overlap, 0.0) < along < nearest or along + both > longest:
                continue
            if math.hypot(mean[j, 1], mean[j, 4]) <= least or along - both >= min(gap_s * speed, gap_m):
                continue
            sj, cj = math.sin(heading[j]), math.cos(heading[j])
            if abs(cj * dx - sj * dy) >= lane_across:
                continue
            dv_x, dv_y = mean[j, 1] - mean[i, 1], mean[j, 4] - mean[i, 4]
            if abs(mean[i, 0] * dv_x + mean[i, 3] * dv_y) < like * g and math.hypot(dv_x, dv_y) < like_any:
                nearest, chosen = along, j
        if chosen >= 0:
            ahead[pairs], behind[pairs] = chosen, i
            pairs += 1
    return ahead[:pairs], behind[:pairs]
