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

import dataclasses
from dataclasses import dataclass, field

import numpy as np

from service.tracking.filters.base import Expected, FilterState, Prediction
from service.tracking.filters.correction import masked_inverse, weigh
from service.tracking.filters.ekf import expect, predict_bank, start_bank
from service.tracking.filters.fading import (
    GRID_POINTS,
    Residuals,
    evidence,
    grid,
    residuals,
    softening,
)
from service.tracking.filters.parameters import AstekfPaperParameters, StekfParameters
from service.tracking.filters.robust import REJECTED, correct_robustly
from service.tracking.measurement import CHANNELS, jacobian, predict_measurement
from service.tracking.model import F64
from service.tracking.motion import constant_acceleration

# columns of the memory
COUNT = REJECTED + 1  # measurements so far
RESIDUAL = slice(COUNT + 1, COUNT + 1 + CHANNELS)  # diagonal of the residual covariance V
SCORES = slice(RESIDUAL.stop, RESIDUAL.stop + GRID_POINTS)


@dataclass(frozen=True, slots=True)
class Stekf:
    """The strong tracking EKF: one fading factor for all states, fixed softening factor (eq. 22-26)."""

    parameters: StekfParameters = field(default_factory=StekfParameters)
    name: str = "stekf"
    memory_size: int = RESIDUAL.stop

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
        p = self.parameters
        H = jacobian(prediction.mean)
        innovations = weigh(z, R, beta, miss, predict_measurement(prediction.mean))
        seen = residuals(evidence(innovations), prediction.propagated, prediction.noise, H, p.clip)
        memory = prediction.memory.copy()
        V = _remember(memory, seen, p.forgetting)
        spread = (seen.used * seen.m / seen.R).sum(axis=1)
        c = _excess(V, seen, p.softening) / np.where(spread > 0.0, spread, 1.0)
        factor = np.clip(c, 1.0, p.lambda_max)
        faded = factor[:, None, None] * prediction.propagated + prediction.noise
        return correct_robustly(dataclasses.replace(prediction, memory=memory), faded, H, innovations, p)


@dataclass(frozen=True, slots=True)
class AstekfPaper:
    """The adaptive strong tracking EKF: a factor for each state, softening found online (eq. 20-28)."""

    parameters: AstekfPaperParameters = field(default_factory=AstekfPaperParameters)
    name: str = "astekf-paper"
    memory_size: int = SCORES.stop

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
        p = self.parameters
        H = jacobian(prediction.mean)
        innovations = weigh(z, R, beta, miss, predict_measurement(prediction.mean))
        seen = residuals(evidence(innovations), prediction.propagated, prediction.noise, H, p.clip)
        alpha = np.tile([p.alpha_position, p.alpha_velocity, p.alpha_acceleration], 2)
        # sum_i alpha_i diag(F P F' H' R^-1 H)_i (eq. 27)
        whitened = H * (seen.used / seen.R)[:, :, None]
        spread = ((prediction.propagated @ H.swapaxes(1, 2)) * whitened.swapaxes(1, 2)).sum(axis=2) @ alpha
        spread = np.where(spread > 0.0, spread, 1.0)
        memory = prediction.memory.copy()
        if p.softening_fixed is None:
            excess = [_excess(memory[:, RESIDUAL], seen, b) for b in grid(p.softening_step)]
            c = np.stack(excess, axis=1) / spread[:, None]
            S = _predicted_variance(prediction, seen, H, np.clip(alpha * c[:, :, None], 1.0, p.lambda_max))
            known = (seen.used.any(axis=1) & (memory[:, COUNT] > 0.0))[:, None]
            scores = np.where(
                known, p.score_forgetting * memory[:, SCORES] + _score(seen, S), memory[:, SCORES]
            )
            memory[:, SCORES] = scores
            young = memory[:, COUNT] < p.warm_up
            chosen = np.where(
                young, p.softening_start, softening(scores, p.softening_step, p.score_tolerance)
            )
        else:
            chosen = np.full(len(spread), p.softening_fixed)
        V = _remember(memory, seen, p.forgetting)
        c = _excess(V, seen, chosen) / spread
        factors = np.clip(alpha * c[:, None], 1.0, p.lambda_max)
        root = np.sqrt(factors)
        faded = root[:, :, None] * prediction.propagated * root[:, None, :] + prediction.noise
        return correct_robustly(dataclasses.replace(prediction, memory=memory), faded, H, innovations, p)


def _remember(memory: F64, seen: Residuals, forgetting: float) -> F64:
    """Update the residual covariance and the count in `memory` in place; return the diagonal of V (T, 3)."""
    squared = seen.shorten * seen.e * seen.e
    old = memory[:, RESIDUAL]
    first = (memory[:, COUNT] == 0.0)[:, None]
    new = np.where(first, squared, (forgetting * old + squared) / (1.0 + forgetting))
    V = np.where(seen.used > 0.0, new, old)
    memory[:, RESIDUAL] = V
    memory[:, COUNT] += seen.used.any(axis=1)
    return V


def _excess(V: F64, seen: Residuals, softening_factor: F64 | float) -> F64:
    """Return the whitened trace of N = V - b R - H Q H' (eq. 24) over the measured channels (T,)."""
    trace = (seen.used * (V - seen.q) / seen.R).sum(axis=1)
    return np.asarray(trace - softening_factor * seen.used.sum(axis=1))


def _predicted_variance(prediction: Prediction, seen: Residuals, H: F64, factors: F64) -> F64:
    """Return H (L^1/2 F P F' L^1/2 + Q) H' + R (T, 10, 3, 3); factors L (T, 10, 6) by candidate."""
    faded = H[:, None] * np.sqrt(factors)[:, :, None, :]
    S = faded @ prediction.propagated[:, None] @ faded.swapaxes(-1, -2)
    fixed = H @ prediction.noise @ H.swapaxes(-1, -2) + seen.R[:, :, None] * np.eye(CHANNELS)
    return np.asarray(S + fixed[:, None])


def _score(seen: Residuals, S: F64) -> F64:
    """Return log det S + e' S^-1 e (T, 10) of each candidate over the measured channels."""
    measured = np.broadcast_to((seen.used > 0.0)[:, None], S.shape[:-1])
    inverse, log_det = masked_inverse(S, measured)
    e = (np.sqrt(seen.shorten) * seen.e)[:, None, :, None]
    return log_det + (e.swapaxes(-1, -2) @ inverse @ e)[..., 0, 0]
