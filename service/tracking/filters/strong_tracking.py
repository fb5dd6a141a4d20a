"""The recommended adaptive strong tracking EKF: it forgets its past faster while the target manoeuvres.

It differs from the form of the paper (Electronics 2024, 13, 652; see `strong_tracking_paper`) in two
things. The statistic is the running mean of the signed innovation, which sums the correlation at all lags
(the paper's eq. 23) where the residual covariance of eq. 22 sees two residuals. And each axis of the line
of sight has its own fading: range and range rate drive the radial one, azimuth the tangential one, so that
braking leaves the lateral estimate alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from service.tracking.filters.base import Expected, FilterState, Prediction
from service.tracking.filters.correction import own_prediction, weigh
from service.tracking.filters.ekf import expect, predict_bank, start_bank
from service.tracking.filters.fading import SMOOTHER, Residuals, residuals
from service.tracking.filters.fading_kernels import AXES, GRID_POINTS, SCORES, axis_factors, fade_axes
from service.tracking.filters.parameters import AstekfParameters
from service.tracking.filters.robust import correct_robustly
from service.tracking.measurement import NEAREST_M, linearise
from service.tracking.model import F64
from service.tracking.motion import constant_acceleration


@dataclass(frozen=True, slots=True)
class Astekf:
    """The adaptive strong tracking EKF with fading per line-of-sight axis."""

    parameters: AstekfParameters = field(default_factory=AstekfParameters)
    name: str = "astekf"
    memory_size: int = SCORES + AXES * GRID_POINTS

    def start(self, mean: F64, cov: F64) -> FilterState:
        """Return new tracks; see `base.Filter`."""
        return start_bank(mean, cov, self.memory_size)

    def predict(self, state: FilterState, dt_s: float) -> Prediction:
        """Return the tracks moved `dt_s` seconds ahead."""
        p = self.parameters
        return predict_bank(state, constant_acceleration(dt_s, p.accel_std_mps2, p.accel_tau_s))

    def expected(self, prediction: Prediction) -> Expected:
        """Return the expected measurement of each predicted track."""
        return expect(prediction)

    def update(self, prediction: Prediction, z: F64, R: F64, beta: F64, miss: F64) -> FilterState:
        """Return the tracks after the measurements of the frame; see `base.Filter`.

        Without a measurement the prediction is unfaded and the memory unchanged.
        """
        p, own = self.parameters, own_prediction(prediction)
        z_hat, H = linearise(own.mean)
        innovations = weigh(z, R, beta, miss, z_hat)
        factors = fading_factors(residuals(innovations, own, H, p.clip), own.memory, p)
        return correct_robustly(own, fade(own, factors), H, innovations, p)


def fading_factors(seen: Residuals, memory: F64, p: AstekfParameters) -> F64:
    """Return the factors lambda (T, 2, 3) by axis and derivative, and update the memory in place.

    Per axis, over its measured channels j with the shares w_j: V_j = (2-g)/g mean_j^2, equal to S_j while the
    innovations are white;  c = (sum V_j/R_j - b n - sum q_j/R_j) / sum w_j m_j/R_j;  lambda_i =
    clip(alpha_i c). The softening factor b of an axis is the largest candidate whose score is as good as the
    best. A candidate's score sums log var_j + e_j^2/var_j, var_j = lambda m_j + q_j + R_j, with lambda from
    the statistic before this frame; it is proper: the true variance has the least expected score.
    """
    alpha = np.array([p.alpha_position, p.alpha_velocity, p.alpha_acceleration], np.float64)
    fixed = math.nan if p.softening_fixed is None else float(p.softening_fixed)
    factors = np.empty((len(memory), AXES, len(alpha)))
    axis_factors(
        seen.e, seen.R, seen.used, seen.m, seen.q, seen.shorten, memory, alpha, float(p.statistic_gain),
        float(p.lambda_max), fixed, float(p.softening_start), float(p.softening_step), p.warm_up,
        float(p.score_forgetting), float(p.score_tolerance), SMOOTHER, factors,
    )  # fmt: skip
    return factors


def fade(prediction: Prediction, factors: F64) -> F64:
    """Return W F P F' W' + Q (T, 6, 6): the spread along and across the line of sight times the factors.

    For each derivative the 2x2 block of W in x, y is sqrt(l_radial) u u' + sqrt(l_tangential) t t', with u
    the unit vector to the target and t normal to it; a congruence keeps C symmetric and positive definite.
    factors: (T, 2, 3) by axis and derivative, each >= 1.
    """
    p, faded = prediction, np.empty_like(prediction.propagated)
    fade_axes(p.propagated, p.noise, p.mean, factors, NEAREST_M, faded)
    return faded
