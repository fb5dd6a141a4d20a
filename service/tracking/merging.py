"""Find tracks that are one vehicle: duplicates, and pieces of a long one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from service.tracking.kernel import kernel
from service.tracking.model import F64, Bool
from service.tracking.state import Tracks


@dataclass(frozen=True, slots=True)
class MergingParameters:
    """How near two tracks must be to be one vehicle."""

    same_centre_m: float = 2.0
    same_speed_mps: float = 2.5
    inside_across_m: float = 1.0
    lane_across_m: float = 1.6
    piece_speed_mps: float = 4.0  # pieces are joined only in motion: in a queue the next vehicle is as near
    piece_dv_mps: float = 0.6
    piece_gap_s: float = 0.25
    piece_gap_m: float = 5.0
    length_max_m: float = 19.0


def merge(tracks: Tracks, p: MergingParameters) -> tuple[Tracks, Bool]:
    """Return the tracks, long ones stretched over their pieces, and which of them (T,) to drop."""
    n = len(tracks)
    drop = np.zeros(n, dtype=np.bool_)
    if n < 2 or not _any_near(tracks.mean, 0.5 * p.length_max_m + p.piece_gap_m, p.lane_across_m + 0.6):
        return tracks, drop
    dx = tracks.x_m[None, :] - tracks.x_m[:, None]
    dy = tracks.y_m[None, :] - tracks.y_m[:, None]
    sine, cosine = np.sin(tracks.heading_rad)[:, None], np.cos(tracks.heading_rad)[:, None]
    along, across = np.abs(sine * dx + cosine * dy), np.abs(cosine * dx - sine * dy)
    # along the line of sight, where Doppler makes the speed certain
    bearing = np.arctan2(tracks.x_m, tracks.y_m)
    rate = tracks.mean[:, 1] * np.sin(bearing) + tracks.mean[:, 4] * np.cos(bearing)
    dv = np.abs(rate[:, None] - rate)
    half = 0.5 * tracks.length_m
    bigger = tracks.length_m[:, None] >= tracks.length_m[None, :]
    close = (np.hypot(dx, dy) < p.same_centre_m) & (across < p.same_centre_m * 0.75) & (dv < p.same_speed_mps)
    inside = (along < half[:, None]) & (across < p.inside_across_m) & bigger & (dv < 2.0 * p.same_speed_mps)
    gap = along - half[:, None] - half[None, :]
    speed = tracks.speed_mps
    piece = (
        (across < p.lane_across_m)
        & (dv < p.piece_dv_mps)
        & (gap < np.minimum(p.piece_gap_s * speed, p.piece_gap_m)[:, None])
    )
    piece &= (speed > p.piece_speed_mps)[:, None] & ((along + half[:, None] + half[None, :]) < p.length_max_m)
    pair = close | inside | inside.T | (piece & piece.T)
    np.fill_diagonal(pair, False)
    if not pair.any():
        return tracks, drop
    # the stronger stays: confirmed before tentative, then the older (lower number comes first)
    rank = np.where(tracks.confirmed, 0, n) + np.arange(n)
    mean, length = tracks.mean.copy(), tracks.length_m.copy()
    for i in np.argsort(rank):  # rarely more than one pair
        if drop[i]:
            continue
        for j in np.flatnonzero(pair[i] & ~drop & (rank > rank[i])):
            drop[j] = True
            if piece[i, j] and tracks.confirmed[j] and not inside[i, j] and not close[i, j]:
                s, c = np.sin(tracks.heading_rad[i]), np.cos(tracks.heading_rad[i])
                u = s * dx[i, j] + c * dy[i, j]
                lo, hi = min(-half[i], u - half[j]), max(half[i], u + half[j])
                length[i] = min(hi - lo, p.length_max_m)
                mean[i, 0] += 0.5 * (lo + hi) * s
                mean[i, 3] += 0.5 * (lo + hi) * c
    return replace(tracks, mean=mean, length_m=length), drop


@kernel
def _any_near(mean: F64, along_m: float, across_m: float) -> bool:
    """Return whether two tracks are so near, in either axis of their motion, that they may be one vehicle."""
    for i in range(len(mean)):
        speed = max(math.hypot(mean[i, 1], mean[i, 4]), 1e-9)
        s, c = mean[i, 1] / speed, mean[i, 4] / speed
        for j in range(i):
            dx, dy = mean[j, 0] - mean[i, 0], mean[j, 3] - mean[i, 3]
            if math.hypot(dx, dy) < along_m and (speed < 2.0 or abs(c * dx - s * dy) < across_m):
                return True
    return False
