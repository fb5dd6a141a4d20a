"""The errors of a filter on single vehicles in traffic that turn, brake hard, stop and go, in batches.

For choosing and testing filters without association: each simulated vehicle is a track with its own
measurements. Whole recordings are the business of `wayside compare`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from service.errors import InvalidInput
from service.evaluation.monte_carlo import error_squared, run_filter
from service.simulation.manoeuvres import FOLLOWING_PERIOD_S, PERIOD_S, following, traffic
from service.simulation.point_radar import PointNoise, measure
from service.tracking.filters.base import Filter, FilterState
from service.tracking.filters.sage_husa import SafeEstimator
from service.tracking.filters.space import ROAD_COLUMNS
from service.tracking.filters.space_filter import SpaceFilter
from service.tracking.model import F64
from service.tracking.start import two_point_state, undirected_prior

SETTLED = round(2.0 / PERIOD_S)  # frames after which errors count
DIVERGED_M = 10.0
RADAR = PointNoise(0.75, math.radians(0.3))
DOPPLER = replace(RADAR, velocity_std_mps=0.1)
CAR_RADAR = PointNoise(0.25, math.radians(0.5))
CAR_DOPPLER = replace(CAR_RADAR, velocity_std_mps=0.1)
NOISE_LEVELS = (1.0, 4.0, 9.0, 1.0)  # of the variances, a quarter of the drive each
EARLIER = 5  # frames, 0.2 s
DEFECTS = {"outlier_share": 0.05, "miss_share": 0.1}


@dataclass(frozen=True, slots=True)
class Errors:
    """What a filter made of a batch of vehicles, from two seconds after its start on."""

    position_m: float  # root mean square
    velocity_mps: float
    ahead_m: float  # ... of y alone
    ahead_mps: float  # ... of vy alone
    diverged: float  # share of vehicles farther than 10 m in the last tenth
    nees: float  # per state; 1 when the covariance is what it says
    nis: float  # per channel


def fly(chosen: Filter, true: PointNoise, assumed: PointNoise, seed: int, runs: int = 30) -> Errors:
    """Return the errors of a filter of the plane (four states first: x vx y vy) over `runs` vehicles.

    true: the noise of the radar; assumed: that of which the filter knows.
    """
    rng = np.random.default_rng(seed)
    truth = traffic(rng, runs)
    return errors_of(chosen, truth, measure(truth, true, rng), assumed, PERIOD_S)


def follow(  # noqa: PLR0913 - one option a keyword
    chosen: Filter,
    true: PointNoise,
    assumed: PointNoise,
    seed: int,
    runs: int = 30,
    *,
    brake_mps2: float = 0.0,
) -> Errors:
    """Return the errors over `runs` vehicles ahead of a car, whose radar's noise changes each quarter.

    true: the noise of the first and last quarter; its variances are 4 and 9 times that in the others.
    """
    truth, z = _drives(true, seed, runs, brake_mps2)
    return errors_of(chosen, truth, z, assumed, FOLLOWING_PERIOD_S)


def estimated_levels(chosen: SpaceFilter, true: PointNoise, seed: int, runs: int = 30) -> F64:
    """Return (4, m) the median over the runs of `estimated_scales`."""
    return np.asarray(np.median(estimated_scales(chosen, true, seed, runs), axis=1))


def estimated_scales(chosen: SpaceFilter, true: PointNoise, seed: int, runs: int) -> F64:
    """Return (4, N, m) the scale of R that the filter has 0.2 s before each quarter of a drive ends.

    The filter knows the noise of the first quarter; the truth is `NOISE_LEVELS`.
    """
    if not isinstance(chosen.adaptation, SafeEstimator):
        raise InvalidInput(f"{chosen.name} estimates no scale of R")
    truth, z = _drives(true, seed, runs, 0.0)
    channels = chosen.space.sensor.channels
    R = true.covariance()[:channels, :channels]
    state, levels = plane_start(chosen, z, true.covariance(), FOLLOWING_PERIOD_S), []
    all_R = np.broadcast_to(R, (runs, 1, *R.shape))
    marks = np.cumsum([len(part) for part in np.array_split(truth, len(NOISE_LEVELS))]) - EARLIER
    for k in range(2, len(z)):
        prediction = chosen.predict(state, FOLLOWING_PERIOD_S)
        state = chosen.update(prediction, z[k, :, None, :channels], all_R, np.ones((runs, 1)), np.zeros(runs))
        if k in marks:
            levels.append(np.array(chosen.adaptation.noise_scale(state)))
    return np.array(levels)


def errors_of(chosen: Filter, truth: F64, z: F64, assumed: PointNoise, dt_s: float) -> Errors:
    """Return the errors of a filter of the plane on truth (K, N, 6) and measurements z (K, N, 3)."""
    R, columns = assumed.covariance(), list(ROAD_COLUMNS)
    channels = 2 if assumed.velocity_std_mps is None else 3
    start = plane_start(chosen, z, R, dt_s)
    flown = run_filter(chosen, z[1:, :, :channels], R[:channels, :channels], dt_s, start, with_nis=True)
    error = (flown.mean - truth[1:][..., columns])[SETTLED:]
    far = np.hypot(error[-len(truth) // 10 :, :, 0], error[-len(truth) // 10 :, :, 2])
    root = np.sqrt((error**2).mean(axis=(0, 1)))
    return Errors(
        float(np.hypot(root[0], root[2])),
        float(np.hypot(root[1], root[3])),
        float(root[2]),
        float(root[3]),
        float((far.max(axis=0) > DIVERGED_M).mean()),
        float(error_squared(flown, truth[1:][..., columns], SETTLED).mean()) / len(columns),
        math.nan if flown.nis is None else float(np.nanmean(flown.nis[SETTLED:])) / channels,
    )


def changing(truth: F64, noise: PointNoise, rng: np.random.Generator) -> F64:
    """Return measurements (K, N, 3) with 1, 4, 9 and 1 times the variances, a quarter of the drive each.

    Outliers and misses are those of the noise; the first two frames of each quarter have none.
    """
    parts = np.array_split(truth, len(NOISE_LEVELS))
    levels = zip(parts, NOISE_LEVELS, strict=True)
    return np.concatenate([measure(part, noise.times(math.sqrt(level)), rng) for part, level in levels])


def plane_start(chosen: Filter, z: F64, R: F64, dt_s: float) -> FilterState:
    """Return tracks of the plane, [x vx y vy], at the second frame of z (K, N, 3), from the first two.

    R: (3, 3), or (N, 3, 3) of each track.
    """
    all_R = np.broadcast_to(R, (z.shape[1], 3, 3))
    mean, cov = two_point_state(z[0], all_R, z[1], all_R, dt_s=dt_s, prior=undirected_prior())
    columns = list(ROAD_COLUMNS)
    return chosen.start(mean[:, columns], cov[:, columns][:, :, columns])


def _drives(true: PointNoise, seed: int, runs: int, brake_mps2: float) -> tuple[F64, F64]:
    """Return truth (K, runs, 6) and measurements (K, runs, 3) of drives behind another vehicle."""
    rng = np.random.default_rng(seed)
    truth = following(rng, runs, brake_mps2)
    return truth, changing(truth, true, rng)


def mean_errors(
    chosen: Filter, true: PointNoise, assumed: PointNoise, seeds: range, runs: int = 30
) -> Errors:
    """Return the errors averaged over seeds."""
    each = [fly(chosen, true, assumed, seed, runs) for seed in seeds]
    table: F64 = np.array([[getattr(e, f.name) for f in fields(Errors)] for e in each], np.float64)
    return Errors(*(float(value) for value in table.mean(axis=0)))
