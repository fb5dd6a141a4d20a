"""How a vehicle moves between two frames: transition and process noise of the state [x vx ax y vy ay].

Every model of the live tracker has these six states, so that tracks of different filters have one shape.
Both axes move alike and apart, so F and Q are two equal 3x3 blocks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from service.errors import InvalidInput
from service.tracking.kernel import kernel, ready
from service.tracking.model import F64

STATES = 6
POSITION = (0, 3)  # x, y in the state
VELOCITY = (1, 4)
ACCELERATION = (2, 5)

NOISE_PERIOD_S = 0.05  # the frame period for which `accel_std_mps2` is given: 20 Hz, as in the ASTEKF paper
# Beyond this the acceleration's decay inside one step matters (T/3tau > 6 % at tau 1.3 s); longer steps are
# composed.
LONGEST_STEP_S = 0.25
PADDING_STD_MPS2 = 1e-3  # keeps the covariance of the unused acceleration of the CV model positive definite


@dataclass(frozen=True, slots=True)
class Motion:
    """One step of a linear motion model: x' = F x + w, w ~ N(0, Q)."""

    F: F64  # (6, 6)
    Q: F64  # (6, 6)

    def move(self, mean: F64, cov: F64) -> tuple[F64, F64]:
        """Return F x (T, 6) and F P F' (T, 6, 6) of a batch of means and covariances, exactly symmetric."""
        F, x, P = ready(self.F), ready(mean), ready(cov)
        new_mean, new_cov = np.empty_like(x), np.empty_like(P)
        _move(F, x, P, new_mean, new_cov)
        return new_mean, new_cov


@kernel
def _move(F: F64, mean: F64, cov: F64, new_mean: F64, new_cov: F64) -> None:
    row = np.empty(STATES)  # of F P
    for t in range(len(mean)):
        for i in range(STATES):
            new_mean[t, i] = 0.0
            for j in range(STATES):
                new_mean[t, i] += F[i, j] * mean[t, j]
                row[j] = 0.0
            for k in range(STATES):
                if F[i, k] != 0.0:  # two in three are: the axes move apart, nothing moves its integral
                    for j in range(STATES):
                        row[j] += F[i, k] * cov[t, k, j]
            for j in range(i + 1):
                value = 0.0
                for k in range(STATES):
                    value += row[k] * F[j, k]
                new_cov[t, i, j] = new_cov[t, j, i] = value


@lru_cache(maxsize=64)  # frames come at one rate, give or take the grain of the sensor's clock
def constant_acceleration(dt_s: float, accel_std_mps2: float, tau_s: float | None = None) -> Motion:
    """Return the constant-acceleration step, damped with time constant `tau_s` (None: undamped).

    Per axis A = diag(1, 1, phi) [[1, T, T^2/2], [0, 1, T], [0, 0, 1]], phi = exp(-T/tau), Q = q^2 G G' with
    G = [T^2/2, T, 1]: at each step the acceleration decays to phi of itself and takes a random jump.
    `accel_std_mps2` is the std of that jump at T = 0.05 s; at another T its variance is scaled by
    (1 - phi(T)^2) / (1 - phi(0.05)^2) (undamped: T / 0.05), so the acceleration of a track has the same
    spread whatever the frame rate. Steps longer than 0.25 s are composed of equal shorter ones.

    Source: Electronics 2024, 13, 652, eq. 3, 5, 6; damping and scaling as in Singer 1970.
    Raises InvalidInput when `dt_s` is negative or not finite.
    """
    _check_step(dt_s)
    pieces = max(1, math.ceil(dt_s / LONGEST_STEP_S))
    step_s = dt_s / pieces
    phi = 1.0 if tau_s is None else math.exp(-step_s / tau_s)
    jump, half = accel_std_mps2**2 * _noise_scale(step_s, tau_s), step_s * step_s / 2
    A = np.array([[1.0, step_s, half], [0.0, 1.0, step_s], [0.0, 0.0, phi]])
    G = np.array([half, step_s, 1.0])
    Q = jump * (G[:, None] * G)
    F_axis, Q_axis = A, Q
    for _ in range(pieces - 1):
        F_axis, Q_axis = A @ F_axis, A @ Q_axis @ A.T + Q
    return _both_axes(F_axis, Q_axis)


def constant_velocity(dt_s: float, density_m2ps3: float) -> Motion:
    """Return the constant-velocity step with white acceleration of power spectral density `density_m2ps3`.

    Per axis Q = density [[T^3/3, T^2/2], [T^2/2, T]], exact for any division of time. The acceleration in
    the state neither moves anything nor is remembered: after each step it is zero with a small variance.

    Source: Bar-Shalom, Li, Kirubarajan 2001, section 6.2.2.
    Raises InvalidInput when `dt_s` is negative or not finite.
    """
    _check_step(dt_s)
    F = np.array([[1.0, dt_s, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    Q = np.zeros((3, 3))
    Q[:2, :2] = density_m2ps3 * np.array([[dt_s**3 / 3, dt_s**2 / 2], [dt_s**2 / 2, dt_s]])
    Q[2, 2] = PADDING_STD_MPS2**2
    return _both_axes(F, Q)


def _check_step(dt_s: float) -> None:
    if not (math.isfinite(dt_s) and dt_s >= 0.0):
        raise InvalidInput.at("/dt_s", f"want a finite time step of at least 0 s, got {dt_s!r}")


def _noise_scale(step_s: float, tau_s: float | None) -> float:
    if tau_s is None:
        return step_s / NOISE_PERIOD_S
    return math.expm1(-2.0 * step_s / tau_s) / math.expm1(-2.0 * NOISE_PERIOD_S / tau_s)


def _both_axes(F_axis: F64, Q_axis: F64) -> Motion:
    F, Q = np.zeros((STATES, STATES)), np.zeros((STATES, STATES))
    F[:3, :3] = F[3:, 3:] = F_axis
    Q[:3, :3] = Q[3:, 3:] = Q_axis
    return Motion(F, Q)
