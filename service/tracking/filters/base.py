"""What every filter of a bank of tracks is: values in, values out, the leading dimension is the track.

A bank of tracks is a batch, a Monte Carlo study is a batch; T below is the size of either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from service.tracking.model import F64, I64, Bool


@dataclass(frozen=True, slots=True)
class FilterState:
    """The estimates of T tracks after a frame; state order [x vx ax y vy ay]."""

    mean: F64  # (T, 6)
    cov: F64  # (T, 6, 6)
    memory: F64  # (T, memory_size of the filter), what the filter remembers beside the estimate

    def __len__(self) -> int:
        return len(self.mean)

    def take(self, which: I64 | Bool) -> FilterState:
        """Return the chosen tracks, by index or mask."""
        return FilterState(self.mean[which], self.cov[which], self.memory[which])


def join(states: Sequence[FilterState]) -> FilterState:
    """Return one bank of the tracks of several, in order; at least one bank, all of one filter."""
    return FilterState(
        np.concatenate([s.mean for s in states]),
        np.concatenate([s.cov for s in states]),
        np.concatenate([s.memory for s in states]),
    )


@dataclass(frozen=True, slots=True)
class Prediction:
    """T tracks moved to the time of a frame, before its measurements are known."""

    mean: F64  # (T, 6)
    propagated: F64  # (T, 6, 6) F P F'
    noise: F64  # (6, 6) or (T, 6, 6) Q
    memory: F64  # (T, memory_size)

    @property
    def cov(self) -> F64:
        """The predicted covariance F P F' + Q (T, 6, 6)."""
        return self.propagated + self.noise

    def take(self, which: I64 | Bool) -> Prediction:
        """Return the chosen tracks, by index or mask."""
        noise = self.noise if self.noise.ndim == 2 else self.noise[which]  # noqa: PLR2004 - one Q for all
        return Prediction(self.mean[which], self.propagated[which], noise, self.memory[which])


@dataclass(frozen=True, slots=True)
class Expected:
    """Where the measurement of each predicted track is expected, for gating and association."""

    z_hat: F64  # (T, 3) range, azimuth, range rate
    H: F64  # (T, 3, 6)
    S_prior: F64  # (T, 3, 3) H (F P F' + Q) H'; add a measurement's own R to get its gate


class Filter(Protocol):
    """One recursive filter, applied to a bank of tracks at once."""

    @property
    def name(self) -> str:
        """The name in the registry."""
        ...

    @property
    def memory_size(self) -> int:
        """Columns of `FilterState.memory`."""
        ...

    def start(self, mean: F64, cov: F64) -> FilterState:
        """Return new tracks from initial means (T, 6) and covariances (T, 6, 6)."""
        ...

    def predict(self, state: FilterState, dt_s: float) -> Prediction:
        """Return the tracks moved `dt_s` seconds ahead."""
        ...

    def expected(self, prediction: Prediction) -> Expected:
        """Return the expected measurement of each predicted track."""
        ...

    def update(self, prediction: Prediction, z: F64, R: F64, beta: F64, miss: F64) -> FilterState:
        """Return the tracks after the measurements of the frame.

        z: (T, J, 3) measurements, each pair of track and measurement its own; a NaN channel was not measured.
        R: (T, J, 3, 3) their covariances.  beta: (T, J) association probabilities, 0 for padding (whose z
        and R may hold anything).  miss: (T,) probability that none belongs to the track; sum beta + miss =
        1. An ordinary update is J = 1, beta 1, miss 0; miss 1 leaves the prediction.
        """
        ...
