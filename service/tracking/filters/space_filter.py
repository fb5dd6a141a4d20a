"""The Kalman filter of a `Space`: by points or by a Jacobian, with a covariance or its root, adapting or not.

The families differ in three choices only. How the sensor is made linear: unscented (UKF), cubature (SRCKF) or
Jacobian (SH-EKF). Whether the update goes through a triangular root. And the `Adaptation`: what the
innovations say about the noise, such as strong tracking or the estimators of Sage and Husa.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from service.tracking.filters.base import Expected, FilterState, Prediction
from service.tracking.filters.correction import Innovations, symmetric
from service.tracking.filters.robust import Guard
from service.tracking.filters.sigma_points import Linearised, SigmaPoints, cholesky, through_points
from service.tracking.filters.space import Space
from service.tracking.filters.weighted import correct_guarded, own, project, weigh_scan
from service.tracking.model import F64

OWN = 1  # first column of an adaptation in the memory; column 0 is the count of rejected frames


class Adaptation(Protocol):
    """What a filter learns about its noises; it keeps it in its columns of the memory, from zeros on."""

    @property
    def memory_size(self) -> int:
        """Columns in the memory of a filter, from `OWN` on."""
        ...

    def noise(self, Q: F64, memory: F64) -> F64:
        """Return the process noise (..., n, n) as known before the frame."""
        ...

    def before(self, prediction: Prediction, seen: Linearised, i: Innovations) -> tuple[F64, Innovations]:
        """Return the prior covariance (..., n, n) and the innovations with the R to use.

        The memory of the prediction is updated in place, where the frame says something about a track.
        """
        ...

    def after(self, prediction: Prediction, seen: Linearised, i: Innovations, state: FilterState) -> None:
        """Learn from the corrected tracks, into their memory in place."""
        ...


@dataclass(frozen=True, slots=True)
class NoAdaptation:
    """Noises are as configured."""

    memory_size: int = 0

    def noise(self, Q: F64, memory: F64) -> F64:  # noqa: ARG002 - the protocol
        """Return Q."""
        return Q

    def before(
        self,
        prediction: Prediction,
        seen: Linearised,  # noqa: ARG002 - the protocol
        i: Innovations,
    ) -> tuple[F64, Innovations]:
        """Return the predicted covariance and the innovations as they are."""
        return prediction.cov, i

    def after(self, prediction: Prediction, seen: Linearised, i: Innovations, state: FilterState) -> None:
        """Learn nothing."""


@dataclass(frozen=True, slots=True)
class Trusting:
    """A guard that takes every measurement as it is."""

    robust_gate: float | None = None
    gate_release_frames: int | None = None


@dataclass(frozen=True, slots=True)
class SpaceFilter:
    """A recursive filter over a bank of tracks in a `Space`; see `base.Filter` for what it does."""

    name: str
    space: Space
    points: SigmaPoints | None = field(default_factory=SigmaPoints)  # None: by the Jacobian
    adaptation: Adaptation = field(default_factory=NoAdaptation)
    guard: Guard = field(default_factory=Trusting)
    square_root: bool = False

    @property
    def memory_size(self) -> int:
        """Columns of the memory."""
        return OWN + self.adaptation.memory_size

    def start(self, mean: F64, cov: F64) -> FilterState:
        """Return new tracks from means (..., n) and covariances (..., n, n), with nothing remembered."""
        memory = np.zeros((*mean.shape[:-1], self.memory_size))
        return FilterState(mean.astype(np.float64), symmetric(cov), memory)

    def predict(self, state: FilterState, dt_s: float) -> Prediction:
        """Return the tracks moved `dt_s` seconds ahead."""
        step = self.space.motion(dt_s)
        mean, propagated = step.move(state.mean, state.cov)
        return Prediction(mean, propagated, self.adaptation.noise(step.Q, state.memory), state.memory)

    def expected(self, prediction: Prediction) -> Expected:
        """Return the expected measurement of each predicted track."""
        ours = own(prediction)
        seen = self.see(ours.mean, ours.cov)
        return Expected(seen.z_hat, seen.H, project(seen.H, ours.cov) + seen.omega)

    def update(self, prediction: Prediction, z: F64, R: F64, beta: F64, miss: F64) -> FilterState:
        """Return the tracks after the measurements of the frame."""
        ours = own(prediction)
        seen = self.see(ours.mean, ours.cov)
        return self.update_seen(ours, seen, weigh_scan(self.space.sensor, z, R, beta, miss, z_hat=seen.z_hat))

    def update_seen(self, ours: Prediction, seen: Linearised, i: Innovations) -> FilterState:
        """Return the tracks after innovations from a prediction made by `weighted.own`, as seen from it."""
        prior, i = self.adaptation.before(ours, seen, i)
        state = correct_guarded(ours, prior, seen, i, self.guard, square_root=self.square_root)
        self.adaptation.after(ours, seen, i, state)
        return state

    def see(self, mean: F64, cov: F64) -> Linearised:
        """Return the sensor as a linear function of states N(mean, cov)."""
        if self.points is not None:
            return through_points(mean, cholesky(cov), self.space.sensor, self.points)
        z_hat, H = self.space.sensor.linearise(mean)
        return Linearised(z_hat, H, np.zeros((*z_hat.shape, z_hat.shape[-1])))
