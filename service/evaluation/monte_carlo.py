"""Run one filter over many simulated vehicles at once, each a track of the bank, and measure its errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.filters.base import Filter, FilterState
from service.tracking.model import F64, Bool
from service.tracking.motion import POSITION, STATES, VELOCITY
from service.tracking.start import VelocityPrior, two_point_state, undirected_prior

LOST_M = 10.0  # a track this far from its vehicle at the end of a run is lost


@dataclass(frozen=True, slots=True)
class Runs:
    """The estimates of N tracks over K frames; frames before the start are NaN."""

    mean: F64  # (K, N, 6)
    cov: F64  # (K, N, 6, 6)


def run_filter(chosen: Filter, z: F64, R: F64, dt_s: float, start: FilterState | None = None) -> Runs:
    """Return what the filter makes of measurements z (K, N, 3) with one covariance R (3, 3).

    A measurement of NaN is a miss. start: the tracks at frame 0; None for the two-point start at frame 1.
    """
    frames, tracks = z.shape[:2]
    first = 1 if start is None else 0
    state = two_point_start(chosen, z, R, dt_s) if start is None else start
    mean, cov = np.full((frames, tracks, STATES), np.nan), np.full((frames, tracks, STATES, STATES), np.nan)
    mean[first], cov[first] = state.mean, state.cov
    all_R = np.broadcast_to(R, (tracks, 1, *R.shape))
    for k in range(first + 1, frames):
        beta = np.isfinite(z[k, :, :1]).astype(np.float64)
        state = chosen.update(chosen.predict(state, dt_s), z[k, :, None], all_R, beta, 1.0 - beta[:, 0])
        mean[k], cov[k] = state.mean, state.cov
    return Runs(mean, cov)


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
