"""The vehicle ahead of a car with a radar, in clutter: the eight motions and the returns of the HPFF paper.

Positions are relative to the radar in its plan frame: x to the right, y ahead. The paper's x axis points
ahead and its y axis to one side; its scenes are symmetric, so its (x, y) is taken as our (y, x).

Source: Pak 2021, section IV. What it does not state is read as follows. M1-M6: 4 m/s, away from 10 m or
towards the radar from 100 m, the speed that its M8 prose fixes. M8: 4.5 s at -4 m/s, then linearly to rest
over 1.2 s. M7: from (10, -3.5) at 2.5 m/s outward, two lanes aside at constant speed from 4.8 to 6.6 s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from service.tracking.filters.converted import PolarNoise, located, planar_step
from service.tracking.geometry import plan_to_polar, polar_to_plan
from service.tracking.model import F64, I64

PERIOD_S = 0.3
SCANS = 65  # 19.5 s
CLOSING_MPS = 4.0
OUTWARD_MPS = 2.5
_LANE_M = 3.5
_START_Y_M = {"M1": (10.0, _LANE_M), "M2": (10.0, 0.0), "M3": (10.0, -_LANE_M)} | {
    "M4": (100.0, -_LANE_M), "M5": (100.0, 0.0), "M6": (100.0, _LANE_M),
}  # fmt: skip


def times_s() -> F64:
    """Return the time of each scan."""
    return PERIOD_S * np.arange(SCANS, dtype=np.float64)


def constant(name: str) -> F64:
    """Return motion M1 to M6, (SCANS, 4): x, y [m], vx, vy [m/s] of each scan."""
    y0, x0 = _START_Y_M[name]
    return _path(x0, y0, np.zeros(SCANS), np.full(SCANS, CLOSING_MPS if y0 < 50.0 else -CLOSING_MPS))  # noqa: PLR2004


def lane_changes() -> F64:
    """Return motion M7: from the third lane to the first within 1.8 s."""
    t = times_s()
    aside = 2.0 * _LANE_M / 1.8
    return _path(
        -_LANE_M, 10.0, np.where((t > 4.8 - 1e-9) & (t < 6.6 - 1e-9), aside, 0.0), np.full(SCANS, OUTWARD_MPS)
    )


def approach_and_keep() -> F64:
    """Return motion M8: the gap closes at 4 m/s, then stays at 79.6 m."""
    t = times_s()
    return _path(0.0, 100.0, np.zeros(SCANS), -CLOSING_MPS * np.clip((5.7 - t) / 1.2, 0.0, 1.0))


def _path(x0: float, y0: float, vx: F64, vy: F64) -> F64:
    """Return states whose velocity changes linearly within a step."""
    out = np.stack([np.full(SCANS, x0), np.full(SCANS, y0), vx, vy], axis=1)
    for axis in (0, 1):
        mean = (out[1:, 2 + axis] + out[:-1, 2 + axis]) / 2 if axis == 1 else out[:-1, 2]
        out[1:, axis] += PERIOD_S * np.cumsum(mean)
    return out


MOTIONS: Mapping[str, F64] = MappingProxyType(
    {name: constant(name) for name in _START_Y_M} | {"M7": lane_changes(), "M8": approach_and_keep()}
)


@dataclass(frozen=True, slots=True)
class Clutter:
    """How many false returns, how often the target is missed, and the noise of the rest."""

    per_m2: float = 1e-2  # lambda; heavy clutter: 1e-1
    miss_share: float = 0.05  # scans without the target's return; the first two always have it
    gate: float = 9.21
    noise: PolarNoise = field(default_factory=PolarNoise)


def false_returns(truth: F64, clutter: Clutter, accel_std_mps2: float) -> I64:
    """Return how many false returns each scan has: floor(10 pi gamma |S|^1/2 lambda + 1) (eq. 27, 28).

    S is that of a Kalman filter without clutter, which does not depend on what is measured.
    """
    A, Q = planar_step(PERIOD_S, accel_std_mps2)
    R = located(truth[:, None, :2], clutter.noise).R[:, 0]
    cov = np.zeros((4, 4))
    cov[:2, :2], cov[:2, 2:], cov[2:, :2] = R[1], R[1] / PERIOD_S, R[1] / PERIOD_S
    cov[2:, 2:] = (R[0] + R[1]) / PERIOD_S**2
    count = np.zeros(len(truth), np.int64)
    for k in range(2, len(truth)):
        cov = A @ cov @ A.T + Q
        S = cov[:2, :2] + R[k]
        volume = np.pi * clutter.gate * np.sqrt(np.linalg.det(S))
        count[k] = int(10.0 * volume * clutter.per_m2 + 1.0)
        cov = cov - cov[:, :2] @ np.linalg.solve(S, cov[:2])
    return count


def scan(target: F64, count: int, clutter: Clutter, runs: int, rng: np.random.Generator) -> F64:
    """Return the returns (runs, 1 + count, 2) [m] of one scan, the target's first, NaN when it is missed.

    False returns lie evenly in a square about the target's return, with sides so that their density is
    lambda (section IV).
    """
    n = clutter.noise
    r, azimuth = plan_to_polar(target[0], target[1])
    r = r + n.range_std_m * rng.standard_normal(runs)
    azimuth = azimuth + n.azimuth_std_rad * rng.standard_normal(runs)
    own = np.stack(polar_to_plan(r, azimuth), axis=-1)
    side = np.sqrt(count / clutter.per_m2)
    others = own[:, None, :] + side * (rng.random((runs, count, 2)) - 0.5)
    missed = rng.random(runs) < clutter.miss_share
    own = np.where(missed[:, None], np.nan, own)
    return np.concatenate([own[:, None, :], others], axis=1)
