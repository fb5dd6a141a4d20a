"""The recommended adaptive strong tracking EKF: it forgets its past faster while the target manoeuvres.

It differs from the form of the paper (Electronics 2024, 13, 652; see `strong_tracking_paper`) in two
things. The statistic is the running mean of the signed innovation, which sums the correlation at all lags
(the paper's eq. 23) where the residual covariance of eq. 22 sees two residuals. And each axis of the line
of sight has its own fading: range and range rate drive the radial one, azimuth the tangential one, so that
braking leaves the lateral estimate alone.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np

from service.tracking.filters.base import Expected, FilterState, Prediction
from service.tracking.filters.correction import weigh
from service.tracking.filters.ekf import expect, predict_bank, start_bank
from service.tracking.filters.fading import (
    GRID_POINTS,
    Residuals,
    evidence,
    grid,
    residuals,
    softening,
)
from service.tracking.filters.parameters import AstekfParameters
from service.tracking.filters.robust import REJECTED, correct_robustly
from service.tracking.measurement import CHANNELS, NEAREST_M, jacobian, predict_measurement
from service.tracking.model import F64
from service.tracking.motion import STATES, constant_acceleration

AXES = 2  # of the line of sight: radial, tangential
AXIS_OF_CHANNEL = np.array([0, 1, 0])  # range, azimuth, range rate
DERIVATIVE_OF_CHANNEL = np.array([0, 0, 1])  # range and azimuth see the position, range rate the velocity
CHANNELS_OF_AXIS = np.eye(AXES)[AXIS_OF_CHANNEL]  # (3, 2) sums channels into axes

# columns of the memory
COUNT = REJECTED + 1  # measurements so far
MEAN = slice(COUNT + 1, COUNT + 1 + CHANNELS)  # running mean of the innovation
SCORES = slice(MEAN.stop, MEAN.stop + AXES * GRID_POINTS)  # of each softening factor, by axis


@dataclass(frozen=True, slots=True)
class Astekf:
    """The adaptive strong tracking EKF with fading per line-of-sight axis."""

    parameters: AstekfParameters = field(default_factory=AstekfParameters)
    name: str = "astekf"
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
        """Return the tracks after the measurements of the frame; see `base.Filter`.

        Without a measurement the prediction is unfaded and the memory unchanged.
        """
        p = self.parameters
        H = jacobian(prediction.mean)
        innovations = weigh(z, R, beta, miss, predict_measurement(prediction.mean))
        seen = residuals(evidence(innovations), prediction.propagated, prediction.noise, H, p.clip)
        factors, memory = fading_factors(seen, prediction.memory, p)
        faded = fade(prediction.propagated, prediction.mean, factors) + prediction.noise
        return correct_robustly(dataclasses.replace(prediction, memory=memory), faded, H, innovations, p)


def fading_factors(seen: Residuals, memory: F64, p: AstekfParameters) -> tuple[F64, F64]:
    """Return the factors lambda (T, 2, 3) by axis and derivative, and the new memory.

    Per axis, over its measured channels j with the shares w_j: V_j = (2-g)/g mean_j^2, equal to S_j while the
    innovations are white;  c = (sum V_j/R_j - b n - sum q_j/R_j) / sum w_j m_j/R_j;  lambda_i =
    clip(alpha_i c).
    """
    alpha = np.array([p.alpha_position, p.alpha_velocity, p.alpha_acceleration])
    gain = p.statistic_gain
    share = alpha[DERIVATIVE_OF_CHANNEL]
    per_R = seen.used / seen.R
    old_mean = memory[:, MEAN]
    pull = gain * seen.used
    new_mean = (1.0 - pull) * old_mean + pull * np.sqrt(seen.shorten) * seen.e

    spread = (per_R * share * seen.m) @ CHANNELS_OF_AXIS
    spread = np.where(spread > 0.0, spread, 1.0)  # no channel: all sums are zero, and so is c
    channels = seen.used @ CHANNELS_OF_AXIS
    noise = (per_R * seen.q) @ CHANNELS_OF_AXIS
    white = (2.0 - gain) / gain
    old_excess = (white * per_R * old_mean * old_mean) @ CHANNELS_OF_AXIS - noise
    new_excess = (white * per_R * new_mean * new_mean) @ CHANNELS_OF_AXIS - noise

    updated = memory.copy()
    updated[:, MEAN] = new_mean
    updated[:, COUNT] += channels.any(axis=1)
    if p.softening_fixed is None:
        b = grid(p.softening_step)
        c = (old_excess[:, :, None] - channels[:, :, None] * b) / spread[:, :, None]
        scores = memory[:, SCORES].reshape(len(memory), AXES, GRID_POINTS)
        scored = (channels > 0.0) & (memory[:, COUNT] > 0.0)[:, None]
        scores = np.where(
            scored[:, :, None], p.score_forgetting * scores + _surprise(seen, c, share, p), scores
        )
        updated[:, SCORES] = scores.reshape(len(memory), AXES * GRID_POINTS)
        young = (memory[:, COUNT] < p.warm_up)[:, None]
        chosen = np.where(young, p.softening_start, softening(scores, p.softening_step, p.score_tolerance))
    else:
        chosen = np.full(channels.shape, p.softening_fixed)
    c = (new_excess - chosen * channels) / spread
    return np.clip(alpha * c[:, :, None], 1.0, p.lambda_max), updated


def fade(cov: F64, mean: F64, factors: F64) -> F64:
    """Return W C W' (T, 6, 6): the spread along and across the line of sight, multiplied by the factors.

    For each derivative the 2x2 block of W in x, y is sqrt(l_radial) u u' + sqrt(l_tangential) t t', with u
    the unit vector to the target and t normal to it; a congruence keeps C symmetric and positive definite.
    factors: (T, 2, 3) by axis and derivative, each >= 1.
    """
    root = np.sqrt(factors)
    along, across = root[:, 0], root[:, 1]
    u = mean[:, (0, 3)] / np.maximum(np.hypot(mean[:, 0], mean[:, 3]), NEAREST_M)[:, None]
    # written as across * identity + (along - across) u u', which is the identity without fading
    extra = along - across
    W = np.zeros((len(mean), STATES, STATES))
    for i in range(STATES // 2):
        x, y = i, i + STATES // 2
        W[:, x, x] = across[:, i] + extra[:, i] * u[:, 0] * u[:, 0]
        W[:, y, y] = across[:, i] + extra[:, i] * u[:, 1] * u[:, 1]
        W[:, x, y] = W[:, y, x] = extra[:, i] * u[:, 0] * u[:, 1]
    return W @ cov @ W


def _surprise(seen: Residuals, c: F64, share: F64, p: AstekfParameters) -> F64:
    """Return the predictive score (T, 2, 10) of each candidate, whose factors follow from c (T, 2, 10).

    The score is log var + e^2/var summed over the channels of the axis; it is proper: the true variance has
    the least expected score.
    """
    factor = np.clip(share[:, None] * c[:, AXIS_OF_CHANNEL], 1.0, p.lambda_max)
    variance = factor * seen.m[:, :, None] + (seen.q + seen.R)[:, :, None]
    squared = (seen.shorten * seen.e * seen.e)[:, :, None]
    score = seen.used[:, :, None] * (np.log(variance) + squared / variance)
    return np.stack([score[:, 0] + score[:, 2], score[:, 1]], axis=1)
