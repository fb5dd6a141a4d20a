"""Learn how long a vehicle is and which way it points, keeping the face that the radar sees where it is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.heading_kernels import (
    drift_apart,
    follow_road,
    follow_row,
    going_along,
    pivots,
    slip_rad,
    turn,
)
from service.tracking.kernel import kernel, part
from service.tracking.length_kernels import learn_length
from service.tracking.model import F64, Bool
from service.tracking.state import Tracks


@dataclass(frozen=True, slots=True)
class ExtentParameters:
    """Learning of length and heading."""

    percentile: float = 75.0  # of the extents of the last hits, nearest rank
    end_margin_m: float = 0.4  # the outermost echoes lie this much inside the box, both ends together ...
    end_margin_share: float = 0.07  # ... or, of a long vehicle, this share of its length
    told_points: float = 4.0  # points a hit from which extents tell both ends of a car ...
    told_points_per_m: float = 0.65  # ... and of a longer vehicle; fewer tell only how long it is at least
    told_aspect_rad: float = 0.45  # ... as do those of one further from end-on: others hide its end
    growth_m: float = 0.25  # most that the length grows in a frame
    edge_growth_m: float = 0.8  # ... while the box enters or leaves the view
    shrink_m: float = 0.05
    frozen_below_mps: float = 2.5  # slower boxes stop growing: noise and the next in the queue inflate them
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
    assumed_hits: int = 40  # until then the car's length is but assumed, and given up as fast as a box grows
    turn_above_mps: float = 1.0
    turn_certainty: float = 2.5  # the box turns once its speed is so many standard deviations
    turn_rate_gain: float = 0.01  # 1: a critically damped alpha-beta filter; 0: nobody is taken to turn on
    turn_rate_decay_s: float = 3.0
    turn_memory_frames: float = 2.0  # frames over which the error of a velocity's direction repeats itself
    wander_radius_m: float = 20.0  # vehicles turn this sharply as a rule, for about a second
    wander_accel_mps2: float = 2.0  # ... and pull this much sideways
    slip_bound: float = 2.0  # of a turning vehicle's slip, how far it may go sideways: it lasts for frames
    one_way_std_rad: float = 0.35  # a vehicle further off the road's direction is turning
    settled_std_rad: float = 0.25  # a heading better known than this cannot be the wrong way round, ...
    guess_m: float = 8.0  # ... unless the vehicle was born standing and has come no further than this
    turn_radius_m: float = 6.0  # no vehicle turns more sharply ...
    turn_accel_mps2: float = 5.0  # ... or pulls more than this sideways
    sideways_std_mps: float = 0.4  # how far a vehicle may move sideways to its heading ...
    sideways_share: float = 0.06  # ... and more with its speed, where all drive its way
    # ... where they do not, or nobody knows: a turning vehicle's heading is wrong for half a second, ten
    # frames on end
    sideways_free_mps: float = 1.2
    sideways_free_share: float = 0.15
    # wheels roll: a vehicle goes sideways in proportion to its speed ahead
    sideways_full_mps: float = 1.0  # below this speed the first of both shrinks with it ...
    sideways_least: float = 0.1  # ... down to this share
    bind_std_rad: float = 0.3  # a heading known no better binds nothing: each would make the other certain
    # a box that is carried sideways frame after frame is turning, whatever its velocity says
    drift_gain: float = 0.15  # weight of the newest sideways residual in its running mean
    scatter_gain: float = 0.05  # the same, of how far its points scatter across
    drift_free: float = 0.5  # running mean, in standard deviations, at which the binding is halved
    # the direction in which all others drive measures a heading, too
    road_std_rad: float = 0.05  # of a vehicle about it ...
    road_memory_frames: float = 5.0  # ... which says the same for so many frames
    road_gate_rad: float = 0.6  # a vehicle further off turns, or its heading is no more than a guess
    # the row of points along the side that the radar sees measures a heading, too
    row_aspect_rad: float = math.radians(30.0)  # ... of vehicles seen this much from the side
    row_long_aspect_rad: float = math.radians(12.0)  # ... a truck's tells at less, where no road does
    row_memory_frames: float = 1.5  # which says the same for so many frames
    row_bias_rad: float = 0.05  # which of its scatterers answer best turns a vehicle's row for good
    row_gate_rad: float = 0.8  # a row turned further holds points of a neighbour
    # a settled box that stands or crawls goes where its velocity says, and hardly where its points say
    held_hits: int = 30
    held_below_mps: float = 0.5
    held_noise_times: float = 30.0  # its places err alike frame after frame, and are worth so much less
    held_step_m: float = 0.01  # most that the points move it in a frame, end-on ...
    held_side_on_step_m: float = 0.03  # ... and side-on, where the range rate tells little
    # side-on no range rate tells that a vehicle drives off, but its points do, all of them, frame after frame
    ahead_gain: float = 0.15  # weight of the newest frame in the mean of how far ahead they put its box ...
    ahead_below_mps: float = 3.0  # ... which is taken below this speed
    ahead_free_m: float = 0.8  # mean, or so far behind, from which it is neither held nor taken to stand
    # a vehicle without a range rate and with little speed is taken to stand
    still_range_rate_mps: float = 0.25
    still_speed_mps: float = 1.5
    still_std_mps: float = 0.5  # how far that binds, end-on, in one frame ...
    still_side_on_mps: float = 1.5  # ... and as much more side-on, where the range rate tells little


def learn(
    tracks: Tracks, measured: F64, hit: Bool, one_way: Bool, road_heading: F64, across_std_rad: float,
    dt_s: float, p: ExtentParameters,
) -> Tracks:  # fmt: skip
    """Return the tracks with their length, width, heading and sideways speed settled after a frame.

    measured (T, MEASUREMENT_COLUMNS) of each track's own points, hit (T,); one_way (T,): all drive one way
    there, road_heading (T,) [rad]; across_std_rad: azimuth noise of a point.
    """
    if not len(tracks):
        return tracks
    mean, cov, ring = tracks.mean.copy(), tracks.cov.copy(), tracks.extent_m.copy()
    heading, length, width = tracks.heading_rad.copy(), tracks.length_m.copy(), tracks.width_m.copy()
    learn_length(
        mean, heading, length, width, ring, measured, hit, tracks.hits, tracks.points_per_hit, across_std_rad,
        (p.percentile, p.growth_m, p.edge_growth_m, p.shrink_m, p.frozen_below_mps,
         float(p.frozen_after_hits), p.length_min_m, p.length_max_m, p.car_length_m, p.narrow_extent_m,
         p.narrow_points, float(p.narrow_hits), float(p.assumed_hits)),
        (p.end_margin_m, p.end_margin_share, p.told_points, p.told_points_per_m, math.cos(p.told_aspect_rad)),
        (p.wide_from_m, p.wide_m, p.car_width_m, p.narrow_below_m, p.narrow_width_m),
    )  # fmt: skip
    heading_var = tracks.heading_var.copy()
    turn_rate, drift, scatter = tracks.turn_rate_radps.copy(), tracks.drift.copy(), tracks.scatter.copy()
    loose = drift_apart(
        mean, cov, heading, measured, hit, drift, scatter, p.scatter_gain, p.drift_gain, p.drift_free,
        p.turn_above_mps,
    )  # fmt: skip
    pivot = pivots(measured, hit, length)
    follow_road(
        mean, heading, heading_var, pivot, one_way, road_heading, p.road_std_rad**2 * p.road_memory_frames,
        p.road_gate_rad,
    )  # fmt: skip
    goes, along = np.empty(len(heading), dtype=np.bool_), math.cos(p.one_way_std_rad)
    going_along(heading, one_way, road_heading, along, goes)
    follow_row(
        mean, heading, heading_var, length, goes, measured, hit,
        (math.cos(p.row_aspect_rad), p.wide_from_m, math.cos(p.row_long_aspect_rad), p.row_memory_frames,
         p.row_gate_rad, p.row_bias_rad**2),
    )  # fmt: skip
    going_along(heading, one_way, road_heading, along, goes)  # as it lies now
    slip = slip_rad(mean, length, goes, p.wander_radius_m, p.wander_accel_mps2)
    guess = tracks.standing  # which way it stood when it was born was a guess
    if guess.any():  # few scenes have any
        guess = guess & (tracks.come_m < p.guess_m)
    turn(
        mean, cov, heading, heading_var, turn_rate, pivot, guess, slip, dt_s,
        (p.turn_above_mps, p.turn_certainty, p.turn_memory_frames, p.wander_radius_m, p.wander_accel_mps2,
         p.settled_std_rad**2, p.turn_radius_m, p.turn_accel_mps2, p.turn_rate_gain),
    )  # fmt: skip
    _along_only(
        mean, cov, heading, heading_var, goes, loose, p.slip_bound * slip,
        (p.sideways_std_mps, p.sideways_share, p.sideways_free_mps, p.sideways_free_share,
         p.sideways_full_mps, p.sideways_least, p.bind_std_rad**2),
    )  # fmt: skip
    _stand_still(
        mean, cov, heading, hit & (np.abs(tracks.ahead_m) <= p.ahead_free_m),
        (p.still_range_rate_mps, p.still_speed_mps, p.still_std_mps, p.still_side_on_mps),
    )  # fmt: skip
    return tracks.but(
        mean=mean, cov=cov, heading_rad=heading, heading_var=heading_var, turn_rate_radps=turn_rate,
        drift=drift, scatter=scatter, length_m=length, width_m=width, extent_m=ring,
    )  # fmt: skip


def turn_on(tracks: Tracks, mean: F64, dt_s: float, p: ExtentParameters) -> tuple[Tracks, F64]:
    """Return predicted tracks and means (T, 6) whose headings, velocities and accelerations turn on."""
    if not len(tracks):
        return tracks, mean
    out, heading, rate = mean.copy(), tracks.heading_rad.copy(), tracks.turn_rate_radps.copy()
    _turn_on(out, heading, rate, dt_s, math.exp(-dt_s / p.turn_rate_decay_s))
    return tracks.but(heading_rad=heading, turn_rate_radps=rate), out


@kernel
def _turn_on(mean: F64, heading: F64, turn_rate: F64, dt_s: float, decay: float) -> None:
    for i in range(len(heading)):
        turn_rate[i] *= decay
        angle = turn_rate[i] * dt_s
        heading[i] += angle
        c, s = math.cos(angle), math.sin(angle)
        for k in (1, 2):  # velocity and acceleration
            right, ahead = mean[i, k], mean[i, k + 3]
            mean[i, k], mean[i, k + 3] = c * right + s * ahead, c * ahead - s * right


@kernel
def _along_only(
    mean: F64, cov: F64, heading: F64, heading_var: F64, goes: Bool, loose: F64, slip: F64,
    q: tuple[float, ...],
) -> None:  # fmt: skip
    """Apply, in place, the pseudo-measurement that a vehicle does not move sideways.

    The less the heading is known, the less it binds: its error turns speed into sideways speed. One that is
    hardly known binds not at all: what it made of the velocity would come back as its own certainty.
    """
    std_mps, share, free_mps, free_share, full, least, bind = q
    gain, joseph = np.empty(6), np.empty((6, 6))
    for t in range(len(mean)):
        if heading_var[t] > bind and not goes[t]:
            continue
        a, b = math.cos(heading[t]), -math.sin(heading[t])  # H = [0 a 0 0 b 0]
        ahead = abs(a * mean[t, 4] - b * mean[t, 1])
        along = mean[t, 1] * mean[t, 1] + mean[t, 4] * mean[t, 4]
        part = min(max(ahead / full, least, 1.0 - 1.0 / loose[t]), 1.0)  # a turning box does not stand
        base, rest = (std_mps, share) if goes[t] else (free_mps, free_share)
        std = part * base + rest * math.sqrt(along)
        std = math.hypot(std, slip[t] * math.sqrt(along))
        along += cov[t, 1, 1] + cov[t, 4, 4]
        r = std * std * loose[t] + along * heading_var[t]
        _condition(mean[t], cov[t], a, b, r, gain, joseph)


@kernel
def _stand_still(
    mean: F64, cov: F64, heading: F64, hit: Bool, limits: tuple[float, float, float, float]
) -> None:
    """Apply, in place, the pseudo-measurement that what hardly moves along the line of sight stands.

    Noise of position would else make the boxes of a queue seen side-on creep from one vehicle to the next.
    """
    rate_mps, speed_mps, std_mps, side_on_mps = limits
    gain, joseph = np.empty(6), np.empty((6, 6))
    for t in range(len(mean)):
        g = max(math.hypot(mean[t, 0], mean[t, 3]), 1.0)
        rate = (mean[t, 0] * mean[t, 1] + mean[t, 3] * mean[t, 4]) / g
        if not hit[t] or abs(rate) > rate_mps or math.hypot(mean[t, 1], mean[t, 4]) > speed_mps:
            continue
        s, c = math.sin(heading[t]), math.cos(heading[t])
        across = (c * mean[t, 0] - s * mean[t, 3]) / g
        std = std_mps + side_on_mps * across * across
        _condition(mean[t], cov[t], s, c, std * std, gain, joseph)


@part
def _condition(mean: F64, cov: F64, a: float, b: float, r: float, gain: F64, joseph: F64) -> None:
    """Condition one state, in place, on a speed of zero, of variance r, along H = [0 a 0 0 b 0]."""
    speed = a * mean[1] + b * mean[4]
    s = a * a * cov[1, 1] + 2.0 * a * b * cov[1, 4] + b * b * cov[4, 4] + r
    for i in range(6):
        gain[i] = (a * cov[i, 1] + b * cov[i, 4]) / s
    # Joseph form, written out for one row of H
    for i in range(6):
        for j in range(6):
            joseph[i, j] = cov[i, j] - gain[i] * (a * cov[1, j] + b * cov[4, j])
    for i in range(6):
        for j in range(i, 6):
            value = joseph[i, j] - (a * joseph[i, 1] + b * joseph[i, 4]) * gain[j] + r * gain[i] * gain[j]
            cov[i, j] = cov[j, i] = value
    for i in range(6):
        mean[i] -= gain[i] * speed
