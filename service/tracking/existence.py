"""Weigh the evidence that a track is a vehicle, and decide when it is confirmed and when it ends.

The log-odds of existence follow JIPDA (Musicki and Evans 2004): the likelihood ratio of the frame's association is
added to them. The evidence of one frame is bounded, because radar clutter comes in runs (ghosts, swaying posts) and is
not the independent Poisson field of the derivation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, U8, Bool, TrackStatus
from service.tracking.state import Tracks


@dataclass(frozen=True, slots=True)
class ExistenceParameters:
    """Evidence, thresholds and waiting times of a track's life."""

    birth_log_odds: float = 0.0
    hit_evidence: float = 1.1  # most that one frame may add
    hit_base: float = 0.55  # share of it for a hit by no more than a trace
    hit_per_point: float = 0.15
    log_odds_max: float = 6.0
    confirm_log_odds: float = 1.5
    delete_log_odds: float = -2.0
    detect_floor_near: float = 0.6  # smallest probability of detection assumed at 90 m ...
    detect_floor_far: float = 0.3  # ... and at 150 m
    detect_near_m: float = 90.0
    detect_far_m: float = 150.0
    detect_max: float = 0.8
    detect_memory_frames: float = 20.0
    shadowed_miss: float = 0.25  # share of a miss's evidence when a nearer vehicle shadows the track
    standing_miss: float = 0.4
    coast_s: float = 1.0  # longest time without a point
    coast_shadowed_s: float = 2.0
    coast_standing_s: float = 4.0
    coast_tentative_s: float = 0.5
    coast_young_s: float = 0.3  # a track has earned this much silence, and a little more with each hit
    coast_per_hit_s: float = 0.03
    settled_hits: int = 20  # hits after which a standing or shadowed track is not given up for mere silence
    standing_mps: float = 1.0
    # what makes a track wait longer for confirmation, in log-odds
    weak_db: float = 4.0  # so far under the mean echo of confirmed vehicles
    weak_range_m: tuple[float, float] = (35.0, 100.0)
    weak_wait: float = 5.0
    behind_wait: float = 4.0  # behind a vehicle on the same bearing: double bounce
    mirror_wait: float = 9.0  # beside a stronger vehicle at the same range and Doppler
    ghost_life_s: float = 2.0  # ghosts live some 0.6 s: what lasts longer is no ghost
    off_road_wait: float = 9.0
    slow_wait: float = 5.0
    slow_range_rate_mps: float = 1.3  # what moves slower than this along the line of sight ...
    slow_travel_m: float = 3.0  # ... and has not come further than this may be a post
    slow_points: float = 2.6  # a slow track off the driven road needs so many points a hit: a post gives one
    # a track that stands where nobody drives is a post
    post_after_s: float = 20.0
    post_travel_m: float = 15.0
    post_points: float = 1.8


def detection_probability(tracks: Tracks, p: ExistenceParameters) -> F64:
    """Return the probability (T,) that the radar sees the vehicle in a frame: its running rate, with a floor by range."""
    g = np.hypot(tracks.x_m, tracks.y_m)
    floor = np.interp(g, [p.detect_near_m, p.detect_far_m], [p.detect_floor_near, p.detect_floor_far])
    return np.clip(tracks.detect_rate, floor, p.detect_max)


def shadowed(tracks: Tracks) -> Bool:
    """Return which boxes (T,) lie behind a nearer confirmed box on the same bearing."""
    g = np.hypot(tracks.x_m, tracks.y_m)
    bearing = np.arctan2(tracks.x_m, tracks.y_m)
    aspect = tracks.heading_rad - bearing
    half = 0.5 * (tracks.width_m * np.abs(np.cos(aspect)) + tracks.length_m * np.abs(np.sin(aspect)))
    depth = 0.5 * (tracks.length_m * np.abs(np.cos(aspect)) + tracks.width_m * np.abs(np.sin(aspect)))
    width = half / np.maximum(g, 1.0)
    nearer = (g + depth)[None, :] < (g - depth)[:, None] + 1.0
    covers = np.abs(bearing[:, None] - bearing[None, :]) < width[None, :] + 0.3 * width[:, None]
    return np.asarray((nearer & covers & tracks.confirmed[None, :]).any(axis=1))


def weigh(tracks: Tracks, hit: F64, points: F64, hidden: Bool, p: ExistenceParameters) -> F64:
    """Return the log-odds (T,) after a frame.

    hit (T,): probability that the track had a measurement; points (T,): number of points in it.
    """
    gain = p.hit_evidence * np.minimum(1.0, p.hit_base + p.hit_per_point * points)
    loss = np.log1p(-detection_probability(tracks, p))
    loss = np.where(hidden, p.shadowed_miss, 1.0) * loss
    loss = np.where(tracks.speed_mps < p.standing_mps, p.standing_miss, 1.0) * loss
    return np.minimum(tracks.log_odds + hit * gain + (1.0 - hit) * loss, p.log_odds_max)


def wait(
    tracks: Tracks,
    off_road: Bool,
    behind_rail: Bool,
    time_us: int,
    echo_reference_db: float,
    p: ExistenceParameters,
) -> F64:
    """Return how far above the threshold (T,) the log-odds must rise before a tentative track is confirmed.

    inf: not at all for now. behind_rail (T,): a stronger vehicle with the same range and Doppler drives on this side of
    a row of standing echoes, so the track may be its image in them.
    """
    g = np.hypot(tracks.x_m, tracks.y_m)
    weak = (
        (tracks.echo_db < echo_reference_db - p.weak_db) & (g > p.weak_range_m[0]) & (g < p.weak_range_m[1])
    )
    few = tracks.points_per_hit < 1.8
    sure = tracks.confirmed
    bearing = np.arctan2(tracks.x_m, tracks.y_m)
    doppler = (tracks.mean[:, 1] * tracks.x_m + tracks.mean[:, 4] * tracks.y_m) / np.maximum(g, 1.0)
    behind = g[:, None] - g[None, :]
    across = np.abs(bearing[:, None] - bearing[None, :]) * g[:, None]
    bounce = ((behind > 2.0) & (behind < 20.0) & (across < 1.5) & sure[None, :]).any(axis=1) & few
    stronger = tracks.echo_db[None, :] > tracks.echo_db[:, None] + 3.0
    same = (np.abs(behind) < 5.0) & (np.abs(doppler[:, None] - doppler[None, :]) < 1.2) & (across > 2.0)
    mirror = (same & stronger & sure[None, :]).any(axis=1) & weak & few
    extra = np.where(weak, p.weak_wait, 0.0) + np.where(bounce, p.behind_wait, 0.0)
    extra += np.where(mirror | (bounce & weak) | off_road, p.mirror_wait, 0.0)
    extra += np.where(tracks.speed_mps < p.standing_mps, p.slow_wait, 0.0)
    extra = np.minimum(extra, p.log_odds_max - p.confirm_log_odds - 0.1)
    young = (time_us - tracks.born_us) / 1e6 < p.ghost_life_s
    return np.where((behind_rail | off_road | (bounce & weak)) & young & few, np.inf, extra)


def mirror_partners(tracks: Tracks) -> Bool:
    """Return (T, T): track j is confirmed, beside track i at the same range and Doppler, and the stronger of the two."""
    g = np.hypot(tracks.x_m, tracks.y_m)
    doppler = (tracks.mean[:, 1] * tracks.x_m + tracks.mean[:, 4] * tracks.y_m) / np.maximum(g, 1.0)
    across = (
        np.abs(np.arctan2(tracks.x_m, tracks.y_m)[:, None] - np.arctan2(tracks.x_m, tracks.y_m)) * g[:, None]
    )
    same = (np.abs(g[:, None] - g) < 8.0) & (np.abs(doppler[:, None] - doppler) < 1.5) & (across > 2.0)
    stronger = tracks.echo_db[None, :] > tracks.echo_db[:, None]
    return np.asarray(same & stronger & tracks.confirmed[None, :] & ~tracks.confirmed[:, None])


def next_status(tracks: Tracks, waiting: F64, hit: Bool, driven: Bool, p: ExistenceParameters) -> U8:
    """Return the status (T,): confirmed tracks coast while they have no point; tentative ones rise by their log-odds."""
    range_rate = (tracks.mean[:, 1] * tracks.x_m + tracks.mean[:, 4] * tracks.y_m) / np.hypot(
        tracks.x_m, tracks.y_m
    )
    travel = np.hypot(tracks.x_m - tracks.born_x_m, tracks.y_m - tracks.born_y_m)
    post = (np.abs(range_rate) < p.slow_range_rate_mps) & (travel < p.slow_travel_m)
    post &= (tracks.points_per_hit < p.slow_points) & ~driven
    sure = tracks.confirmed | ((tracks.log_odds >= p.confirm_log_odds + waiting) & ~post)
    alive = np.where(hit, TrackStatus.CONFIRMED, TrackStatus.COASTING)
    return np.where(sure, alive, TrackStatus.TENTATIVE).astype(np.uint8)


def ended(tracks: Tracks, time_us: int, hidden: Bool, driven: Bool, p: ExistenceParameters) -> Bool:
    """Return which tracks (T,) end now: unlikely ones, those too long without a point, and posts."""
    silent_s = (time_us - tracks.hit_us) / 1e6
    standing = tracks.speed_mps < p.standing_mps
    limit = np.where(standing, p.coast_standing_s, np.where(hidden, p.coast_shadowed_s, p.coast_s))
    limit = np.where(
        tracks.confirmed,
        np.minimum(limit, p.coast_young_s + p.coast_per_hit_s * tracks.hits),
        p.coast_tentative_s,
    )
    settled = tracks.confirmed & (tracks.hits >= p.settled_hits)
    unlikely = (tracks.log_odds < p.delete_log_odds) & ~((standing | hidden) & settled)
    travel = np.hypot(tracks.x_m - tracks.born_x_m, tracks.y_m - tracks.born_y_m)
    post = standing & ~driven & (travel < p.post_travel_m) & (tracks.points_per_hit < p.post_points)
    post &= (time_us - tracks.born_us) / 1e6 > 1.0
    return np.asarray((silent_s > limit + 1e-9) | unlikely | post)


def probability(log_odds: F64) -> F64:
    """Return the existence probability of log-odds."""
    return 1.0 / (1.0 + np.exp(-log_odds))
