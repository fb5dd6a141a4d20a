"""Fly the filters of the MAST-UKF paper, alone or as the models of an IMM, after its turning target."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from service.evaluation.bound import posterior_bound
from service.evaluation.monte_carlo import run_filter
from service.simulation.point_radar import PointNoise, measure
from service.simulation.turning_target import PERIOD_S, TURN_RADPS, turning_target
from service.tracking.filters.base import Filter
from service.tracking.filters.imm import Imm
from service.tracking.filters.mast_ukf import PAPER, mast_ukf
from service.tracking.filters.parameters import (
    UNBOUNDED,
    MastUkfParameters,
    StUkfParameters,
    UkfParameters,
)
from service.tracking.filters.space import PLANE_AXES, ROAD_COLUMNS, PolarSensor, Space, velocity_step
from service.tracking.filters.space_filter import SpaceFilter, Trusting
from service.tracking.filters.ukf import ast_ukf, st_ukf, ukf
from service.tracking.model import F64
from service.tracking.start import two_point_state, undirected_prior

SETTLED = 10  # seconds after which errors count
_SPEED_STD_MPS = 100.0
_TRANSITION = np.array([[0.8, 0.1, 0.1], [0.1, 0.8, 0.1], [0.1, 0.1, 0.8]])
_PRINTED = StUkfParameters(robust_gate=None, softening=1.0, lambda_max=UNBOUNDED)
_GUARDED = StUkfParameters(robust_gate=None, lambda_max=4.0)  # the cap compounds: 4 at 1 Hz

MAKERS: Mapping[str, Callable[[Space], SpaceFilter]] = MappingProxyType({
    "UKF": lambda s: ukf(UkfParameters(robust_gate=None), s),
    "ST-UKF": lambda s: st_ukf(_PRINTED, s),
    "AST-UKF": lambda s: ast_ukf(_PRINTED, s),
    "MAST-UKF": lambda s: mast_ukf(MastUkfParameters(form=PAPER), s),
    "ST-UKF, guarded": lambda s: st_ukf(_GUARDED, s),
    "AST-UKF, guarded": lambda s: ast_ukf(_GUARDED, s),
    "MAST-UKF, safe": lambda s: mast_ukf(MastUkfParameters(), s),
})  # fmt: skip


@dataclass(frozen=True, slots=True)
class Reading:
    """One way to read the paper's simulation."""

    range_std_m: float
    azimuth_std_deg: float
    accel_std_mps2: float  # process noise of every model; the paper states none
    many_models: bool = True  # straight and both circles in an IMM; else straight only
    outliers: float = 0.0

    @property
    def noise(self) -> PointNoise:
        """Return the noise of the radar."""
        return PointNoise(self.range_std_m, math.radians(self.azimuth_std_deg), outlier_share=self.outliers)


@dataclass(frozen=True, slots=True)
class Flight:
    """The estimates (K, N, 4) [x vx y vy] of each filter, from the second scan on, and the truth (K, 4)."""

    truth: F64
    z: F64  # (K, N, 3)
    mean: Mapping[str, F64]

    def squared(self, name: str) -> F64:
        """Return the squared errors (K, N, 4) after the settling time."""
        return np.square(self.mean[name] - self.truth[:, None])[SETTLED:]


def fly(reading: Reading, names: Sequence[str], runs: int, seed: Sequence[int]) -> Flight:
    """Return what the filters make of `runs` measurements of the turning target."""
    truth = turning_target()[0]
    noise = reading.noise
    many = np.broadcast_to(truth[:, None], (len(truth), runs, 6))
    z = measure(many, noise, np.random.default_rng(seed))
    R = np.broadcast_to(noise.covariance(), (runs, 3, 3))
    prior = undirected_prior(_SPEED_STD_MPS)
    mean, cov = two_point_state(z[0], R, z[1], R, dt_s=PERIOD_S, prior=prior)
    columns = list(ROAD_COLUMNS)
    mean, cov = mean[:, columns], cov[:, columns][:, :, columns]
    found = {}
    for name in names:
        chosen = filter_of(reading, name)
        start = chosen.start(mean, cov)
        found[name] = run_filter(chosen, z[1:, :, :2], noise.covariance()[:2, :2], PERIOD_S, start).mean
    return Flight(truth[1:, columns], z[1:], found)


def filter_of(reading: Reading, name: str) -> Filter:
    """Return a filter of the paper, or an IMM of three of its kind."""
    rates = (0.0, TURN_RADPS, -TURN_RADPS) if reading.many_models else (0.0,)
    models = tuple(
        replace(MAKERS[name](_space(rate, reading.accel_std_mps2)), name=f"{name} {rate:g}") for rate in rates
    )
    if len(models) == 1:
        return models[0]
    return Imm(name, models, lambda _: _TRANSITION, 4, Trusting())


def _space(turn_rate_radps: float, accel_std_mps2: float) -> Space:
    return Space(
        lambda dt_s: velocity_step(dt_s, accel_std_mps2, turn_rate_radps),
        PolarSensor(doppler=False),
        PLANE_AXES,
    )


def least_errors(reading: Reading) -> F64:
    """Return the bound (4,) on the RMS errors of [x vx y vy]: all motions known, no process noise."""
    truth, steps = turning_target()
    R = reading.noise.covariance()[:2, :2]
    P0 = np.diag([1e6, 1e4, 0.0, 1e6, 1e4, 0.0])
    bound = posterior_bound(truth, R, steps, np.zeros((6, 6)), P0)
    variances = np.diagonal(bound, axis1=1, axis2=2)[2:, list(ROAD_COLUMNS)]
    return np.asarray(np.sqrt(variances.mean(axis=0)))


def rms_over_runs(squared: F64) -> tuple[float, float]:
    """Return the root mean square over scans and runs of squared errors (K, N), and its standard error."""
    each = squared.mean(axis=0)
    value = float(np.sqrt(each.mean()))
    return value, float(each.std(ddof=1) / np.sqrt(each.size) / (2.0 * value)) if each.size > 1 else math.nan


def rms_of_mean(errors: F64) -> tuple[F64, F64]:
    """Return the RMS over scans (n,) of the mean over the runs of errors (K, N, n), and its standard error.

    Scans before the settling time do not count. The standard error is that of the jackknife over the runs.
    """
    settled = errors[SETTLED:]
    mean, runs = settled.mean(axis=1, keepdims=True), settled.shape[1]
    root = np.sqrt(np.square(mean[:, 0]).mean(axis=0))
    if runs < 2:  # noqa: PLR2004 - one run has no spread
        return root, np.full_like(root, math.nan)
    without = (runs * mean - settled) / (runs - 1)
    left_out = np.sqrt(np.square(without).mean(axis=0))  # (N, n)
    return root, np.sqrt((runs - 1) * left_out.var(axis=0))
