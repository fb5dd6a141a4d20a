"""Learn how long a vehicle is and which way it points, keeping the face that the radar sees where it is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.boxes import M_COUNT, M_EDGE, M_U_MAX, M_U_MIN
from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, Bool
from service.tracking.state import Tracks


@dataclass(frozen=True, slots=True)
class ExtentParameters:
    """Learning of length and heading."""

    percentile: float = 75.0  # of the extents of the last hits, nearest rank
    end_margin_m: float = 0.4  # the outermost echoes lie this much inside the box, both ends together
    growth_m: float = 0.25  # most that the length grows in a frame
    edge_growth_m: float = 0.8  # ... while the box enters or leaves the view
    shrink_m: float = 0.05
    frozen_below_mps: float = (
        2.5  # slower boxes stop growing: noise and the next car in the queue inflate them
    )
    frozen_after_hits: int = 15
    length_min_m: float = 2.2
    length_max_m: float = 19.0
    car_length_m: float = 4.4
    wide_from_m: float = 7.0  # longer vehicles are wide
    wide_m: float = 2.5
    car_width_m: float = 1.9
    narrow_below_m: float = 3.0
    narrow_width_m: float = 0.9
    narrow_extent_m: float = 2.6  # a vehicle whose points never span more is short ...
    narrow_points: float = 3.5  # ... if it gives few points, too
    narrow_hits: int = 12  # hits with several points before a vehicle may be found to be short
    turn_gain: float = 0.15
    turn_gain_per_mps: float = 0.02
    turn_gain_max: float = 0.6
    turn_above_mps: float = 1.0
    turn_certainty: float = 2.5  # the box turns once its speed is so many standard deviations
    trust_heading_hits: int = 25  # hits that settle a heading
    sideways_std_mps: float = 0.4  # how far a vehicle may move sideways to its settled heading ...
    sideways_young_mps: float = 1.0  # ... to one that is still a guess ...
    sideways_share: float = 0.06  # ... and more with its speed


def learn(tracks: Tracks, measured: F64, hit: Bool, across_std_rad: float, p: ExtentParameters) -> Tracks:
    """Return the tracks with their length, width, heading and sideways speed settled after a frame.

    measured (T, MEASUREMENT_COLUMNS) of each track's own points, hit (T,); across_std_rad: azimuth noise of a
    point.
    """
    if not len(tracks):
        return tracks
    mean, cov, ring = tracks.mean.copy(), tracks.cov.copy(), tracks.extent_m.copy()
    heading, length, width = tracks.heading_rad.copy(), tracks.length_m.copy(), tracks.width_m.copy()
    _learn_length(
        mean, heading, length, width, ring, measured, hit, tracks.hits, tracks.points_per_hit, across_std_rad,
        (p.percentile, p.end_margin_m, p.growth_m, p.edge_growth_m, p.shrink_m, p.frozen_below_mps,
         float(p.frozen_after_hits), p.length_min_m, p.length_max_m, p.car_length_m, p.narrow_extent_m,
         p.narrow_points,
         float(p.narrow_hits)),
        (p.wide_from_m, p.wide_m, p.car_width_m, p.narrow_below_m, p.narrow_width_m),
    )  # fmt: skip
    _turn(
        mean, cov, heading, length,
        (p.turn_gain, p.turn_gain_per_mps, p.turn_gain_max, p.turn_above_mps, p.turn_certainty),
    )  # fmt: skip
    settled = (tracks.hits > p.trust_heading_hits) | tracks.standing
    _along_only(mean, cov, heading, settled, p.sideways_std_mps, p.sideways_young_mps, p.sideways_share)
    return tracks.but(mean=mean, cov=cov, heading_rad=heading, length_m=length, width_m=width, extent_m=ring)


@kernel
def _learn_length(
    mean: F64, heading: F64, length: F64, width: F64, ring: F64, measured: F64, hit: Bool, hits: I64,
    points_per_hit: F64, across_std_rad: float, lengths: tuple[float, ...], widths: tuple[float, ...],
) -> None:  # fmt: skip
    """Update lengths and widths in place, holding the near face (at the near edge of view, the far one)."""
    percentile, margin, growth, edge_growth, shrink, frozen_below, frozen_after = lengths[:7]
    shortest, longest, car, narrow_extent, narrow_points, narrow_hits = lengths[7:]
    wide_from, wide, car_width, narrow_below, narrow_width = widths
    ordered = np.empty(ring.shape[1])
    for i in range(len(length)):
        if not hit[i] or measured[i, M_COUNT] < 2.0:
            continue
        x, y = mean[i, 0], mean[i, 3]
        speed = math.hypot(mean[i, 1], mean[i, 4])
        aspect = heading[i] - math.atan2(x, y)
        across = across_std_rad * math.hypot(x, y)
        extent = measured[i, M_U_MAX] - measured[i, M_U_MIN] - 2.0 * abs(math.sin(aspect)) * across
        ring[i, hits[i] % ring.shape[1]] = max(extent, 0.0)
        if speed < frozen_below and hits[i] > frozen_after:
            continue
        count = 0
        for past in ring[i]:
            if math.isnan(past):  # not yet seen
                continue
            at = count
            while at > 0 and ordered[at - 1] > past:
                ordered[at] = ordered[at - 1]
                at -= 1
            ordered[at] = past
            count += 1
        rank = min(max(math.ceil(percentile / 100.0 * count) - 1, 0), count - 1)
        seen = ordered[rank] + margin
        target = max(seen, car)
        if count >= narrow_hits and seen < narrow_extent and points_per_hit[i] < narrow_points:
            target = shortest
        edge = measured[i, M_EDGE] > 0.5
        change = min(max(target - length[i], -shrink), edge_growth if edge else growth)
        new = min(max(length[i] + change, shortest), longest)
        facing = math.cos(aspect)
        if abs(facing) > 0.5:
            shift = 0.5 * (new - length[i]) * (1.0 if (facing > 0.0) != edge else -1.0)
            mean[i, 0] += shift * math.sin(heading[i])
            mean[i, 3] += shift * math.cos(heading[i])
        length[i] = new
        width[i] = wide if new > wide_from else (narrow_width if new < narrow_below else car_width)


@kernel
def _turn(mean: F64, cov: F64, heading: F64, length: F64, turning: tuple[float, ...]) -> None:
    """Turn boxes towards their velocity, about the near face, in place."""
    gain0, gain_per_mps, gain_max, above, certainty = turning
    for i in range(len(heading)):
        vx, vy = mean[i, 1], mean[i, 4]
        speed = math.hypot(vx, vy)
        if speed <= above or speed <= certainty * math.sqrt(0.5 * (cov[i, 1, 1] + cov[i, 4, 4])):
            continue
        before = heading[i]
        error = (math.atan2(vx, vy) - before + math.pi) % (2.0 * math.pi) - math.pi
        if abs(error) > 0.5 * math.pi:
            # a first guess that was the wrong way round is turned over at once: the box is the same either
            # way
            before += math.pi
            error -= math.copysign(math.pi, error)
        after = before + min(gain0 + gain_per_mps * speed, gain_max) * error
        after = (after + math.pi) % (2.0 * math.pi) - math.pi
        arm = 0.5 * length[i] * (-1.0 if math.cos(after - math.atan2(mean[i, 0], mean[i, 3])) > 0.0 else 1.0)
        mean[i, 0] += arm * (math.sin(before) - math.sin(after))
        mean[i, 3] += arm * (math.cos(before) - math.cos(after))
        heading[i] = after


@kernel
def _along_only(
    mean: F64, cov: F64, heading: F64, settled: Bool, std_mps: float, young_mps: float, share: float
) -> None:
    """Apply, in place, the pseudo-measurement that a vehicle does not move sideways.

    Its standard deviation is wide while the heading is a guess, and narrow once hits have settled it. Without
    Doppler a young track's velocity may point anywhere: there its heading must not bind it.
    """
    gain, joseph = np.empty(6), np.empty((6, 6))
    for t in range(len(mean)):
        a, b = math.cos(heading[t]), -math.sin(heading[t])  # H = [0 a 0 0 b 0]
        guess = max(young_mps, math.sqrt(0.125 * (cov[t, 1, 1] + cov[t, 4, 4])))
        std = (std_mps if settled[t] else guess) + share * math.hypot(mean[t, 1], mean[t, 4])
        r = std * std
        sideways = a * mean[t, 1] + b * mean[t, 4]
        s = a * a * cov[t, 1, 1] + 2.0 * a * b * cov[t, 1, 4] + b * b * cov[t, 4, 4] + r
        for i in range(6):
            gain[i] = (a * cov[t, i, 1] + b * cov[t, i, 4]) / s
        # Joseph form, written out for one row of H
        for i in range(6):
            for j in range(6):
                joseph[i, j] = cov[t, i, j] - gain[i] * (a * cov[t, 1, j] + b * cov[t, 4, j])
        for i in range(6):
            for j in range(i, 6):
                value = joseph[i, j] - (a * joseph[i, 1] + b * joseph[i, 4]) * gain[j] + r * gain[i] * gain[j]
                cov[t, i, j] = cov[t, j, i] = value
        for i in range(6):
            mean[t, i] -= gain[i] * sideways
