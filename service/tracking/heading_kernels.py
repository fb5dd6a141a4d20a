"""Turn boxes the way that their velocity, the road and the row of their points say."""

from __future__ import annotations

import math

import numpy as np

from service.tracking.boxes import M_COUNT, M_SCATTER, M_TURN, M_U_MEAN, M_VAR_TURN, M_VAR_W, M_W, M_W_MEAN
from service.tracking.kernel import kernel, part
from service.tracking.model import F64, Bool


@kernel
def drift_apart(
    mean: F64,
    cov: F64,
    heading: F64,
    measured: F64,
    hit: Bool,
    drift: F64,
    scatter: F64,
    scatter_gain: float,
    gain: float,
    free: float,
    above: float,
) -> F64:
    """Update the running means of sideways residuals and scatter in place; return what frees the boxes (T,).

    A wrong heading binds the velocity to a wrong line, and the points carry the box off it: residuals
    of one sign, frame after frame, where noise changes sign.
    """
    loose = np.empty(len(drift))
    for i in range(len(drift)):
        if hit[i] and measured[i, M_COUNT] > 0.0:
            s, c = math.sin(heading[i]), math.cos(heading[i])
            across = c * c * cov[i, 0, 0] - 2.0 * s * c * cov[i, 0, 3] + s * s * cov[i, 3, 3]
            residual = measured[i, M_W] / math.sqrt(measured[i, M_VAR_W] + across)
            drift[i] += gain * (min(max(residual, -3.0), 3.0) - drift[i])
            scatter[i] += scatter_gain * (min(measured[i, M_SCATTER], 9.0) - scatter[i])
        moving = math.hypot(mean[i, 1], mean[i, 4]) > above
        loose[i] = 1.0 + (drift[i] / free) ** 4 if moving else 1.0
    return loose


@kernel
def pivots(measured: F64, hit: Bool, length: F64) -> F64:
    """Return how far ahead of its centre (T,) each box is turned: in the middle of its points.

    Across the box their mean is then what it was. About any other place the points would afterwards pull the
    box sideways, and that speed would turn it again: a long box that approaches, turned about its front,
    runs away.
    """
    out = np.zeros(len(length))
    for i in range(len(length)):
        if hit[i] and measured[i, M_COUNT] > 0.0:
            out[i] = min(max(measured[i, M_U_MEAN], -0.5 * length[i]), 0.5 * length[i])
    return out


@kernel
def follow_road(
    mean: F64,
    heading: F64,
    heading_var: F64,
    pivot: F64,
    one_way: Bool,
    road_heading: F64,
    noise: float,
    gate: float,
) -> None:
    """Measure headings, in place, by the direction in which all others drive.

    The velocity of a crawling vehicle says nothing of its heading, and would turn its box across the lane.
    """
    for i in range(len(heading)):
        if not one_way[i]:
            continue
        error = (road_heading[i] - heading[i] + math.pi) % (2.0 * math.pi) - math.pi
        if abs(error) > gate:
            continue
        gain = heading_var[i] / (heading_var[i] + noise)
        heading_var[i] *= 1.0 - gain
        heading[i] = _turn_box(mean[i], heading[i], gain * error, pivot[i])


@kernel
def going_along(heading: F64, one_way: Bool, road_heading: F64, cosine: float, goes: Bool) -> None:
    """Write which boxes (T,) point the way that all drive there."""
    for i in range(len(heading)):
        goes[i] = one_way[i] and math.cos(heading[i] - road_heading[i]) > cosine


@kernel
def follow_row(
    mean: F64, heading: F64, heading_var: F64, length: F64, goes: Bool, measured: F64, hit: Bool,
    limits: tuple[float, ...],
) -> None:  # fmt: skip
    """Measure headings, in place, by the row of points along the side that the radar sees.

    The box turns about the middle of its points. Of a vehicle that turns across the line of sight the
    velocity tells the direction last of all, and of one that stands it tells nothing. A truck's row is so
    long that it tells also where only a sliver of the side is seen; a road (goes) tells that better.
    """
    end_on, long_m, long_end_on, memory, gate, bias = limits
    for i in range(len(heading)):
        if not hit[i] or measured[i, M_COUNT] == 0.0 or not math.isfinite(measured[i, M_VAR_TURN]):
            continue
        error = measured[i, M_TURN]
        aspect = heading[i] - math.atan2(mean[i, 0], mean[i, 3])
        # as it lies, or as its points say: a turn is seen end-on at first
        side_on = min(abs(math.cos(aspect)), abs(math.cos(aspect + error))) <= end_on
        side_on |= length[i] > long_m and not goes[i] and abs(math.cos(aspect)) <= long_end_on
        if not side_on or abs(error) > gate:
            continue
        gain = heading_var[i] / (heading_var[i] + memory * measured[i, M_VAR_TURN])
        heading_var[i] = max((1.0 - gain) * heading_var[i], min(bias, heading_var[i]))
        before, after = heading[i], heading[i] + gain * error
        u, w = measured[i, M_U_MEAN], measured[i, M_W_MEAN]
        mean[i, 0] += u * (math.sin(before) - math.sin(after)) + w * (math.cos(before) - math.cos(after))
        mean[i, 3] += u * (math.cos(before) - math.cos(after)) - w * (math.sin(before) - math.sin(after))
        heading[i] = (after + math.pi) % (2.0 * math.pi) - math.pi


@kernel
def slip_rad(mean: F64, length: F64, goes: Bool, radius: float, accel: float) -> F64:
    """Return by how much the direction of each centre (T,) may differ from that of its box [rad].

    In a turn the ends of a vehicle go different ways, and its middle along neither: by half its length over
    the radius, or what its speed allows of that. No slip where all drive one way, and this one with them.
    """
    out = np.zeros(len(length))
    for i in range(len(length)):
        if not goes[i]:
            speed2 = mean[i, 1] * mean[i, 1] + mean[i, 4] * mean[i, 4]
            out[i] = 0.5 * length[i] * min(1.0 / radius, accel / max(speed2, 1e-6))
    return out


@kernel
def turn(
    mean: F64, cov: F64, heading: F64, heading_var: F64, turn_rate: F64, pivot: F64, guess: Bool,
    slip: F64, dt_s: float, turning: tuple[float, ...],
) -> None:  # fmt: skip
    """Turn boxes towards their velocity, about the middle of their points, in place.

    The heading is a state of its own, a random walk as wide as a vehicle of that speed turns, measured by the
    direction of the velocity. Once it is settled it turns no faster than a vehicle can (its wheels bound
    the curvature, its tyres the sideways acceleration), and never over unless it is a guess.
    """
    above, certainty, memory, radius, accel, settled, radius_min, accel_max, rate_gain = turning
    for i in range(len(heading)):
        vx, vy = mean[i, 1], mean[i, 4]
        speed = math.hypot(vx, vy)
        rate = min(speed / radius, accel / max(speed, 1e-3))
        heading_var[i] = min(heading_var[i] + rate * rate * dt_s, 1.0)
        before, arm = heading[i], pivot[i]
        s, c = math.sin(before), math.cos(before)
        if speed <= above or speed <= certainty * math.sqrt(0.5 * (cov[i, 1, 1] + cov[i, 4, 4])):
            continue
        error = (math.atan2(vx, vy) - before + math.pi) % (2.0 * math.pi) - math.pi
        sure = heading_var[i] < settled
        if abs(error) > 0.5 * math.pi:
            if sure and not guess[i]:
                continue
            # a first guess that was the wrong way round is turned over at once: the box is the same
            before += math.pi
            arm = -arm
            error -= math.copysign(math.pi, error)
        across = c * c * cov[i, 1, 1] - 2.0 * s * c * cov[i, 1, 4] + s * s * cov[i, 4, 4]
        noise = memory * across / (speed * speed) + slip[i] * slip[i]
        gain = heading_var[i] / (heading_var[i] + noise)
        change = gain * error
        if sure:
            most = dt_s * min(speed / radius_min, accel_max / speed)
            change = min(max(change, -most), most)
            if dt_s > 0.0:
                fastest = most / dt_s
                rate = turn_rate[i] + rate_gain * gain * gain / (2.0 - gain) * error / dt_s
                turn_rate[i] = min(max(rate, -fastest), fastest)
        heading_var[i] *= 1.0 - gain
        heading[i] = _turn_box(mean[i], before, change, arm)


@part
def _turn_box(mean: F64, before: float, change: float, arm: float) -> float:
    """Turn one box about the place `arm` ahead of its centre, in place; return its new heading."""
    after = (before + change + math.pi) % (2.0 * math.pi) - math.pi
    mean[0] += arm * (math.sin(before) - math.sin(after))
    mean[3] += arm * (math.cos(before) - math.cos(after))
    return after
