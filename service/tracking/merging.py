"""Find tracks that are one vehicle: duplicates, and pieces of a long one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, Bool
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


_PIECE, _INSIDE, _CLOSE = 1, 2, 4  # bits: how one track lies to another


def merge(tracks: Tracks, p: MergingParameters) -> tuple[Tracks, Bool]:
    """Return the tracks, long ones stretched over their pieces, and which of them (T,) to drop."""
    n = len(tracks)
    drop = np.zeros(n, dtype=np.bool_)
    first, second, piece = find_pairs(
        tracks.mean, tracks.heading_rad, tracks.length_m,
        (p.same_centre_m, p.same_speed_mps, p.inside_across_m, p.lane_across_m, p.piece_speed_mps,
         p.piece_dv_mps, p.piece_gap_s, p.piece_gap_m, p.length_max_m),
    )  # fmt: skip
    if not len(first):
        return tracks, drop
    # the stronger stays: confirmed before tentative, then the older (lower number comes first)
    rank = np.where(tracks.confirmed, 0, n) + np.arange(n)
    mean, length, half = tracks.mean.copy(), tracks.length_m.copy(), 0.5 * tracks.length_m
    for k in np.argsort(rank[first], kind="stable"):  # rarely more than one pair
        i, j = first[k], second[k]
        if drop[i] or drop[j] or rank[j] < rank[i]:
            continue
        drop[j] = True
        if piece[k] and tracks.confirmed[j]:
            s, c = np.sin(tracks.heading_rad[i]), np.cos(tracks.heading_rad[i])
            u = s * (tracks.x_m[j] - tracks.x_m[i]) + c * (tracks.y_m[j] - tracks.y_m[i])
            lo, hi = min(-half[i], u - half[j]), max(half[i], u + half[j])
            length[i] = min(hi - lo, p.length_max_m)
            mean[i, 0] += 0.5 * (lo + hi) * s
            mean[i, 3] += 0.5 * (lo + hi) * c
    return tracks.but(mean=mean, length_m=length), drop


@kernel
def find_pairs(mean: F64, heading: F64, length: F64, q: tuple[float, ...]) -> tuple[I64, I64, Bool]:
    """Return pairs (i, j) of tracks that are one vehicle, seen from i, and whether j is but a piece of i.

    Duplicates have one centre, or one of them lies in the other's box; pieces drive one behind the other
    in one lane at one speed. Speeds are compared along the line of sight, where Doppler makes them certain.
    """
    same_centre, same_speed, inside_across, lane_across, piece_speed, piece_dv, gap_s, gap_m, longest = q
    n, pairs, likely = len(heading), 0, False
    rate, lies = np.empty(n), np.zeros((n, n), dtype=np.uint8)
    for i in range(n):
        bearing = math.atan2(mean[i, 0], mean[i, 3])
        rate[i] = mean[i, 1] * math.sin(bearing) + mean[i, 4] * math.cos(bearing)
    fastest = max(2.0 * same_speed, piece_dv)
    for i in range(n):
        s, c, speed = math.sin(heading[i]), math.cos(heading[i]), math.hypot(mean[i, 1], mean[i, 4])
        reach = max(longest, length[i]) + lane_across + inside_across + same_centre  # of any of the three
        for j in range(n):
            dx, dy, dv = mean[j, 0] - mean[i, 0], mean[j, 3] - mean[i, 3], abs(rate[i] - rate[j])
            if i == j or abs(dx) > reach or abs(dy) > reach or dv > fastest:
                continue
            along, across, half = abs(s * dx + c * dy), abs(c * dx - s * dy), 0.5 * (length[i] + length[j])
            if across < 0.75 * same_centre and dv < same_speed and math.hypot(dx, dy) < same_centre:
                lies[i, j] += _CLOSE
            if along < 0.5 * length[i] and across < inside_across and length[i] >= length[j]:
                if dv < 2.0 * same_speed:
                    lies[i, j] += _INSIDE
            if across < lane_across and dv < piece_dv and along + half < longest and speed > piece_speed:
                if along - half < min(gap_s * speed, gap_m):
                    lies[i, j] += _PIECE
            likely = likely or lies[i, j] > 0
    if not likely:
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.bool_)
    first, second, piece = np.empty(n * n, np.int64), np.empty(n * n, np.int64), np.empty(n * n, np.bool_)
    for i in range(n):
        for j in range(n):
            if lies[i, j] >= _INSIDE or (lies[j, i] & _INSIDE) or (lies[i, j] & lies[j, i] & _PIECE):
                first[pairs], second[pairs], piece[pairs] = i, j, lies[i, j] == _PIECE
                pairs += 1
    return first[:pairs], second[:pairs], piece[:pairs]
