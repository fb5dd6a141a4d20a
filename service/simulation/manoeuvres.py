"""The road manoeuvres on which filters are compared: exact truths of single vehicles, in the plan frame.

A truth is (steps + 1, 6), the state [x vx ax y vy ay] at t = 0, dt, 2 dt, ...; the vehicle approaches the
radar from 100 to 190 m. Two motions are those of Electronics 2024, 13, 652. Between two instants
the acceleration is constant, and the state is its exact integral.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from service.errors import InvalidInput
from service.tracking.model import F64
from service.tracking.motion import constant_acceleration

PERIOD_S = 0.05
DURATION_S = 12.5
FOLLOWING_PERIOD_S = 0.04  # of the radar on a car of Sensors 2020

Profile = Callable[[float], tuple[float, float]]  # time [s] -> acceleration (ax, ay) [m/s^2]


def motion_1() -> F64:
    """Return the paper's motion 1: constant acceleration from (-8, 180)."""
    return integrate(_paper_start(), lambda _: (-0.05, -0.5))


def motion_2() -> F64:
    """Return the paper's motion 2: five constant accelerations of 2.5 s each.

    The paper names their signs and way-points only; these values obey both.
    """
    segments = ((-0.05, -0.5), (-0.12, -0.5), (-0.08, 0.3), (0.03, 0.2), (0.02, -0.4))
    return integrate(_paper_start(), lambda t: segments[min(int(t / 2.5 + 1e-9), len(segments) - 1)])


def cruise(speed_mps: float = 13.9) -> F64:
    """Return a vehicle that keeps its speed (50 km/h)."""
    return integrate(_start(-4.0, 190.0, speed_mps), lambda _: (0.0, 0.0))


def braking(deceleration_mps2: float = 6.0, speed_mps: float = 15.0, after_s: float = 4.0) -> F64:
    """Return a vehicle that brakes to a standstill and stays there."""
    stop_s = after_s + speed_mps / deceleration_mps2
    return integrate(
        _start(-4.0, 135.0, speed_mps), lambda t: (0.0, deceleration_mps2 * _within(t, after_s, stop_s))
    )


def lane_change(width_m: float = 3.5, over_s: float = 4.0, speed_mps: float = 13.9) -> F64:
    """Return a vehicle that moves one lane to the right, its lateral velocity a raised cosine."""
    begin_s, rate, mean_mps = 4.0, 2.0 * math.pi / over_s, width_m / over_s

    def profile(t: float) -> tuple[float, float]:
        # lateral velocity is mean (1 - cos); its mean slope over the step leaves both ends exact
        lo, hi = (min(max(s - begin_s, 0.0), over_s) for s in (t, t + PERIOD_S))
        return mean_mps * (math.cos(rate * lo) - math.cos(rate * hi)) / PERIOD_S, 0.0

    return integrate(_start(-4.0, 190.0, speed_mps), profile)


def stop_and_go(brake_mps2: float = 3.0, pull_mps2: float = 2.5) -> F64:
    """Return a vehicle that brakes to a standstill, waits, drives off, and brakes again."""

    def profile(t: float) -> tuple[float, float]:
        brake = brake_mps2 * (_within(t, 1.0, 1.0 + 10.0 / brake_mps2) + _within(t, 10.5, 12.5))
        return 0.0, brake - pull_mps2 * _within(t, 6.5, 10.0)

    return integrate(_start(-4.0, 100.0, 10.0), profile)


def swerve(lateral_mps2: float = 4.0, speed_mps: float = 9.0) -> F64:
    """Return a vehicle that evades something: 4 m aside and back within 4 s, at full lateral acceleration."""

    def profile(t: float) -> tuple[float, float]:
        return lateral_mps2 * (_within(t, 5.0, 6.0) - _within(t, 6.0, 8.0) + _within(t, 8.0, 9.0)), 0.0

    return integrate(_start(-4.0, 130.0, speed_mps), profile)


def traffic(rng: np.random.Generator, runs: int, duration_s: float = 30.0) -> F64:
    """Return (K, runs, 6) vehicles that change lane, brake hard to a standstill, wait, go and brake again.

    Each has its own speed, times and decelerations (5.5 to 7.5 m/s^2); they come from 168 m to about 20 m.
    """
    return np.stack([_journey(rng, duration_s) for _ in range(runs)], axis=1)


def following(rng: np.random.Generator, runs: int, brake_mps2: float = 0.0, duration_s: float = 40.0) -> F64:
    """Return (K, runs, 6) vehicles ahead of a radar on a car, 25 Hz: their relative speed swings through 0.

    Its acceleration stays below 1.2 m/s^2, but for a second of `brake_mps2` one way and the other every ten.
    """
    return np.stack([_swing(rng, brake_mps2, duration_s) for _ in range(runs)], axis=1)


def _swing(rng: np.random.Generator, brake_mps2: float, duration_s: float) -> F64:
    rate, top = math.tau / rng.uniform(9.0, 14.0), rng.uniform(0.7, 1.2)
    begin, side, distance = rng.uniform(3.0, 6.0), rng.uniform(-0.5, 0.5), rng.uniform(30.0, 45.0)

    def profile(t: float) -> tuple[float, float]:
        phase = (t - begin) % 10.0
        event = brake_mps2 * (float(0.0 <= phase < 1.0) - float(1.0 <= phase < 2.0)) * (t >= begin)  # noqa: PLR2004
        return 0.1 * math.sin(rate * t), top * math.cos(rate * t) - event

    start = np.array([side, 0.0, 0.0, distance, 0.0, 0.0])
    return integrate(start, profile, duration_s, FOLLOWING_PERIOD_S)


def _journey(rng: np.random.Generator, duration_s: float) -> F64:
    speed, brake, aside = rng.uniform(11.0, 13.0), rng.uniform(5.5, 7.5), rng.uniform(2.5, 3.5)
    change, stop = rng.uniform(1.0, 3.0), rng.uniform(6.5, 8.0)
    go, pull, again = stop + rng.uniform(4.0, 6.0), rng.uniform(1.5, 2.5), rng.uniform(21.0, 24.0)
    pace = 3.5 * pull
    rate, side, halt = math.tau / 4.0, rng.choice([-1.0, 1.0]), rng.uniform(2.0, 4.0)

    def profile(t: float) -> tuple[float, float]:
        lo, hi = (min(max(s - change, 0.0), 4.0) for s in (t, t + PERIOD_S))
        across = side * aside / 4.0 * (math.cos(rate * lo) - math.cos(rate * hi)) / PERIOD_S
        along = brake * _within(t, stop, stop + speed / brake) - pull * _within(t, go, go + 3.5)
        return across, along + halt * _within(t, again, again + pace / halt)

    return integrate(_start(rng.uniform(-8.0, 8.0), 168.0, speed), profile, duration_s)


def integrate(start: F64, profile: Profile, duration_s: float = DURATION_S, dt_s: float = PERIOD_S) -> F64:
    """Return the states at t = 0, dt, ...; each step has the acceleration of the profile at its start."""
    steps = round(duration_s / dt_s)
    if steps < 1:
        raise InvalidInput.at("/duration_s", f"want at least one step of {dt_s} s, got {duration_s} s")
    F = constant_acceleration(dt_s, 0.0).F
    truth = np.empty((steps + 1, len(start)))
    state = start.copy()
    for k in range(steps + 1):
        state[[2, 5]] = profile(k * dt_s)
        truth[k] = state
        state = F @ state
    return truth


def _within(t: float, begin_s: float, end_s: float) -> float:
    """Return the share of the step from t that lies inside the interval."""
    return min(max((min(t + PERIOD_S, end_s) - max(t, begin_s)) / PERIOD_S, 0.0), 1.0)


def _paper_start() -> F64:
    return np.array([-8.0, 0.4, -0.05, 180.0, -7.5, -0.5])


def _start(x_m: float, y_m: float, speed_mps: float) -> F64:
    return np.array([x_m, 0.0, 0.0, y_m, -speed_mps, 0.0])


# the suite on which the filters are tuned, and two manoeuvres held back from tuning
SUITE: Mapping[str, Callable[[], F64]] = MappingProxyType(
    {
        "motion 1": motion_1,
        "motion 2": motion_2,
        "cruise": cruise,
        "braking 6": braking,
        "lane change": lane_change,
        "stop and go": stop_and_go,
    }
)
HELD_OUT: Mapping[str, Callable[[], F64]] = MappingProxyType(
    {"braking 9": lambda: braking(deceleration_mps2=9.0), "swerve": swerve}
)
