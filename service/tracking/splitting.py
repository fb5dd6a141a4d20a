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
from service.tracking.model import F64, I64, Bool
from service.tracking.state import Tracks, Window

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
    if not (tracks.scatter > p.scatter).any():
        return np.empty(0, dtype=np.int64)  # nearly always
    end_on = np.abs(np.cos(tracks.heading_rad - np.arctan2(tracks.x_m, tracks.y_m))) > _END_ON_COS
    due = (tracks.hits >= p.min_hits) & (tracks.hits % p.every_hits == 0)
    doubt = tracks.confirmed & (tracks.scatter > p.scatter) & due & end_on
    return np.flatnonzero(doubt & (tracks.speed_mps > p.speed_min_mps))


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
    age_s, q = (time_us - window.time_us) / 1e6, window.points
    dx = q[:, PX] + age_s * tracks.mean[i, 1] - tracks.x_m[i]
    dy = q[:, PY] + age_s * tracks.mean[i, 4] - tracks.y_m[i]
    along_m = 0.5 * tracks.length_m[i] + p.ahead_m
    near = np.flatnonzero(dx * dx + dy * dy < along_m**2 + p.across_m**2)
    q, dx, dy = q[near], dx[near], dy[near]
    s, c = math.sin(tracks.heading_rad[i]), math.cos(tracks.heading_rad[i])
    u, w = s * dx + c * dy, c * dx - s * dy
    rate = q[:, PV] - (tracks.mean[i, 1] * q[:, PX] + tracks.mean[i, 4] * q[:, PY]) / np.maximum(
        q[:, PG], 1.0
    )
    mine: Bool = (np.abs(u) < along_m) & (np.abs(w) < p.across_m)
    mine &= np.abs(rate) < p.like_mps
    if mine.sum() < 2 * p.group_points:
        return None
    order = np.argsort(w[mine], kind="stable")
    w, u = w[mine][order], u[mine][order]
    variance = (q[mine, PG] ** 2 * q[mine, PVAR_AZ])[order] + (0.25 * tracks.width_m[i]) ** 2
    n = len(w)
    k = np.arange(p.group_points, n - p.group_points + 1)
    left = np.cumsum(w)[k - 1] / k
    right = (w.sum() - np.cumsum(w)[k - 1]) / (n - k)
    best = int(np.argmax(k * (n - k) * (right - left) ** 2))
    cut, a, b = int(k[best]), float(left[best]), float(right[best])
    if b - a < p.apart_m or a > -p.aside_m or b < p.aside_m:
        return None
    if max(np.var(w[:cut]) / variance[:cut].mean(), np.var(w[cut:]) / variance[cut:].mean()) > p.group_noise:
        return None
    return (
        (a, b, float(u[cut:].mean() - u[:cut].mean()))
        if cut >= n - cut
        else (b, a, float(u[:cut].mean() - u[cut:].mean()))
    )


def _taken(tracks: Tracks, i: int, x: float, y: float, across_m: float) -> bool:
    """Return whether another track than i stands there."""
    s, c = np.sin(tracks.heading_rad), np.cos(tracks.heading_rad)
    dx, dy = x - tracks.x_m, y - tracks.y_m
    there = (np.abs(s * dx + c * dy) < 0.5 * tracks.length_m + 1.0) & (np.abs(c * dx - s * dy) < across_m)
    there[i] = False
    return bool(there.any())
