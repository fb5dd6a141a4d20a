"""Learn where the radar always sees the same standing points, so that posts and rails start no tracks.

The map holds, per cell of range and azimuth, how often a lone standing point was seen there lately. A vehicle
that stands gives several points beside one another; a post gives exactly one, so only lone points are
learned, and those of a track that was found to be on a post.

A frame may show one point or two of a vehicle, too. Within a second they lie in several places, and the echo
of each comes and goes, since several parts of the vehicle answer there; that of a post is nearly as strong
in every frame. So what was spread out and faded in the last second is not learned, either.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.tracking.boxes import PECHO, PG, PV, PVAR_AZ, PVAR_R, PX, PY
from service.tracking.kernel import kernel, part
from service.tracking.model import F32, F64, Bool

# Less is forgotten: far below what adding a hit could notice, and far above the subnormal numbers that a cell
# would end at after half an hour, with which a processor multiplies a hundred times slower.
_NOTHING = 1e-20


@dataclass(frozen=True, slots=True)
class ClutterParameters:
    """Cells, memory and thresholds of the clutter map."""

    cell_range_m: float = 0.4
    cell_azimuth_rad: float = math.radians(0.5)
    learn_frames: float = 40.0  # time constant with which a cell that always gives a point fills
    forget_frames: float = 400.0  # ... and with which it empties: a post hidden by a queue is not forgotten
    standing_mps: float = 0.45  # slower points may be standing: 4 Doppler deviations
    slow_mps: float = 1.3  # swaying foliage stays under this
    ignore_occupancy: float = 0.35  # a standing point in such a cell is not used
    no_birth_occupancy: float = 0.2  # a slow point in such a cell starts nothing
    lone_range_m: float = 1.6  # two more standing points so near make it none of a post, ...
    lone_reach_m: float = 3.0  # ... as those of a vehicle seen from the side ...
    lone_along_m: float = 3.2  # ... or end-on, from above: along the line of sight ...
    lone_beside_m: float = 1.8  # ... and across it
    # what stood in the last second and nobody claimed is of a vehicle if the echoes from one place differ ...
    place_m: float = 0.35  # places are one within this in range ...
    place_stds: float = 2.0  # ... and so many deviations in azimuth
    place_points: int = 6  # fewer tell nothing
    fades_db: float = 2.0  # deviation of the echoes: of 5,000 posts 6 % had more, of 2,400 vehicles 82 %
    # ... and its points are spread over more than their noise
    around_along_m: float = 2.2  # along the line of sight ...
    around_beside_m: float = 2.4  # ... and across it
    deep_times: float = 4.0  # the variance of range, at least ...
    deep_m2: float = 0.06  # ... and this more
    wide_times: float = 2.5  # the same, of azimuth
    wide_m2: float = 0.15
    rail_reach_m: float = 6.0  # posts of a rail stand about 4 m apart
    range_max_m: float = 180.0
    azimuth_max_rad: float = math.radians(70.0)


class Before(NamedTuple):
    """What stood before a frame."""

    points: F64  # (M, POINT_COLUMNS) that stood in the last second, where no clutter is known
    owned: Bool  # (M,) and were of a track, also of one not yet confirmed


@dataclass(frozen=True, slots=True)
class ClutterMap:
    """Occupancy (R, A) of the cells, 0..1."""

    occupancy: F32


def empty_map(parameters: ClutterParameters) -> ClutterMap:
    """Return a map that has seen nothing."""
    rows = math.ceil(parameters.range_max_m / parameters.cell_range_m)
    columns = math.ceil(2 * parameters.azimuth_max_rad / parameters.cell_azimuth_rad)
    return ClutterMap(np.zeros((rows, columns), dtype=np.float32))


@part
def cell_of(points: F64, k: int, cells: tuple[float, ...]) -> tuple[int, int]:
    """Return the row and column of a point's cell, which may lie off the map."""
    cell_range, cell_azimuth, azimuth_max = cells
    azimuth = math.atan2(points[k, PX], points[k, PY])
    return math.floor(points[k, PG] / cell_range), math.floor((azimuth + azimuth_max) / cell_azimuth)


@part
def look_up(occupancy: F32, i: int, j: int) -> float:
    """Return the largest occupancy in the 3 x 3 cells around a cell, 0 where that is off the map."""
    rows, columns = occupancy.shape
    best = 0.0
    if i < 0 or j < 0 or i >= rows or j >= columns:
        return best
    for a in range(max(i - 1, 0), min(i + 2, rows)):
        for b in range(max(j - 1, 0), min(j + 2, columns)):
            best = max(best, occupancy[a, b])
    return best


@kernel
def _occupancy_at(occupancy: F32, points: F64, cells: tuple[float, ...]) -> F64:
    out = np.empty(len(points))
    for k in range(len(points)):
        i, j = cell_of(points, k, cells)
        out[k] = look_up(occupancy, i, j)
    return out


@kernel
def _sort(
    occupancy: F32, points: F64, cells: tuple[float, ...], limits: tuple[float, float, float, float],
    sorted_out: Bool,
) -> None:  # fmt: skip
    standing_mps, slow_mps, ignored, no_birth = limits
    for k in range(len(points)):
        speed = abs(points[k, PV])  # not slow where it is unknown: a comparison with NaN is false
        i, j = cell_of(points, k, cells)
        here = look_up(occupancy, i, j)
        sorted_out[1, k] = speed < standing_mps
        sorted_out[0, k] = not (sorted_out[1, k] and here > ignored)
        sorted_out[2, k] = speed < slow_mps and here > no_birth


@part
def _as_of_one_vehicle(points: F64, k: int, m: int, reach: tuple[float, ...]) -> bool:
    """Return whether two points are no further apart than those of a vehicle seen from the side or end-on."""
    range_m, reach_m, along_m, beside_m = reach
    along = abs(points[m, PG] - points[k, PG])
    if along > max(range_m, along_m):
        return False  # nearly always
    apart = math.hypot(points[m, PX] - points[k, PX], points[m, PY] - points[k, PY])
    side_on = along < range_m and apart < reach_m
    return side_on or (along < along_m and apart < math.hypot(along, beside_m))


@part
def _of_a_vehicle(points: F64, k: int, before: F64, owned: Bool, q: tuple[float, ...]) -> bool:
    """Return whether what stood around point k in the last second, and nobody claimed, was a vehicle."""
    place_m, place_stds, fewest, fades_db, along_m, beside_m, deep_times, deep_m2, wide_times, wide_m2 = q
    g = points[k, PG]
    sine, cosine, var_w = points[k, PX] / g, points[k, PY] / g, g * g * points[k, PVAR_AZ]
    place_w = place_stds * math.sqrt(var_w)
    around = sum_u = sum_uu = sum_w = sum_ww = 0.0
    here = sum_e = sum_ee = 0.0
    for m in range(len(before)):
        u, w = before[m, PG] - g, cosine * before[m, PX] - sine * before[m, PY]
        if owned[m] or abs(u) > along_m or abs(w) > beside_m:
            continue  # nearly always
        around += 1.0
        sum_u, sum_uu, sum_w, sum_ww = sum_u + u, sum_uu + u * u, sum_w + w, sum_ww + w * w
        if abs(u) < place_m and abs(w) < place_w:
            e = before[m, PECHO] - points[k, PECHO]
            here, sum_e, sum_ee = here + 1.0, sum_e + e, sum_ee + e * e
    if here < fewest or not sum_ee / here - (sum_e / here) ** 2 >= fades_db * fades_db:  # not a number: no
        return False
    deep, wide = sum_uu / around - (sum_u / around) ** 2, sum_ww / around - (sum_w / around) ** 2
    return bool(deep > deep_times * points[k, PVAR_R] + deep_m2 or wide > wide_times * var_w + wide_m2)


@kernel
def _learn(
    occupancy: F32, points: F64, free: Bool, post: Bool, before: F64, owned: Bool, cells: tuple[float, ...],
    standing_mps: float, reach: tuple[float, ...], vehicle: tuple[float, ...], ignored: float, gain: float,
    loss: float,
) -> F32:  # fmt: skip
    rows, columns = occupancy.shape
    out = np.empty_like(occupancy)
    keep, nothing = np.float32(1.0 - loss), np.float32(_NOTHING)
    for i in range(rows):
        for j in range(columns):
            left = occupancy[i, j] * keep
            out[i, j] = left if left > nothing else np.float32(0.0)
    n = len(points)
    standing = np.empty(n, np.bool_)
    for k in range(n):
        standing[k] = abs(points[k, PV]) < standing_mps  # not where it is unknown
    for k in range(n):
        if not (standing[k] and (free[k] or post[k])):
            continue
        company = 0
        for m in range(n):
            if m != k and standing[m] and _as_of_one_vehicle(points, k, m, reach):
                company += 1
        i, j = cell_of(points, k, cells)
        if (company > 1 and not post[k]) or i < 0 or j < 0 or i >= rows or j >= columns:
            continue
        if not post[k] and look_up(occupancy, i, j) <= ignored:  # else what stands there is known
            if _of_a_vehicle(points, k, before, owned, vehicle):
                continue
        step = 1.0 if post[k] else gain
        for a in range(max(i - 1, 0), min(i + 2, rows)):
            for b in range(max(j - 1, 0), min(j + 2, columns)):
                share = 1.0 if a == i and b == j else 0.5
                out[a, b] += step * share * (1.0 - out[a, b])
    return out


def _cells(p: ClutterParameters) -> tuple[float, ...]:
    return p.cell_range_m, p.cell_azimuth_rad, p.azimuth_max_rad


def occupancy_at(clutter: ClutterMap, points: F64, parameters: ClutterParameters) -> F64:
    """Return the largest occupancy (N,) in the 3 x 3 cells around each point (N, POINT_COLUMNS)."""
    return _occupancy_at(clutter.occupancy, points, _cells(parameters))


def sort_points(clutter: ClutterMap, points: F64, parameters: ClutterParameters) -> tuple[Bool, Bool, Bool]:
    """Return which points (N,) are usable, which stand, and which may start nothing."""
    p, found = parameters, np.empty((3, len(points)), dtype=np.bool_)
    limits = (p.standing_mps, p.slow_mps, p.ignore_occupancy, p.no_birth_occupancy)
    _sort(clutter.occupancy, points, _cells(p), limits, found)
    return found[0], found[1], found[2]


def learn(
    clutter: ClutterMap, points: F64, free: Bool, post: Bool, before: Before, parameters: ClutterParameters
) -> ClutterMap:
    """Return the map after one more frame.

    free (N,) marks points that no vehicle claims, post (N,) those of a track that was found to be on a post;
    before: what tells those of a vehicle that has no track.
    """
    p = parameters
    return ClutterMap(
        _learn(
            clutter.occupancy, points, free, post, before.points, before.owned, _cells(p),
            p.standing_mps, (p.lone_range_m, p.lone_reach_m, p.lone_along_m, p.lone_beside_m),
            (p.place_m, p.place_stds, float(p.place_points), p.fades_db, p.around_along_m, p.around_beside_m,
             p.deep_times, p.deep_m2, p.wide_times, p.wide_m2),
            p.ignore_occupancy, 1.0 / p.learn_frames, 1.0 / p.forget_frames,
        )
    )  # fmt: skip


def stands_between(
    clutter: ClutterMap,
    range_m: float,
    azimuth_rad: float,
    other_azimuth_rad: float,
    parameters: ClutterParameters,
) -> bool:
    """Return whether clutter stands between two bearings at about this range: a rail that may mirror."""
    p = parameters
    low, high = sorted((azimuth_rad, other_azimuth_rad))
    margin = p.cell_azimuth_rad
    rows = slice(
        max(int((range_m - p.rail_reach_m) / p.cell_range_m), 0),
        int((range_m + p.rail_reach_m) / p.cell_range_m),
    )
    first = int((low + margin + p.azimuth_max_rad) / p.cell_azimuth_rad)
    last = int((high - margin + p.azimuth_max_rad) / p.cell_azimuth_rad)
    cells = clutter.occupancy[rows, max(first, 0) : max(last, 0)]
    return bool(cells.size and cells.max() > p.ignore_occupancy)
