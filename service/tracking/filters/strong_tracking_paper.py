"""The strong tracking EKFs of the paper: one statistic for all channels, no split by axis.

Source: Electronics 2024, 13, 652, eq. 20-28, read so that they can be computed online and stay positive
definite:
* V_k = (rho V_{k-1} + e e')/(1 + rho) (eq. 22 names V_{k+1}, which is not known yet);
* M = H F P_{k-1} F' H' (eq. 24 propagates P twice); traces whitened by R, else azimuth has no say beside
range;
* fading as the congruence L^1/2 F P F' L^1/2 (eq. 28 is not symmetric) and Joseph form;
* beta (eq. 20-21 needs the true state): the candidates are scored by how well they predicted the
innovations, from
  V_{k-1}, which does not know the newest one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from service.tracking.filters.base import Expected, FilterState, Prediction
from service.tracking.filters.correction import Innovations, own_prediction, weigh
from service.tracking.filters.ekf import expect, predict_bank, start_bank
from service.tracking.filters.fading import SMOOTHER, residuals
from service.tracking.filters.fading_kernels import GRID_POINTS, SCORES, fade_states
from service.tracking.filters.parameters import AstekfPaperParameters, StekfParameters
from service.tracking.filters.robust import correct_robustly
from service.tracking.measurement import linearise
from service.tracking.model import F64
from service.tracking.motion import constant_acceleration

WIDEST_M2, WIDEST_M2PS2, WIDEST_M2PS4 = 1e7, 1e6, 1e5  # 3 km, 1 km/s, 300 m/s^2: no vehicle does that


@dataclass(frozen=True, slots=True)
class Stekf:
    """The strong tracking EKF: one fading factor for all states, fixed softening factor (eq. 22-26)."""

    parameters: StekfParameters = field(default_factory=StekfParameters)
    name: str = "stekf"
    memory_size: int = SCORES

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
        """Return the tracks after the measurements of the frame; see `base.Filter`."""
        p, own = self.parameters, own_prediction(prediction)
        z_hat, H = linearise(own.mean)
        innovations = weigh(z, R, beta, miss, z_hat)
        one_factor = AstekfPaperParameters(
            forgetting=p.forgetting,
            softening_fixed=p.softening,
            alpha_position=1.0,
            alpha_velocity=1.0,
            alpha_acceleration=1.0,
            lambda_max=p.lambda_max,
            clip=p.clip,
        )
        faded = fade(own, innovations, H, one_factor)
        return correct_robustly(own, faded, H, innovations, p)


@dataclass(frozen=True, slots=True)
class AstekfPaper:
    """The adaptive strong tracking EKF: a factor for each state, softening found online (eq. 20-28)."""

    parameters: AstekfPaperParameters = field(default_factory=AstekfPaperParameters)
    name: str = "astekf-paper"
    memory_size: int = SCORES + GRID_POINTS

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
        """Return the tracks after the measurements of the frame; see `base.Filter`."""
        p, own = self.parameters, own_prediction(prediction)
        z_hat, H = linearise(own.mean)
        innovations = weigh(z, R, beta, miss, z_hat)
        faded = fade(own, innovations, H, p)
        return correct_robustly(own, faded, H, innovations, p)


def fade(prediction: Prediction, innovations: Innovations, H: F64, p: AstekfPaperParameters) -> F64:
    """Return L^1/2 F P F' L^1/2 + Q (T, 6, 6), and update the memory of the prediction in place.

    L is diagonal with lambda_i = clip(alpha_i c), c = trace(N / R) / sum_i alpha_i diag(F P F' H' R^-1 H)_i
    (eq. 25-27) and N = V - b R - H Q H' (eq. 24), over the measured channels. The softening factor b is the
    largest candidate whose score is as good as the best; a candidate's score sums log det S + e' S^-1 e, with
    S = H (L^1/2 F P F' L^1/2 + Q) H' + R from the V before this frame.
    """
    seen = residuals(innovations, prediction, H, p.clip)
    alpha = np.array([p.alpha_position, p.alpha_velocity, p.alpha_acceleration], np.float64)
    fixed = math.nan if p.softening_fixed is None else float(p.softening_fixed)
    faded = np.empty_like(prediction.propagated)
    fade_states(
        seen.e, seen.R, seen.used, seen.q, seen.shorten, prediction.memory,
        prediction.propagated, prediction.noise, H, alpha, float(p.forgetting), float(p.lambda_max), fixed,
        float(p.softening_start), float(p.softening_step), p.warm_up, float(p.score_forgetting),
        float(p.score_tolerance), SMOOTHER, faded,
    )  # fmt: skip
    return faded if p.clip is None else _no_wider_than_anything(faded, prediction.cov)


def _no_wider_than_anything(faded: F64, unfaded: F64) -> F64:
    """Return the faded covariances, or the unfaded where the fading goes beyond all that vehicles do.

    Factors compound, and an undamped acceleration runs away with a track that has lost its vehicle. Where
    even the unfaded covariance is too wide, it is cut to its diagonal within the bounds: it is so by nearly
    perfect correlations, which rounding would turn into negative variances when a precise measurement comes.
    """
    widest = np.array([WIDEST_M2, WIDEST_M2PS2, WIDEST_M2PS4] * 2)
    wide, wider = (np.diagonal(cov, axis1=1, axis2=2) for cov in (unfaded, faded))
    cut = np.minimum(wide, widest)[:, :, None] * np.eye(len(widest))
    kept = np.where(np.asarray((wide > widest).any(axis=1))[:, None, None], cut, unfaded)
    return np.where(np.asarray((wider > widest).any(axis=1))[:, None, None], kept, faded)
