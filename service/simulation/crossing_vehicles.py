"""Vehicles that meet before a roadside radar: scenes of points for the study of lost tracks.

A scene is the truth (K, T, 4), [x y vx vy] of T vehicles every 0.1 s. Two scenes are easy, two have
manoeuvres at the edge of what tyres allow (8 m/s^2); the last one, with both, was made to check the rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from service.tracking.filters.converted import PolarNoise
from service.tracking.geometry import plan_to_polar, polar_to_plan
from service.tracking.model import F64

PERIOD_S = 0.1
HARD_MPS2 = 8.0
_LANE_M = 3.5
_MARGIN_M = 15.0  # clutter lies this far around the vehicles
NOISE = PolarNoise(range_std_m=0.25, azimuth_std_rad=math.radians(0.5))

Acceleration = Callable[[float, F64], tuple[float, float]]  # time, state -> ax, ay


def steady(_t: float, _state: F64) -> tuple[float, float]:
    """Return no acceleration."""
    return 0.0, 0.0


def brake(begin_s: float, to_mps: float = 0.0) -> Acceleration:
    """Return hard braking along the motion down to a speed."""

    def acceleration(t: float, state: F64) -> tuple[float, float]:
        speed = math.hypot(state[2], state[3])
        if t < begin_s - 1e-9 or speed <= to_mps:
            return 0.0, 0.0
        pull = min(HARD_MPS2, (speed - to_mps) / PERIOD_S)
        return -pull * state[2] / speed, -pull * state[3] / speed

    return acceleration


def turn(begin_s: float, side: float) -> Acceleration:
    """Return a quarter turn at full lateral acceleration; side 1: to the right."""

    def acceleration(t: float, state: F64) -> tuple[float, float]:
        speed = math.hypot(state[2], state[3])
        if not begin_s - 1e-9 <= t < begin_s + 0.5 * math.pi * speed / HARD_MPS2:
            return 0.0, 0.0
        return side * HARD_MPS2 * state[3] / speed, -side * HARD_MPS2 * state[2] / speed

    return acceleration


def aside(begin_s: float, metres: float, then_back: float | None = None) -> Acceleration:
    """Return a move to the side (+x) at full lateral acceleration, and back after `then_back` seconds."""
    half = math.sqrt(abs(metres) / HARD_MPS2)
    moves = [(begin_s, math.copysign(1.0, metres))]
    if then_back is not None:
        moves.append((begin_s + then_back, -math.copysign(1.0, metres)))

    def acceleration(t: float, _state: F64) -> tuple[float, float]:
        for begin, side in moves:
            if begin - 1e-9 <= t < begin + half - 1e-9:
                return side * HARD_MPS2, 0.0
            if begin + half - 1e-9 <= t < begin + 2.0 * half - 1e-9:
                return -side * HARD_MPS2, 0.0
        return 0.0, 0.0

    return acceleration


Vehicle = tuple[tuple[float, float, float, float], Acceleration]


def drive(vehicles: Sequence[Vehicle], duration_s: float) -> F64:
    """Return the truth of vehicles given by start [x y vx vy] and acceleration."""
    steps = round(duration_s / PERIOD_S)
    out = np.empty((steps, len(vehicles), 4))
    for i, (start, acceleration) in enumerate(vehicles):
        state = np.array(start)
        for k in range(steps):
            out[k, i] = state
            a = np.array(acceleration(k * PERIOD_S, state))
            state = state + np.concatenate([state[2:] * PERIOD_S + a * PERIOD_S**2 / 2, a * PERIOD_S])
    return out


def cross() -> F64:
    """Return two vehicles whose ways cross at the same time."""
    return drive([((-20.0, 50.0, 8.0, 0.0), steady), ((0.0, 28.0, 0.0, 8.8), steady)], 5.0)


def overtake() -> F64:
    """Return three vehicles side by side for a while, in adjacent lanes at 10, 13 and 16 m/s."""
    lanes = ((-_LANE_M, 50.0, 10.0), (0.0, 43.0, 13.0), (_LANE_M, 36.0, 16.0))
    return drive([((x, y, 0.0, v), steady) for x, y, v in lanes], 6.0)


def six() -> F64:
    """Return six vehicles on three lanes: one brakes to a standstill, one changes lane in a second."""
    vehicles: list[Vehicle] = [
        ((-_LANE_M, 120.0, 0.0, -14.0), brake(2.5)),
        ((-_LANE_M, 80.0, 0.0, -14.0), steady),
        ((0.0, 130.0, 0.0, -15.0), steady),
        ((0.0, 100.0, 0.0, -15.0), aside(3.0, _LANE_M)),
        ((_LANE_M, 125.0, 0.0, -13.0), steady),
        ((_LANE_M, 65.0, 0.0, -16.0), brake(1.5, 2.0)),
    ]
    return drive(vehicles, 6.0)


def turn_four() -> F64:
    """Return four vehicles of which two take a right angle at 8 m/s^2."""
    vehicles: list[Vehicle] = [
        ((-2.0, 90.0, 0.0, -9.0), turn(2.0, 1.0)),
        ((2.0, 40.0, 0.0, 9.0), turn(2.5, 1.0)),
        ((-30.0, 75.0, 9.0, 0.0), steady),
        ((6.0, 100.0, 0.0, -9.0), steady),
    ]
    return drive(vehicles, 6.0)


def evade() -> F64:
    """Return a column of three that brakes one after the other, and a neighbour that evades and returns."""
    vehicles: list[Vehicle] = [
        ((0.0, 60.0, 0.0, 14.0), brake(2.0, 3.0)),
        ((0.0, 42.0, 0.0, 14.0), brake(2.6, 2.0)),
        ((0.0, 24.0, 0.0, 14.0), steady),
        ((-_LANE_M, 50.0, 0.0, 15.0), aside(2.5, -3.0, 1.8)),
        ((_LANE_M, 130.0, 0.0, -12.0), steady),
    ]
    return drive(vehicles, 6.0)


SCENES: Mapping[str, Callable[[], F64]] = MappingProxyType(
    {"cross2": cross, "over3": overtake, "six": six, "turn4": turn_four, "evade5": evade}
)
EASY = ("cross2", "over3")


def observe(
    states: F64, box: tuple[F64, F64], density_per_m2: float, detection: float, rng: np.random.Generator
) -> F64:
    """Return the returns (J, 2) of a scan: the vehicles' (NaN where missed), then clutter in the box."""
    r, azimuth = plan_to_polar(states[:, 0], states[:, 1])
    r = r + NOISE.range_std_m * rng.standard_normal(len(states))
    azimuth = azimuth + NOISE.azimuth_std_rad * rng.standard_normal(len(states))
    seen = rng.random(len(states)) < detection
    own = np.where(seen[:, None], np.stack(polar_to_plan(r, azimuth), axis=-1), np.nan)
    low, high = box
    count = rng.poisson(density_per_m2 * float(np.prod(high - low)))
    return np.concatenate([own, low + (high - low) * rng.random((count, 2))])


def surroundings(truth: F64) -> tuple[F64, F64]:
    """Return the corners of the area in which there is clutter."""
    places = truth[..., :2].reshape(-1, 2)
    return places.min(axis=0) - _MARGIN_M, places.max(axis=0) + _MARGIN_M
