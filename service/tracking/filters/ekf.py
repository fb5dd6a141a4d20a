"""Extended Kalman filter over a damped constant-acceleration model, with or without the robust update.

It predicts and starts for the strong tracking filters too, which differ in the update only.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from service.tracking.filters.base import Expected, FilterState, Prediction
from service.tracking.filters.correction import own_prediction, symmetric, weigh
from service.tracking.filters.correction_kernels import project
from service.tracking.filters.parameters import EkfParameters
from service.tracking.filters.robust import correct_robustly
from service.tracking.kernel import ready
from service.tracking.measurement import CHANNELS, linearise
from service.tracking.model import F64
from service.tracking.motion import Motion, constant_acceleration


@dataclass(frozen=True, slots=True)
class Ekf:
    """The extended Kalman filter; its memory is the count of rejected frames in a row."""

    parameters: EkfParameters = field(default_factory=EkfParameters)
    name: str = "ekf"
    memory_size: int = 1

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
        own = own_prediction(prediction)
        z_hat, H = linearise(own.mean)
        innovations = weigh(z, R, beta, miss, z_hat)
        return correct_robustly(own, own.cov, H, innovations, self.parameters)


def start_bank(mean: F64, cov: F64, memory_size: int) -> FilterState:
    """Return new tracks with nothing remembered."""
    return FilterState(mean.astype(np.float64), symmetric(cov), np.zeros((len(mean), memory_size)))


def predict_bank(state: FilterState, motion: Motion) -> Prediction:
    """Return the tracks moved by one step of a linear motion model."""
    mean, propagated = motion.move(state.mean, state.cov)
    return Prediction(mean, propagated, motion.Q, state.memory)


def expect(prediction: Prediction) -> Expected:
    """Return the expected measurement of each predicted track, linearised at its mean."""
    z_hat, H = linearise(prediction.mean)
    S_prior = np.empty((len(H), CHANNELS, CHANNELS))
    project(H, ready(prediction.cov), S_prior)
    return Expected(z_hat, H, S_prior)
