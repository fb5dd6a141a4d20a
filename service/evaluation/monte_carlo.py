"""Run one filter over many simulated vehicles at once, each a track of the bank, and measure its errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.filters.base import Expected, Filter, FilterState
from service.tracking.geometry import wrap_angle
from service.tracking.measurement import AZIMUTH
from service.tracking.model import F64, Bool
from service.tracking.motion import POSITION, VELOCITY
from service.tracking.start import VelocityPrior, two_point_state, undirected_prior

LOST_M = 10.0  # a track this far from its vehicle at the end of a run is lost


@dataclass(frozen=True, slots=True)
class Runs:
    """The estimates of N tracks over K frames; frames before the start are NaN."""

    mean: F64  # (K, N, n); n is 6 on the road
    cov: F64  # (K, N, n, n)
    nis: F64 | None = None  # (K, N) normalised innovation squared if asked for, NaN where not measured


def run_filter(  # noqa: PLR0913 - one option a keyword
    chosen: Filter, z: F64, R: F64, dt_s: float, start: FilterState | None = None, *, with_nis: bool = False
) -> Runs:
    """Return what the filter makes of measurements z (K, N, m) with covariance R (m, m), or (N, m, m).

    A measurement of NaN is a miss. start: the tracks at frame 0; None for the two-point start of the road at
    frame 1.
    """
    frames, tracks = z.shape[:2]
    first = 1 if start is None else 0
    state = two_point_start(chosen, z, R, dt_s) if start is None else start
    states = state.mean.shape[-1]
    mean, cov = np.full((frames, tracks, states), np.nan), np.full((frames, tracks, states, states), np.nan)
    mean[first], cov[first] = state.mean, state.cov
    all_R, nis = np.broadcast_to(R, (tracks, *R.shape[-2:]))[:, None], np.full((frames, tracks), np.nan)
    for k in range(first + 1, frames):
        beta = np.isfinite(z[k, :, :1]).astype(np.float64)
        prediction = chosen.predict(state, dt_s)
        if with_nis:
            nis[k] = innovation_squared(chosen.expected(prediction), z[k], R)
        state = chosen.update(prediction, z[k, :, None], all_R, beta, 1.0 - beta[:, 0])
        mean[k], cov[k] = state.mean, state.cov
    return Runs(mean, cov, nis)


def innovation_squared(expected: Expected, z: F64, R: F64) -> F64:
    """Return e' S^-1 e (N,) over the measured channels of z (N, m), NaN where there is none.

    R: (m, m), or (N, m, m) of each measurement.
    """
    e = z - expected.z_hat
    e[:, AZIMUTH] = wrap_angle(e[:, AZIMUTH])
    seen = np.isfinite(e)
    pair = seen[:, :, None] & seen[:, None, :]
    S = np.where(pair, expected.S_prior + R, np.eye(z.shape[1]))
    e = np.where(seen, e, 0.0)
    nis = (e * np.linalg.solve(S, e[..., None])[..., 0]).sum(axis=1)
    return np.where(seen.any(axis=1), nis, np.nan)


def error_squared(runs: Runs, truth: F64, after: int) -> F64:
    """Return e' P^-1 e (K - after, N), whose mean is the number of states for a consistent filter."""
    e = (runs.mean - truth)[after:]
    return np.asarray((e * np.linalg.solve(runs.cov[after:], e[..., None])[..., 0]).sum(axis=-1))


def two_point_start(
    chosen: Filter, z: F64, R: F64, dt_s: float, prior: VelocityPrior | None = None
) -> FilterState:
    """Return the tracks at the second frame of z (K, N, 3), started from the first two."""
    all_R = np.broadcast_to(R, (z.shape[1], 3, 3))
    fused = two_point_state(z[0], all_R, z[1], all_R, dt_s=dt_s, prior=prior or undirected_prior())
    return chosen.start(*fused)


def rmse(estimates: F64, truth: F64, columns: tuple[int, int]) -> float:
    """Return the root mean squared length of the error over two states, such as POSITION or VELOCITY."""
    error = (estimates - truth)[..., list(columns)]
    return float(np.sqrt(np.mean(np.sum(error * error, axis=-1))))


def position_and_velocity_rmse(runs: Runs, truth: F64, after: int) -> tuple[float, float]:
    """Return both errors [m], [m/s] over the frames from `after` on; truth (K, N, 6)."""
    return rmse(runs.mean[after:], truth[after:], POSITION), rmse(runs.mean[after:], truth[after:], VELOCITY)


def peak_position_error(runs: Runs, truth: F64, after: int, percentile: float = 95.0) -> float:
    """Return the percentile over the runs of each run's largest position error [m]."""
    error = (runs.mean[after:] - truth[after:])[..., list(POSITION)]
    return float(np.percentile(np.hypot(error[..., 0], error[..., 1]).max(axis=0), percentile))


def lost(runs: Runs, truth: F64) -> Bool:
    """Return which tracks (N,) end more than ten metres from their vehicle, or nowhere."""
    error = (runs.mean[-1] - truth[-1])[..., list(POSITION)]
    return np.asarray(~(np.hypot(error[..., 0], error[..., 1]) <= LOST_M))
