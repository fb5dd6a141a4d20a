"""The errors of a filter on single vehicles in traffic that turn, brake hard, stop and go, in batches.

For choosing and testing filters without association: each simulated vehicle is a track with its own
measurements. Whole recordings are the business of `wayside compare`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from service.evaluation.monte_carlo import error_squared, rmse, run_filter
from service.simulation.manoeuvres import PERIOD_S, traffic
from service.simulation.point_radar import PointNoise, measure
from service.tracking.filters.base import Filter
from service.tracking.filters.space import PLANE_COLUMNS, ROAD_COLUMNS
from service.tracking.model import F64
from service.tracking.start import two_point_state, undirected_prior

SETTLED = round(2.0 / PERIOD_S)  # frames after which errors count
DIVERGED_M = 10.0
RADAR = PointNoise(0.75, math.radians(0.3))
DOPPLER = replace(RADAR, velocity_std_mps=0.1)
DEFECTS = {"outlier_share": 0.05, "miss_share": 0.1}


@dataclass(frozen=True, slots=True)
class Errors:
    """What a filter made of a batch of vehicles, from two seconds after its start on."""

    position_m: float  # root mean square
    velocity_mps: float
    diverged: float  # share of vehicles farther than 10 m in the last tenth
    nees: float  # per state; 1 when the covariance is what it says
    nis: float  # per channel


def fly(chosen: Filter, true: PointNoise, assumed: PointNoise, seed: int, runs: int = 30) -> Errors:
    """Return the errors of a filter of the plane (four states first: x vx y vy) over `runs` vehicles.

    true: the noise of the radar; assumed: that of which the filter knows.
    """
    rng = np.random.default_rng(seed)
    truth = traffic(rng, runs)
    z, R = measure(truth, true, rng), assumed.covariance()
    channels = 2 if assumed.velocity_std_mps is None else 3
    all_R = np.broadcast_to(R, (runs, *R.shape))
    mean, cov = two_point_state(z[0], all_R, z[1], all_R, dt_s=PERIOD_S, prior=undirected_prior())
    columns = list(ROAD_COLUMNS)
    start = chosen.start(mean[:, columns], cov[:, columns][:, :, columns])
    flown = run_filter(chosen, z[1:, :, :channels], R[:channels, :channels], PERIOD_S, start, with_nis=True)
    exact = truth[1:][..., columns]
    x, vx, y, vy = PLANE_COLUMNS
    far = np.hypot(*np.moveaxis((flown.mean - exact)[-len(exact) // 10 :][..., [x, y]], -1, 0))
    return Errors(
        rmse(flown.mean[SETTLED:], exact[SETTLED:], (x, y)),
        rmse(flown.mean[SETTLED:], exact[SETTLED:], (vx, vy)),
        float((far.max(axis=0) > DIVERGED_M).mean()),
        float(error_squared(flown, exact, SETTLED).mean()) / exact.shape[-1],
        float(np.nanmean(flown.nis[SETTLED:])) / channels if flown.nis is not None else math.nan,
    )


def mean_errors(
    chosen: Filter, true: PointNoise, assumed: PointNoise, seeds: range, runs: int = 30
) -> Errors:
    """Return the errors averaged over seeds."""
    each = [fly(chosen, true, assumed, seed, runs) for seed in seeds]
    table: F64 = np.array(
        [(e.position_m, e.velocity_mps, e.diverged, e.nees, e.nis) for e in each], np.float64
    )
    return Errors(*(float(value) for value in table.mean(axis=0)))
