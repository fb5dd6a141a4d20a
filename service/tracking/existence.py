"""Weigh the evidence that a track is a vehicle, and decide when it is confirmed and when it ends.

The log-odds of existence follow JIPDA (Musicki and Evans 2004): the likelihood ratio of the frame's
association is added to them. The evidence of one frame is bounded, because radar clutter comes in runs
(ghosts, swaying posts) and is not the independent Poisson field of the derivation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.boxes import M_COUNT, M_ECHO
from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, U8, Bool, TrackStatus
from service.tracking.state import Tracks

_TENTATIVE, _CONFIRMED, _COASTING = (
    int(TrackStatus.TENTATIVE),
    int(TrackStatus.CONFIRMED),
    int(TrackStatus.COASTING),
)


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
    memory_frames: float = 20.0  # of the running means of a track
    shadowed_miss: float = 0.25  # share of a miss's evidence when a nearer vehicle shadows the track
    standing_miss: float = 0.4
    standing_mps: float = 1.0
    coast_s: float = 1.0  # longest time without a point
    coast_shadowed_s: float = 2.0
    coast_standing_s: float = 4.0
    coast_tentative_s: float = 0.5
    coast_young_s: float = 0.3  # a track has earned this much silence, and a little more with each hit
    coast_per_hit_s: float = 0.03
    leave_margin_m: float = 6.0  # a silent track so far outside the region has left
    settled_hits: int = 20  # hits after which a standing or shadowed track is not given up for mere silence
    # what makes a track wait longer for confirmation, in log-odds
    weak_db: float = 4.0  # so far under the mean echo of confirmed vehicles, between these ranges
    weak_from_m: float = 35.0
    weak_to_m: float = 100.0
    weak_wait: float = 5.0
    few_points: float = 1.8
    behind_wait: float = 4.0  # behind a vehicle on the same bearing: double bounce
    behind_from_m: float = 2.0
    behind_to_m: float = 20.0
    behind_across_m: float = 1.5
    mirror_wait: float = 9.0  # beside a stronger vehicle at the same range and Doppler
    mirror_range_m: float = 5.0
    mirror_mps: float = 1.2
    mirror_across_m: float = 2.0
    mirror_db: float = 3.0
    rail_range_m: float = 8.0  # the same, where a row of standing echoes lies between the two
    rail_mps: float = 1.5
    ghost_life_s: float = 4.0  # most ghosts live some 0.6 s, a few two or three: what lasts longer is none
    slow_wait: float = 5.0
    slow_range_rate_mps: float = 1.3  # what moves slower than this along the line of sight ...
    # ... and has not come further than this may be a post: a box put from one post onto the next has moved
    # by as much as its own length
    slow_travel_m: float = 4.5
    slow_points: float = 3.1  # off the driven road it needs so many points a hit: three posts give three


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What T tracks stand on and beside."""

    off_road: Bool  # (T,) the road is known and this is not it
    known_road: Bool  # (T,) vehicles are known to have driven here, or this one to be a vehicle
    behind_rail: Bool  # (T,) a stronger vehicle like it drives on this side of a row of standing echoes
    post: Bool  # (T,) stands, and is no vehicle


def detection_probability(tracks: Tracks, p: ExistenceParameters) -> F64:
    """Return the probability (T,) that a frame sees the vehicle: its running rate, floored by range."""
    return _detection(
        tracks.mean, tracks.detect_rate, p.detect_floor_near, p.detect_floor_far, p.detect_near_m,
        p.detect_far_m, p.detect_max,
    )  # fmt: skip


@kernel
def _detection(
    mean: F64, rate: F64, floor_near: float, floor_far: float, near_m: float, far_m: float, most: float
) -> F64:
    out = np.empty(len(rate))
    for i in range(len(rate)):
        share = (math.hypot(mean[i, 0], mean[i, 3]) - near_m) / (far_m - near_m)
        floor = floor_near + min(max(share, 0.0), 1.0) * (floor_far - floor_near)
        out[i] = min(max(rate[i], floor), most)
    return out


def shadowed(tracks: Tracks) -> Bool:
    """Return which boxes (T,) lie behind a nearer confirmed box on the same bearing.

    A confirmed one that may lie there counts as lying there, to a standard deviation of its bearing: what is
    hidden is not measured, and its place becomes uncertain when it matters most.
    """
    return _shadowed(
        tracks.mean, tracks.cov, tracks.heading_rad, tracks.length_m, tracks.width_m, tracks.status
    )


@kernel
def _shadowed(mean: F64, cov: F64, heading: F64, length: F64, width: F64, status: U8) -> Bool:
    n = len(heading)
    g, bearing, depth, half, reach = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        g[i] = math.hypot(mean[i, 0], mean[i, 3])
        bearing[i] = math.atan2(mean[i, 0], mean[i, 3])
        along, across = abs(math.cos(heading[i] - bearing[i])), abs(math.sin(heading[i] - bearing[i]))
        half[i] = 0.5 * (width[i] * along + length[i] * across) / max(g[i], 1.0)
        depth[i] = 0.5 * (length[i] * along + width[i] * across)
        reach[i] = 0.3 * half[i]
        if status[i] != _TENTATIVE:
            s, c = math.sin(bearing[i]), math.cos(bearing[i])
            variance = c * c * cov[i, 0, 0] - 2.0 * s * c * cov[i, 0, 3] + s * s * cov[i, 3, 3]
            reach[i] += math.sqrt(max(variance, 0.0)) / max(g[i], 1.0)
    out = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        for j in range(n):
            if j != i and status[j] != _TENTATIVE and g[j] + depth[j] < g[i] - depth[i] + 1.0:
                if abs(bearing[i] - bearing[j]) < half[j] + reach[i]:
                    out[i] = True
                    break
    return out


def remember(
    tracks: Tracks, measured: F64, miss: F64, time_us: int, hidden: Bool, p: ExistenceParameters
) -> Tracks:
    """Return the tracks with the frame's evidence in their log-odds and running means.

    measured (T, MEASUREMENT_COLUMNS): each track's own points; miss (T,): probability that it had none.
    """
    log_odds, hits, empty = tracks.log_odds.copy(), tracks.hits.copy(), tracks.empty.copy()
    hit_us, rate = tracks.hit_us.copy(), tracks.detect_rate.copy()
    points, echo = tracks.points_per_hit.copy(), tracks.echo_db.copy()
    _remember(
        tracks.mean, measured, miss, hidden, detection_probability(tracks, p), time_us, log_odds, hits,
        empty, hit_us,
        rate, points, echo, p.hit_evidence, p.hit_base, p.hit_per_point, p.log_odds_max, p.memory_frames,
        p.shadowed_miss, p.standing_miss, p.standing_mps,
    )  # fmt: skip
    return tracks.but(
        log_odds=log_odds,
        hits=hits,
        empty=empty,
        hit_us=hit_us,
        detect_rate=rate,
        points_per_hit=points,
        echo_db=echo,
    )


@kernel
def _remember(
    mean: F64, measured: F64, miss: F64, hidden: Bool, detect: F64, time_us: int, log_odds: F64, hits: I64,
    empty: I64,
    hit_us: I64, rate: F64, points: F64, echo: F64, evidence: float, base: float, per_point: float,
    most: float,
    memory: float, shadowed_miss: float, standing_miss: float, standing_mps: float,
) -> None:  # fmt: skip
    for i in range(len(miss)):
        count = measured[i, M_COUNT]
        hit = 1.0 - miss[i] if count > 0.0 else 0.0
        loss = math.log1p(-detect[i])
        if hidden[i]:
            loss *= shadowed_miss
        if math.hypot(mean[i, 1], mean[i, 4]) < standing_mps:
            loss *= standing_miss
        gain = evidence * min(1.0, base + per_point * count)
        log_odds[i] = min(log_odds[i] + hit * gain + (1.0 - hit) * loss, most)
        if hit > 0.5:
            hits[i] += 1
            empty[i] = 0
            hit_us[i] = time_us
            points[i] += (count - points[i]) / min(hits[i] + 1.0, memory)
            echo[i] += (measured[i, M_ECHO] - echo[i]) / min(float(hits[i]), memory)
            rate[i] += (1.0 - rate[i]) / memory
        else:
            empty[i] += 1
            if not hidden[i]:
                rate[i] -= rate[i] / memory


def judge(
    tracks: Tracks,
    around: Surroundings,
    time_us: int,
    hidden: Bool,
    echo_reference_db: float,
    p: ExistenceParameters,
) -> tuple[U8, Bool]:
    """Return the status (T,) of the tracks and which of them (T,) end now.

    A tentative track is confirmed when its log-odds pass the threshold; what looks like a ghost or a post
    must pass it by more, or wait until a ghost would be gone.
    """
    status, over = np.empty(len(tracks), dtype=np.uint8), np.zeros(len(tracks), dtype=np.bool_)
    wait = _waits(
        tracks.mean, tracks.status, tracks.echo_db, tracks.points_per_hit, tracks.born_us, time_us,
        echo_reference_db,
        around.off_road, around.behind_rail,
        (p.weak_db, p.weak_from_m, p.weak_to_m, p.weak_wait, p.few_points, p.behind_wait, p.behind_from_m,
         p.behind_to_m, p.behind_across_m, p.mirror_wait, p.mirror_range_m, p.mirror_mps, p.mirror_across_m,
         p.mirror_db, p.ghost_life_s, p.slow_wait, p.standing_mps, p.log_odds_max - p.confirm_log_odds - 0.1),
    )  # fmt: skip
    _judge(
        tracks.mean, tracks.status, tracks.log_odds, tracks.hits, tracks.empty, tracks.points_per_hit,
        tracks.born_x_m, tracks.born_y_m, tracks.hit_us, time_us, wait, hidden,
        around.known_road, around.post,
        (p.confirm_log_odds, p.delete_log_odds, p.standing_mps, p.slow_range_rate_mps, p.slow_travel_m,
         p.slow_points, float(p.settled_hits)),
        (p.coast_s, p.coast_shadowed_s, p.coast_standing_s, p.coast_tentative_s, p.coast_young_s,
        p.coast_per_hit_s),
        status, over,
    )  # fmt: skip
    return status, over


@kernel
def _waits(
    mean: F64, status: U8, echo: F64, points: F64, born_us: I64, time_us: int, reference: float,
    off_road: Bool,
    behind_rail: Bool, q: tuple[float, ...],
) -> F64:  # fmt: skip
    """Return how far above the threshold (T,) the log-odds must rise; inf: not yet at all."""
    (
        weak_db,
        weak_from,
        weak_to,
        weak_wait,
        few_points,
        behind_wait,
        behind_from,
        behind_to,
        behind_across,
    ) = q[:9]
    (
        mirror_wait,
        mirror_range,
        mirror_mps,
        mirror_across,
        mirror_db,
        ghost_life,
        slow_wait,
        standing,
        most,
    ) = q[9:]
    n = len(echo)
    out = np.zeros(n)
    for i in range(n):
        if status[i] != _TENTATIVE:
            continue
        g = math.hypot(mean[i, 0], mean[i, 3])
        bearing = math.atan2(mean[i, 0], mean[i, 3])
        doppler = (mean[i, 1] * mean[i, 0] + mean[i, 4] * mean[i, 3]) / max(g, 1.0)
        weak = echo[i] < reference - weak_db and weak_from < g < weak_to
        few = points[i] < few_points
        bounce = mirror = False
        for j in range(n):
            if status[j] == _TENTATIVE:
                continue
            gj = math.hypot(mean[j, 0], mean[j, 3])
            across = abs(bearing - math.atan2(mean[j, 0], mean[j, 3])) * g
            if few and behind_from < g - gj < behind_to and across < behind_across:
                bounce = True
            dj = (mean[j, 1] * mean[j, 0] + mean[j, 4] * mean[j, 3]) / max(gj, 1.0)
            if few and weak and abs(g - gj) < mirror_range and abs(doppler - dj) < mirror_mps:
                if across > mirror_across and echo[j] > echo[i] + mirror_db:
                    mirror = True
        wait = (weak_wait if weak else 0.0) + (behind_wait if bounce else 0.0)
        if mirror or (bounce and weak) or off_road[i]:
            wait += mirror_wait
        if math.hypot(mean[i, 1], mean[i, 4]) < standing:
            wait += slow_wait
        out[i] = min(wait, most)
        young = (time_us - born_us[i]) / 1e6 < ghost_life
        if young and few and (behind_rail[i] or off_road[i] or (bounce and weak)):
            out[i] = np.inf
    return out


@kernel
def _judge(
    mean: F64, before: U8, log_odds: F64, hits: I64, empty: I64, points: F64, born_x: F64, born_y: F64,
    hit_us: I64, time_us: int, wait: F64, hidden: Bool, known_road: Bool, post: Bool, q: tuple[float, ...],
    coast: tuple[float, ...], status: U8, over: Bool,
) -> None:  # fmt: skip
    confirm, delete, standing_mps, slow_rate, slow_travel, slow_points, settled = q
    coast_moving, coast_hidden, coast_standing, coast_tentative, coast_young, coast_per_hit = coast
    for i in range(len(log_odds)):
        g = max(math.hypot(mean[i, 0], mean[i, 3]), 1e-6)
        rate = (mean[i, 1] * mean[i, 0] + mean[i, 4] * mean[i, 3]) / g
        travel = math.hypot(mean[i, 0] - born_x[i], mean[i, 3] - born_y[i])
        sure = before[i] != _TENTATIVE
        if not sure and log_odds[i] >= confirm + wait[i]:
            sure = (
                known_road[i] or points[i] >= slow_points or travel >= slow_travel or abs(rate) >= slow_rate
            )
        status[i] = (_CONFIRMED if empty[i] == 0 else _COASTING) if sure else _TENTATIVE
        standing = math.hypot(mean[i, 1], mean[i, 4]) < standing_mps
        limit = coast_tentative
        if sure:
            limit = coast_standing if standing else (coast_hidden if hidden[i] else coast_moving)
            limit = min(limit, coast_young + coast_per_hit * hits[i])
        silent = (time_us - hit_us[i]) / 1e6 > limit + 1e-9
        patient = sure and hits[i] >= settled and (standing or hidden[i])
        unlikely = log_odds[i] < delete and not patient
        over[i] = silent or unlikely or post[i]


def mirror_partners(tracks: Tracks, p: ExistenceParameters) -> tuple[I64, I64]:
    """Return pairs (i, j): j confirmed, beside the tentative i at its range and Doppler, and stronger."""
    return _mirror_partners(
        tracks.mean, tracks.status, tracks.echo_db, p.rail_range_m, p.rail_mps, p.mirror_across_m
    )


@kernel
def _mirror_partners(
    mean: F64, status: U8, echo: F64, range_m: float, speed_mps: float, across_m: float
) -> tuple[I64, I64]:
    n = len(echo)
    pairs = [(0, 0) for _ in range(0)]
    for i in range(n):
        if status[i] != _TENTATIVE:
            continue
        g = math.hypot(mean[i, 0], mean[i, 3])
        bearing = math.atan2(mean[i, 0], mean[i, 3])
        doppler = (mean[i, 1] * mean[i, 0] + mean[i, 4] * mean[i, 3]) / max(g, 1.0)
        for j in range(n):
            if status[j] == _TENTATIVE or echo[j] <= echo[i]:
                continue
            gj = math.hypot(mean[j, 0], mean[j, 3])
            dj = (mean[j, 1] * mean[j, 0] + mean[j, 4] * mean[j, 3]) / max(gj, 1.0)
            across = abs(bearing - math.atan2(mean[j, 0], mean[j, 3])) * g
            if abs(g - gj) < range_m and abs(doppler - dj) < speed_mps and across > across_m:
                pairs.append((i, j))
    first, second = np.empty(len(pairs), dtype=np.int64), np.empty(len(pairs), dtype=np.int64)
    for k in range(len(pairs)):
        first[k], second[k] = pairs[k]
    return first, second


def probability(log_odds: F64) -> F64:
    """Return the existence probability of log-odds."""
    return 1.0 / (1.0 + np.exp(-log_odds))
