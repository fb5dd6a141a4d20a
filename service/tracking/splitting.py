"""Find boxes that hold two vehicles side by side, and part them.

Far away two vehicles abreast are nearer to one another than the azimuth tells from frame to frame: their
points are born as one cluster and held by one box between them. Over a second their scatter across the box is
wider than the noise of one vehicle's, and the points of a window fall into two groups.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.boxes import PG, PV, PVAR_AZ, PX, PY
from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, U8, TrackStatus
from service.tracking.state import Tracks, Window

_TENTATIVE = int(TrackStatus.TENTATIVE)
_END_ON_COS = math.cos(0.45)  # seen further from the side, points across a box tell of its length


@dataclass(frozen=True, slots=True)
class SplittingParameters:
    """When a box holds two vehicles."""

    scatter: float = (
        1.8  # mean square of normalised places across the box, 1 for one vehicle, that raises doubt
    )
    min_hits: int = 15
    every_hits: int = 10  # a doubt that groups did not confirm is looked at again so much later
    speed_min_mps: float = 4.0
    apart_m: float = 2.4  # between the centres of the groups, each on its own side of the box ...
    aside_m: float = 0.7
    group_points: int = 4  # ... of so many points of the window
    group_noise: float = 1.5  # most variance of a group, in variances of one vehicle's points
    like_mps: float = 0.8
    ahead_m: float = 1.5
    across_m: float = 4.5
    taken_m: float = 1.5  # another track so far across the place has it already
    position_std_m: float = 0.6
    speed_std_mps: float = 1.0


def doubtful(tracks: Tracks, p: SplittingParameters) -> I64:
    """Return which moving confirmed tracks (K,) seen end-on have points that scatter too much across them."""
    return _doubtful(
        tracks.mean, tracks.heading_rad, tracks.scatter, tracks.hits, tracks.status, p.min_hits, p.every_hits,
        p.scatter, p.speed_min_mps,
    )  # fmt: skip


@kernel
def _doubtful(
    mean: F64, heading: F64, scatter: F64, hits: I64, status: U8, min_hits: int, every_hits: int,
    most_scatter: float, speed_min: float,
) -> I64:  # fmt: skip
    out, found = np.empty(len(hits), np.int64), 0
    for i in range(len(hits)):
        if not scatter[i] > most_scatter or status[i] == _TENTATIVE:
            continue  # nearly always
        if hits[i] < min_hits or hits[i] % every_hits or math.hypot(mean[i, 1], mean[i, 4]) <= speed_min:
            continue
        if abs(math.cos(heading[i] - math.atan2(mean[i, 0], mean[i, 3]))) > _END_ON_COS:
            out[found] = i
            found += 1
    return out[:found]


def part(
    tracks: Tracks, window: Window, time_us: int, p: SplittingParameters, *, length_m: float
) -> tuple[Tracks, list[F64]]:
    """Return the tracks, those of two vehicles moved to one of them, and rows of Births for the others.

    window: the points of the last frames; length_m: of a new vehicle of which nothing is known yet. A row
    has the columns that `births.gather` takes.
    """
    rows: list[F64] = []
    found = doubtful(tracks, p)
    if not len(found):
        return tracks, rows
    mean, cov, scatter, any_parted = tracks.mean.copy(), tracks.cov.copy(), tracks.scatter.copy(), False
    for i in found:
        s, c = math.sin(tracks.heading_rad[i]), math.cos(tracks.heading_rad[i])
        groups = _two_groups(tracks, int(i), window, time_us, p)
        if groups is None:
            continue
        stays, other, u_other = groups
        scatter[i], any_parted = 1.0, True
        mean[i, 0] += c * stays
        mean[i, 3] -= s * stays
        for a, b in ((0, 0), (0, 3), (3, 0), (3, 3)):
            cov[i, a, b] += p.position_std_m**2 * ((c, 0, 0, -s)[a] * (c, 0, 0, -s)[b])
        x, y = tracks.x_m[i] + c * other + s * u_other, tracks.y_m[i] - s * other + c * u_other
        if _taken(tracks, int(i), x, y, p.taken_m):
            continue
        rows.append(np.array([
            x, y, tracks.heading_rad[i], mean[i, 1], mean[i, 4], p.position_std_m, p.position_std_m,
            p.speed_std_mps, p.speed_std_mps, 1.0, 0.0, length_m, 0.0, max(tracks.heading_var[i], 0.01),
        ]))  # fmt: skip
    return (tracks.but(mean=mean, cov=cov, scatter=scatter) if any_parted else tracks), rows


def _two_groups(
    tracks: Tracks, i: int, window: Window, time_us: int, p: SplittingParameters
) -> tuple[float, float, float] | None:
    """Return how far across lie the group that stays and the other, and how far along the other; or None."""
    length_m = float(tracks.length_m[i])
    row = _row_across(
        window.points, window.time_us, time_us, tracks.mean[i], float(tracks.heading_rad[i]),
        0.5 * length_m + p.ahead_m, p.across_m, p.like_mps, (0.25 * float(tracks.width_m[i])) ** 2,
    )  # fmt: skip
    cut, low, high, further = _best_cut(row, p.group_points, p.group_noise)
    if cut < 0 or high - low < p.apart_m or low > -p.aside_m or high < p.aside_m:
        return None
    return (low, high, further) if 2 * cut >= row.shape[1] else (high, low, -further)


@kernel
def _row_across(
    points: F64, point_time_us: I64, time_us: int, mean: F64, heading: float, along_m: float, across_m: float,
    like_mps: float, width_var_m2: float,
) -> F64:  # fmt: skip
    """Return (3, M) how far across and along a box its points of a window lie, and their variance across.

    They are sorted by their place across. A point belongs to the box when it lies there once it has moved on
    with it, and has its range rate.
    """
    row, count = np.empty((3, len(points))), 0
    s, c = math.sin(heading), math.cos(heading)
    for k in range(len(points)):
        q, age_s = points[k], (time_us - point_time_us[k]) / 1e6
        dx, dy = q[PX] + age_s * mean[1] - mean[0], q[PY] + age_s * mean[4] - mean[3]
        u, w = s * dx + c * dy, c * dx - s * dy
        rate = q[PV] - (mean[1] * q[PX] + mean[4] * q[PY]) / max(q[PG], 1.0)
        if not (abs(u) < along_m and abs(w) < across_m and abs(rate) < like_mps):
            continue
        at = count
        while at > 0 and row[0, at - 1] > w:
            row[0, at], row[1, at], row[2, at] = row[0, at - 1], row[1, at - 1], row[2, at - 1]
            at -= 1
        row[0, at], row[1, at], row[2, at] = w, u, q[PG] * q[PG] * q[PVAR_AZ] + width_var_m2
        count += 1
    return row[:, :count].copy()


@kernel
def _best_cut(row: F64, fewest: int, most_noise: float) -> tuple[int, float, float, float]:
    """Return how many points of a row are left of its best cut, -1 where it falls into no two groups.

    Then the middle of either group across, and how much further along the right one lies. The cut explains
    most of the variance; each group must be no wider than the points of one vehicle.
    """
    n, cut, best, left, total = row.shape[1], -1, -1.0, 0.0, 0.0
    for k in range(n):
        total += row[0, k]
    for k in range(1, n - fewest + 1):
        left += row[0, k - 1]
        between = k * (n - k) * ((total - left) / (n - k) - left / k) ** 2
        if k >= fewest and between > best:
            best, cut = between, k
    middle = np.zeros((2, 2))  # group; across, along
    for group in range(2):
        if cut < 0:
            break
        begin, end = (0, cut) if group == 0 else (cut, n)
        spread = noise = 0.0
        for k in range(begin, end):
            middle[group, 0] += row[0, k] / (end - begin)
            middle[group, 1] += row[1, k] / (end - begin)
            noise += row[2, k]
        for k in range(begin, end):
            spread += (row[0, k] - middle[group, 0]) ** 2
        if spread > most_noise * noise:
            cut = -1
    return cut, middle[0, 0], middle[1, 0], middle[1, 1] - middle[0, 1]


def _taken(tracks: Tracks, i: int, x: float, y: float, across_m: float) -> bool:
    """Return whether another track than i stands there."""
    s, c = np.sin(tracks.heading_rad), np.cos(tracks.heading_rad)
    dx, dy = x - tracks.x_m, y - tracks.y_m
    there = (np.abs(s * dx + c * dy) < 0.5 * tracks.length_m + 1.0) & (np.abs(c * dx - s * dy) < across_m)
    there[i] = False
    return bool(there.any())
