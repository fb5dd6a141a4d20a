"""Estimate the noises of a filter while it runs: Sage and Husa's recursions, safe and as printed.

Source: Sensors 2020 (see `cubature`), eq. 20-28. As printed Q is the difference of two matrices plus a square
and indefinite in almost every step, and R (eq. 28) blows up as soon as Q does not cover a manoeuvre. The safe
form estimates what cannot become indefinite: a scale of R for each channel, from the ratio of the differenced
residual to its variance (the difference takes a slowly changing bias out), and a scale of Q for each axis.
The means of the noises (eq. 25, 26), which diverge, are left out of both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.filters.base import FilterState, Prediction
from service.tracking.filters.correction import Innovations, symmetric
from service.tracking.filters.isolation import inflate, isolate
from service.tracking.filters.parameters import SageHusaParameters
from service.tracking.filters.robust import REJECTED
from service.tracking.filters.sigma_points import Linearised
from service.tracking.filters.space import Space, scale_axes
from service.tracking.filters.space_filter import OWN
from service.tracking.filters.weighted import diagonal, project, summarise
from service.tracking.model import F64, Bool

SAFE, FADING, MEAN = "safe", "fading", "mean"
COUNT = OWN  # measurements so far; the other columns follow


@dataclass(frozen=True, slots=True)
class SafeEstimator:
    """Scales of R and Q; memory: count, by channel log of the scale and last residual, by axis log of it.

    d = (1 - b)/(1 - b^(k + v + 1)): the v virtual measurements keep the first from replacing all that is
    known.
    """

    parameters: SageHusaParameters
    space: Space

    @property
    def memory_size(self) -> int:
        """Columns: one, two for each channel, one for each axis and one for the frame's verdict."""
        return 2 + 2 * self.space.sensor.channels + len(self.space.axes)

    def noise(self, Q: F64, memory: F64) -> F64:
        """Return the scaled Q."""
        return scale_axes(Q, np.exp(memory[..., self._axes]), self.space)

    def noise_scale(self, state: FilterState) -> F64:
        """Return the estimated scale of R (..., m) of each track."""
        return np.exp(state.memory[..., self._scale])

    def before(self, prediction: Prediction, seen: Linearised, i: Innovations) -> tuple[F64, Innovations]:
        """Return the predicted covariance and the scaled R, and estimate the next scale.

        R <- (1 - d) R + d R min(0.5 (e - e_before)^2 / S, largest), which is positive and has its fixed point
        where the differenced residual has twice its expected variance.
        """
        p, memory, scan = self.parameters, prediction.memory, summarise(i)
        scale, last, count = np.exp(memory[..., self._scale]), memory[..., self._last], memory[..., COUNT]
        S = diagonal(project(seen.H, prediction.cov) + seen.omega) + scale * scan.R
        nis = (scan.e**2 / S).sum(axis=-1) / np.maximum(scan.used.sum(axis=-1), 1)
        learn = scan.any & (count >= p.warm_up) & (nis <= p.nis_max)
        d = self._weight(count)
        ratio = np.minimum(0.5 * (scan.e - last) ** 2 / S, p.ratio_max)
        grown = np.clip(scale * (1.0 - d + d * ratio), p.noise_min, p.noise_max)
        i = isolate(inflate(i, scale), project(seen.H, prediction.cov) + seen.omega, memory[..., REJECTED], p)
        memory[..., self._scale] = np.where(learn[..., None] & scan.used, np.log(grown), np.log(scale))
        memory[..., self._last] = np.where(scan.used, scan.e, last)
        memory[..., self._learn] = np.where(scan.any, learn, memory[..., self._learn])
        return symmetric(prediction.cov), i

    def after(self, prediction: Prediction, seen: Linearised, i: Innovations, state: FilterState) -> None:  # noqa: ARG002
        """Estimate the scale of Q of each axis from eq. 27, in the state that the noise drives first."""
        p, memory = self.parameters, state.memory
        heard = summarise(i).any
        learn = heard & (memory[..., self._learn] > 0.0)
        d = self._weight(memory[..., COUNT])
        first = [columns[-1] for columns in self.space.axes]
        moved = (state.mean - prediction.mean)[..., first]
        raw = moved**2 + (diagonal(state.cov) - diagonal(prediction.propagated))[..., first]
        scale = np.exp(memory[..., self._axes])
        known = diagonal(prediction.noise)[..., first] / scale
        share = np.clip(raw / np.where(known > 0.0, known, 1.0), -p.axis_max, p.axis_max)
        new = np.clip((1.0 - d) * scale + d * share, p.axis_min, p.axis_max)
        memory[..., self._axes] = np.where(learn[..., None], np.log(new), memory[..., self._axes])
        memory[..., COUNT] += heard

    def _weight(self, count: F64) -> F64:
        p = self.parameters
        return np.asarray((1.0 - p.forgetting) / (1.0 - p.forgetting ** (count + p.virtual + 1.0)))[..., None]

    @property
    def _scale(self) -> slice:
        return slice(OWN + 1, OWN + 1 + self.space.sensor.channels)

    @property
    def _last(self) -> slice:
        return slice(self._scale.stop, self._scale.stop + self.space.sensor.channels)

    @property
    def _axes(self) -> slice:
        return slice(self._last.stop, self._last.stop + len(self.space.axes))

    @property
    def _learn(self) -> int:
        return self.memory_size  # the last column: column 0 of the memory is not ours


@dataclass(frozen=True, slots=True)
class RawEstimator:
    """The estimators as printed, for constant Q, R and time step; for comparison only.

    "fading" is eq. 27, 28 with the weight d of eq. 24, "mean" eq. 22, 23 with 1/(k + 1). An estimate that is
    not positive definite is left out, without which the filter would stop; memory: count, R - R0, Q - Q0.
    """

    parameters: SageHusaParameters
    space: Space

    @property
    def memory_size(self) -> int:
        """Columns: count, verdicts, R and Q."""
        return 1 + self._m**2 + self._n**2

    def noise(self, Q: F64, memory: F64) -> F64:
        """Return the estimated Q."""
        return Q + memory[..., self._Q].reshape(*memory.shape[:-1], self._n, self._n)

    def before(self, prediction: Prediction, seen: Linearised, i: Innovations) -> tuple[F64, Innovations]:
        """Return the predicted covariance and the estimated R, and estimate the next one (eq. 23, 28)."""
        memory, scan = prediction.memory, summarise(i)
        change = memory[..., self._R].reshape(*memory.shape[:-1], self._m, self._m)
        seen_pair = i.measured[..., :, None] & i.measured[..., None, :]
        nominal = np.where(scan.any[..., None, None], i.R.max(axis=-3), np.eye(self._m))
        R = nominal + change
        without = project(seen.H, prediction.cov) + seen.omega
        raw = scan.e[..., :, None] * scan.e[..., None, :] - without
        d = self._weight(memory[..., COUNT])[..., None]
        kept = self._definite((1.0 - d) * R + d * raw, R, np.asarray(scan.used.all(axis=-1)))
        memory[..., self._R] = (kept - nominal).reshape(*memory.shape[:-1], self._m**2)
        i = Innovations(
            i.e, np.where(seen_pair, i.R + change[..., None, :, :], 0.0), i.measured, i.beta, i.miss
        )
        return symmetric(prediction.cov), i

    def after(self, prediction: Prediction, seen: Linearised, i: Innovations, state: FilterState) -> None:  # noqa: ARG002
        """Estimate Q (eq. 22, 27)."""
        memory, heard = state.memory, summarise(i).any
        moved = state.mean - prediction.mean
        raw = moved[..., :, None] * moved[..., None, :] + state.cov - prediction.propagated
        Q = np.broadcast_to(prediction.noise, raw.shape)
        change = memory[..., self._Q].reshape(raw.shape)
        d = self._weight(memory[..., COUNT])[..., None]
        kept = self._definite(symmetric((1.0 - d) * Q + d * raw), Q, heard)
        memory[..., self._Q] = (kept - Q + change).reshape(*memory.shape[:-1], self._n**2)
        memory[..., COUNT] += heard

    def _definite(self, new: F64, old: F64, which: Bool) -> F64:
        """Return the new matrix where wanted and positive definite, else the old one."""
        least = np.linalg.eigvalsh(new)[..., 0]
        return np.where((which & (least > 0.0))[..., None, None], new, old)

    def _weight(self, count: F64) -> F64:
        if self.parameters.form == MEAN:
            return np.asarray(1.0 / (count + 1.0))[..., None]
        b = self.parameters.forgetting
        return np.asarray((1.0 - b) / (1.0 - b ** (count + 1.0)))[..., None]

    @property
    def _m(self) -> int:
        return self.space.sensor.channels

    @property
    def _n(self) -> int:
        return 1 + max(max(columns) for columns in self.space.axes)

    @property
    def _R(self) -> slice:  # noqa: N802 - the textbook's name
        return slice(OWN + 1, OWN + 1 + self._m**2)

    @property
    def _Q(self) -> slice:  # noqa: N802 - the textbook's name
        return slice(self._R.stop, self._R.stop + self._n**2)
