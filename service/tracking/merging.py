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
    same_speed_mps: float = (
        0.35  # most that the range rates of one vehicle's tracks differ, when well known ...
    )
    same_speed_stds: float = 1.5  # ... and so many standard deviations of the difference more
    inside_across_m: float = 1.0
    lane_across_m: float = 1.6
    piece_speed_mps: float = 4.0  # pieces are joined only in motion: in a queue the next vehicle is as near
    piece_dv_mps: float = 0.6
    piece_gap_s: float = 0.25
    piece_gap_m: float = 5.0
    # one of two that overlap in their lane is no vehicle of its own while it is younger than piece_hits
    overlap_share: float = 0.85  # of both half lengths: their centres are nearer
    overlap_speed_mps: float = 1.5  # where both answer they must move: in a queue places may be this wrong
    silent_frames: int = 8  # but one that has been silent for so long was the one that is seen now ...
    silent_dv_mps: float = 3.0  # ... and may have been taken to go so much faster or slower
    piece_hits: int = 40  # the younger of two that do not overlap: what lasted longer is a vehicle of its own
    length_max_m: float = 19.0
    # of two confirmed tracks the older stays, unless the younger, settled one has far better evidence
    stays_hits: int = 40
    stays_log_odds: float = 3.0  # so much more likely to exist: the other is coasting
    stays_points: float = (
        2.0  # so many times the points a hit: the other is a small vehicle that was beside it
    )


_PIECE, _INSIDE, _CLOSE, _OVERLAP = 1, 2, 4, 8  # bits: how one track lies to another


def merge(tracks: Tracks, p: MergingParameters) -> tuple[Tracks, Bool]:
    """Return the tracks, long ones stretched over their pieces, and which of them (T,) to drop."""
    n = len(tracks)
    drop = np.zeros(n, dtype=np.bool_)
    first, second, piece = find_pairs(
        tracks.mean, tracks.cov, tracks.heading_rad, tracks.turn_rate_radps, tracks.length_m, tracks.hits,
        tracks.empty,
        (p.same_centre_m, p.same_speed_mps, p.same_speed_stds, p.inside_across_m, p.lane_across_m,
         p.piece_speed_mps, p.piece_dv_mps, p.piece_gap_s, p.piece_gap_m, float(p.piece_hits),
         p.length_max_m, p.overlap_share, p.overlap_speed_mps, float(p.silent_frames), p.silent_dv_mps),
    )  # fmt: skip
    if not len(first):
        return tracks, drop
    mean, length, half = tracks.mean.copy(), tracks.length_m.copy(), 0.5 * tracks.length_m
    source = np.arange(n)  # whose state each track goes on with: one that was silent takes the other's
    for k in np.argsort(first, kind="stable"):  # rarely more than one pair
        i, j = first[k], second[k]
        if drop[i] or drop[j] or not _stays(tracks, i, j, p):
            continue
        drop[j] = True
        if tracks.empty[i] >= p.silent_frames and tracks.empty[j] == 0 and tracks.confirmed[j]:
            source[i] = j
        elif piece[k] and tracks.confirmed[j] and tracks.empty[j] == 0:  # a silent box stands for no piece
            s, c = np.sin(tracks.heading_rad[i]), np.cos(tracks.heading_rad[i])
            u = s * (tracks.x_m[j] - tracks.x_m[i]) + c * (tracks.y_m[j] - tracks.y_m[i])
            lo, hi = min(-half[i], u - half[j]), max(half[i], u + half[j])
            length[i] = min(hi - lo, p.length_max_m)
            mean[i, 0] += 0.5 * (lo + hi) * s
            mean[i, 3] += 0.5 * (lo + hi) * c
    tracks = tracks.but(mean=mean, length_m=length)
    if (source != np.arange(n)).any():
        taken = tracks.take(source)
        own, theirs = tracks.crept_m, taken.crept_m  # what either showed to be a vehicle still is one
        crept_m = np.where(np.abs(own) > np.abs(theirs), own, theirs)
        tracks = taken.but(number=tracks.number, crept_m=crept_m)
    return tracks, drop


def _stays(tracks: Tracks, i: int, j: int, p: MergingParameters) -> bool:
    """Return whether track i stays where i and j are one vehicle: the other does not.

    A confirmed one before a tentative one, the older of two (lower number) before the younger. But what fell
    silent beside another vehicle must not take its place, although its box drifts onto the other's points.
    """
    if tracks.confirmed[i] != tracks.confirmed[j]:
        return bool(tracks.confirmed[i])
    older, younger = min(i, j), max(i, j)
    better = tracks.hits[younger] >= p.stays_hits and (
        tracks.log_odds[younger] > tracks.log_odds[older] + p.stays_log_odds
        or tracks.points_per_hit[younger] > p.stays_points * tracks.points_per_hit[older]
    )
    return bool(i == (younger if better else older))


@kernel
def find_pairs(
    mean: F64,
    cov: F64,
    heading: F64,
    turn_rate: F64,
    length: F64,
    hits: I64,
    empty: I64,
    q: tuple[float, ...],
) -> tuple[I64, I64, Bool]:
    """Return pairs (i, j) of tracks that are one vehicle, seen from i, and whether j is but a piece of i.

    Duplicates have one centre, or one of them lies in the other's box, or overlaps it in its lane; pieces
    drive one behind the other in one lane at one speed. Velocities are compared along the line of sight to
    either, where Doppler makes them certain; the ends of a turning body differ by the turn rate times their
    distance.
    """
    (
        same_centre, same_speed, speed_stds, inside_across, lane_across, piece_speed, piece_dv, gap_s, gap_m,
        piece_hits, longest, overlap_share, overlap_speed, silent, silent_dv,
    ) = q  # fmt: skip
    n, pairs, likely = len(heading), 0, False
    bearing_sin, bearing_cos, lies = np.empty(n), np.empty(n), np.zeros((n, n), dtype=np.uint8)
    for i in range(n):
        g = max(math.hypot(mean[i, 0], mean[i, 3]), 1e-6)
        bearing_sin[i], bearing_cos[i] = mean[i, 0] / g, mean[i, 3] / g
    for i in range(n):
        s, c, speed = math.sin(heading[i]), math.cos(heading[i]), math.hypot(mean[i, 1], mean[i, 4])
        reach = max(longest, length[i]) + lane_across + inside_across + same_centre  # of any of the three
        beside = max(lane_across, inside_across, 0.75 * same_centre)
        for j in range(n):
            dx, dy = mean[j, 0] - mean[i, 0], mean[j, 3] - mean[i, 3]
            along, across = abs(s * dx + c * dy), abs(c * dx - s * dy)
            if i == j or across >= beside or along > reach:
                continue  # nearly always
            apart, dv, like = math.hypot(dx, dy), np.inf, False
            turned = max(abs(turn_rate[i]), abs(turn_rate[j])) * apart
            for k in (i, j):
                a, b = bearing_sin[k], bearing_cos[k]
                here = abs(a * (mean[i, 1] - mean[j, 1]) + b * (mean[i, 4] - mean[j, 4]))
                var = a * a * (cov[i, 1, 1] + cov[j, 1, 1]) + b * b * (cov[i, 4, 4] + cov[j, 4, 4])
                var += 2.0 * a * b * (cov[i, 1, 4] + cov[j, 1, 4])
                like = like or here <= same_speed + speed_stds * math.sqrt(var) + turned
                dv = min(dv, here)
            one_silent = (empty[i] >= silent) != (empty[j] >= silent)
            if not like and not one_silent:
                continue
            half = 0.5 * (length[i] + length[j])
            if along < overlap_share * half and across < lane_across:
                if one_silent:
                    same = dv < silent_dv and (hits[j] if empty[i] >= silent else hits[i]) < piece_hits
                else:
                    same = dv < piece_dv and speed > overlap_speed and min(hits[i], hits[j]) < piece_hits
                if same:
                    lies[i, j] += _OVERLAP
            likely = likely or lies[i, j] > 0
            if not like:
                continue
            if across < 0.75 * same_centre and apart < same_centre:
                lies[i, j] += _CLOSE
            if along < 0.5 * length[i] and across < inside_across and length[i] >= length[j]:
                lies[i, j] += _INSIDE
            if across < lane_across and dv < piece_dv and along + half < longest and speed > piece_speed:
                overlap = along < half
                if along - half < min(gap_s * speed, gap_m):
                    if overlap or min(hits[i], hits[j]) < piece_hits:
                        lies[i, j] += _PIECE
            likely = likely or lies[i, j] > 0
    if not likely:
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.bool_)
    first, second, piece = np.empty(n * n, np.int64), np.empty(n * n, np.int64), np.empty(n * n, np.bool_)
    for i in range(n):
        for j in range(n):
            if lies[i, j] >= _INSIDE or (lies[j, i] & _INSIDE) or (lies[i, j] & lies[j, i] & _PIECE):
                first[pairs], second[pairs] = i, j
                piece[pairs] = (lies[i, j] & (_PIECE | _INSIDE | _CLOSE)) == _PIECE
                pairs += 1
    return first[:pairs], second[:pairs], piece[:pairs]
