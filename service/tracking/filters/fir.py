"""Minimum-variance FIR filter: the state that a short window of positions alone determines.

It has no past beyond the window and needs no start, so it cannot diverge. Two forms, equal to rounding:
`fit_window`, weighted least squares in the newest state, which allows for holes in the window and says how
well the positions fit; and `fir_gains`, the paper's batch form, for its tables.

Source: HPFF paper (Pak 2021), eq. 26, with its misprints corrected as noted; Kwon and Han 2005.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.filters.converted import PLANAR_STATES, planar_step
from service.tracking.model import F64, I64, Bool

FEWEST = 2  # positions that determine a position and a velocity


@dataclass(frozen=True, slots=True)
class FirWindow:
    """The positions of the last N scans, oldest first, one of each; scans without one are holes."""

    z: F64  # (..., N, 2) x, y [m]
    R: F64  # (..., N, 2, 2)
    seen: Bool  # (..., N) False: a hole, whose z and R mean nothing

    def push(self, z: F64, R: F64, seen: Bool) -> FirWindow:
        """Return the window with one more scan (..., 2) at its end and the oldest forgotten."""
        return FirWindow(
            np.concatenate([self.z[..., 1:, :], np.where(seen[..., None], z, 0.0)[..., None, :]], axis=-2),
            np.concatenate(
                [
                    self.R[..., 1:, :, :],
                    np.where(seen[..., None, None], R, np.eye(2))[..., None, :, :],
                ],
                axis=-3,
            ),
            np.concatenate([self.seen[..., 1:], seen[..., None]], axis=-1),
        )

    def take(self, which: Bool | I64) -> FirWindow:
        """Return the windows of the chosen members of a batch."""
        return FirWindow(self.z[which], self.R[which], self.seen[which])


def empty_window(leading: tuple[int, ...], horizon: int) -> FirWindow:
    """Return windows of holes for a batch of that shape."""
    z = np.zeros((*leading, horizon, 2))
    R = np.broadcast_to(np.eye(2), (*leading, horizon, 2, 2)).copy()
    return FirWindow(z, R, np.zeros((*leading, horizon), dtype=np.bool_))


@dataclass(frozen=True, slots=True)
class FirEstimate:
    """What the windows say of the states at the time asked for."""

    mean: F64  # (..., 4) [x y vx vy]
    cov: F64  # (..., 4, 4)
    misfit: F64  # (...) chi-square of the residuals, 2 count - 4 degrees of freedom
    count: I64  # (...) positions in the window; fewer than two determine nothing: mean and cov are NaN


def fit_window(window: FirWindow, dt_s: float, accel_std_mps2: float, ahead: int = 1) -> FirEstimate:
    """Return the estimate `ahead` steps after the newest scan of the window (the paper's filter: 1).

    With the state x_k as unknown, the position at scan h, (k - h) steps back, is p_k - (k - h) T v_k +
    sum over the steps s = h..k-1 of T^2 (s - h + 1/2) w_s, so the stacked positions have the covariance
    sigma_w^2 T^4 sum_s (s - h + 1/2)(s - h' + 1/2) + R_h, and x_k follows by weighted least squares.
    """
    horizon = window.seen.shape[-1]
    back = np.arange(horizon - 1, -1, -1) + ahead  # steps from each scan to the estimate
    H, V = _rows(back, dt_s), _covariance(window, back, dt_s, accel_std_mps2)
    flags = np.repeat(window.seen, 2, axis=-1)
    z = np.where(flags, window.z.reshape(flags.shape), 0.0)
    H = np.where(flags[..., None], H, 0.0)
    weighted = np.linalg.solve(V, np.concatenate([H, z[..., None]], axis=-1))
    information = H.swapaxes(-1, -2) @ weighted
    count = window.seen.sum(axis=-1)
    enough = (count >= FEWEST)[..., None, None]
    cov = np.linalg.inv(np.where(enough, information[..., :PLANAR_STATES], np.eye(PLANAR_STATES)))
    cov = (cov + cov.swapaxes(-1, -2)) * 0.5
    mean = cov @ information[..., PLANAR_STATES:]
    residual = z[..., None] - H @ mean
    misfit = residual.swapaxes(-1, -2) @ np.linalg.solve(V, residual)
    return FirEstimate(
        np.where(enough, mean, np.nan)[..., 0],
        np.where(enough, cov, np.nan),
        np.where(enough, misfit, np.nan)[..., 0, 0],
        count,
    )


def _rows(back: I64, dt_s: float) -> F64:
    """Return H (2N, 4): the position at each scan from the state at the time of the estimate."""
    H = np.zeros((len(back), 2, PLANAR_STATES))
    H[:, 0, 0] = H[:, 1, 1] = 1.0
    H[:, 0, 2] = H[:, 1, 3] = -back * dt_s
    return H.reshape(2 * len(back), PLANAR_STATES)


def _covariance(window: FirWindow, back: I64, dt_s: float, accel_std_mps2: float) -> F64:
    """Return V (..., 2N, 2N) of the stacked positions; holes stand apart with variance 1."""
    n, steps = len(back), int(back.max())
    step = np.arange(steps)  # counted back from the estimate: s = k - 1 - step
    lever = np.where(step[None, :] < back[:, None], back[:, None] - step[None, :] - 0.5, 0.0)
    noise = accel_std_mps2**2 * dt_s**4 * (lever @ lever.T)
    both = window.seen[..., :, None] & window.seen[..., None, :]
    V = np.zeros((*window.seen.shape, 2, n, 2))
    for axis in range(2):
        V[..., :, axis, :, axis] = np.where(both, noise, 0.0)
    each = np.arange(n)
    for a in range(2):
        for b in range(2):
            V[..., each, a, each, b] += np.where(window.seen, window.R[..., a, b], float(a == b))
    return V.reshape(*window.seen.shape[:-1], 2 * n, 2 * n)


def fir_gains(R: F64, dt_s: float, accel_std_mps2: float) -> tuple[F64, F64, F64]:
    """Return L (..., 4, 2N), P* (..., 4, 4) and P* as the paper prints it, of windows with R (..., N, 2, 2).

    x* = L z one step after the window (eq. 26). Corrected: J_N = [A^N, A^(N-1) G, ..., G]; the entries of
    G_bar count back from the last scan; P* = J_N M^-1 J_N'. The printed P* = K_N Q_N K_N' + L R_N L' adds the
    process noise as if L did not see it, and is up to three times too large where that noise matters.
    """
    n = R.shape[-3]
    A, _ = planar_step(dt_s, 0.0)
    G = np.vstack([np.eye(2) * dt_s * dt_s / 2, np.eye(2) * dt_s])
    power = [np.linalg.matrix_power(A, k) for k in range(n + 1)]
    C_bar = np.vstack([power[h][:2] for h in range(n)])
    G_bar = np.zeros((2 * n, 2 * n))
    for h in range(1, n):
        for s in range(h):
            G_bar[2 * h : 2 * h + 2, 2 * s : 2 * s + 2] = (power[h - 1 - s] @ G)[:2]
    K = np.hstack([power[n - 1 - s] @ G for s in range(n)])
    J, left = np.hstack([power[n], K]), np.hstack([C_bar, G_bar])
    noise = np.zeros((*R.shape[:-3], n, 2, n, 2))
    for h in range(n):
        noise[..., h, :, h, :] = R[..., h, :, :]
    R_bar = noise.reshape(*R.shape[:-3], 2 * n, 2 * n)
    weighted = np.linalg.solve(R_bar, np.broadcast_to(left, (*R_bar.shape[:-1], left.shape[1])))
    M = left.T @ weighted
    M[..., PLANAR_STATES:, PLANAR_STATES:] += np.eye(2 * n) / accel_std_mps2**2
    L = np.swapaxes(np.linalg.solve(M, np.broadcast_to(J.T, (*M.shape[:-1], len(J)))), -1, -2)
    cov = L @ J.T
    gains = L @ weighted.swapaxes(-1, -2)
    printed = accel_std_mps2**2 * (K @ K.T) + gains @ R_bar @ gains.swapaxes(-1, -2)
    return gains, cov, printed
