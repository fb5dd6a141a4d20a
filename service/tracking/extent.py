"""Learn how long a vehicle is and which way it points, keeping the face that the radar sees where it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.tracking.boxes import M_COUNT, M_EDGE, M_U_MAX, M_U_MIN
from service.tracking.model import F64, Bool
from service.tracking.state import Tracks


@dataclass(frozen=True, slots=True)
class ExtentParameters:
    """Learning of length and heading."""

    percentile: float = 75.0  # of the extents of the last hits
    end_margin_m: float = 0.4  # the outermost echoes lie this much inside the box, both ends together
    growth_m: float = 0.25  # most that the length grows in a frame
    edge_growth_m: float = 0.8  # ... while the box enters or leaves the view
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
    narrow_width_m: float = 0.9
    narrow_hits: int = 12  # hits with several points before a vehicle may be found to be short
    turn_gain: float = 0.15
    turn_gain_per_mps: float = 0.02
    turn_above_mps: float = 1.0
    turn_certainty: float = 2.5  # the box turns once its speed is so many standard deviations
    trust_heading_hits: int = 25  # hits that settle a heading
    sideways_std_mps: float = 0.4  # how far a vehicle may move sideways to its settled heading ...
    sideways_young_mps: float = 1.0  # ... to one that is still a guess ...
    sideways_share: float = 0.06  # ... and more with its speed


def _percentile(extent_m: F64, percentile: float) -> F64:
    """Return the percentile of each row (T, n), NaN entries left out; 0 for an empty row. Nearest rank."""
    ordered = np.sort(extent_m, axis=1)  # NaN last
    count = np.isfinite(extent_m).sum(axis=1)
    rank = np.clip(np.ceil(percentile / 100.0 * count).astype(np.int64) - 1, 0, extent_m.shape[1] - 1)
    value = ordered[np.arange(len(ordered)), rank]
    return np.where(count > 0, value, 0.0)


def learn_length(tracks: Tracks, measured: F64, hit: Bool, across_m: F64, p: ExtentParameters) -> Tracks:
    """Return the tracks with lengths and widths after a frame, the near face held where it is.

    measured (T, MEASUREMENT_COLUMNS) of each track's own points, hit (T,), across_m (T,): standard deviation of a point
    across the line of sight.
    """
    bearing = np.arctan2(tracks.x_m, tracks.y_m)
    aspect = tracks.heading_rad - bearing
    extent = measured[:, M_U_MAX] - measured[:, M_U_MIN] - 2.0 * np.abs(np.sin(aspect)) * across_m
    several = hit & (measured[:, M_COUNT] >= 2)
    ring = tracks.extent_m.copy()
    column = tracks.hits % ring.shape[1]
    row = np.flatnonzero(several)
    ring[row, column[row]] = np.maximum(extent[row], 0.0)

    seen = _percentile(ring, p.percentile) + p.end_margin_m
    enough = np.isfinite(ring).sum(axis=1) >= p.narrow_hits
    target = np.where(
        enough & (seen < 2.6) & (tracks.points_per_hit < 3.5),
        p.length_min_m,
        np.maximum(seen, p.car_length_m),
    )
    edge = measured[:, M_EDGE] > 0.5
    grow = np.clip(target - tracks.length_m, -0.05, np.where(edge, p.edge_growth_m, p.growth_m))
    frozen = (tracks.speed_mps < p.frozen_below_mps) & (tracks.hits > p.frozen_after_hits)
    grow = np.where(several & ~frozen, grow, 0.0)
    length = np.clip(tracks.length_m + grow, p.length_min_m, p.length_max_m)

    width = np.where(
        length > p.wide_from_m, p.wide_m, np.where(length < 3.0, p.narrow_width_m, p.car_width_m)
    )
    # hold the near face: the centre moves away from the radar by half the growth (towards it at the near edge)
    facing = np.where(np.cos(aspect) > 0.0, 1.0, -1.0) * (np.abs(np.cos(aspect)) > 0.5)
    shift = 0.5 * (length - tracks.length_m) * facing * np.where(edge, -1.0, 1.0)
    mean = tracks.mean.copy()
    mean[:, 0] += shift * np.sin(tracks.heading_rad)
    mean[:, 3] += shift * np.cos(tracks.heading_rad)
    return replace(tracks, mean=mean, length_m=length, width_m=width, extent_m=ring)


def turn(tracks: Tracks, p: ExtentParameters) -> Tracks:
    """Return the tracks with their boxes turned towards their velocity, about the near face."""
    speed = tracks.speed_mps
    std = np.sqrt(0.5 * (tracks.cov[:, 1, 1] + tracks.cov[:, 4, 4]))
    error = np.arctan2(tracks.mean[:, 1], tracks.mean[:, 4]) - tracks.heading_rad
    error = (error + np.pi) % (2.0 * np.pi) - np.pi
    gain = np.minimum(p.turn_gain + p.turn_gain_per_mps * speed, 0.6)
    moving = (speed > p.turn_above_mps) & (speed > p.turn_certainty * std)
    # a first guess that was the wrong way round is turned over at once: the box is the same either way
    over = moving & (np.abs(error) > 0.5 * np.pi)
    before = tracks.heading_rad + np.where(over, np.pi, 0.0)
    error = np.where(over, error - np.sign(error) * np.pi, error)
    heading = before + np.where(moving, gain * error, 0.0)
    heading = (heading + np.pi) % (2.0 * np.pi) - np.pi
    bearing = np.arctan2(tracks.x_m, tracks.y_m)
    arm = 0.5 * tracks.length_m * np.where(np.cos(heading - bearing) > 0.0, -1.0, 1.0)
    mean = tracks.mean.copy()
    mean[:, 0] += arm * (np.sin(before) - np.sin(heading))
    mean[:, 3] += arm * (np.cos(before) - np.cos(heading))
    return replace(tracks, mean=mean, heading_rad=heading)


def along_only(tracks: Tracks, p: ExtentParameters) -> Tracks:
    """Return the tracks after the pseudo-measurement that a vehicle does not move sideways.

    Its standard deviation is wide while the heading is a guess, and narrow once hits have settled it.
    """
    if not len(tracks):
        return tracks
    settled = (tracks.hits > p.trust_heading_hits) | tracks.standing
    h = np.zeros((len(tracks), 6))
    h[:, 1], h[:, 4] = np.cos(tracks.heading_rad), -np.sin(tracks.heading_rad)
    sideways = np.einsum("ti,ti->t", h, tracks.mean)
    # without Doppler a young track's velocity may point anywhere: its heading must not bind it
    guess = np.maximum(p.sideways_young_mps, np.sqrt(0.125 * (tracks.cov[:, 1, 1] + tracks.cov[:, 4, 4])))
    r = (np.where(settled, p.sideways_std_mps, guess) + p.sideways_share * tracks.speed_mps) ** 2
    ph = np.einsum("tij,tj->ti", tracks.cov, h)
    s = np.einsum("ti,ti->t", h, ph) + r
    k = ph / s[:, None]
    mean = tracks.mean - k * sideways[:, None]
    a = np.eye(6) - k[:, :, None] * h[:, None, :]
    cov = a @ tracks.cov @ a.transpose(0, 2, 1) + r[:, None, None] * k[:, :, None] * k[:, None, :]
    return replace(tracks, mean=mean, cov=0.5 * (cov + cov.transpose(0, 2, 1)))
