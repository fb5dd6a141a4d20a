"""MAST-UKF: one factor on Q for each axis and one on R for each channel, in a safe form and as printed.

Source: Appl. Sci. 2025, 15, 3276, eq. 2-13. The paper multiplies Q by D (0.95 to 1.05 an axis) and R by J,
both from one comparison of residual variance and expected variance, so every excess of a manoeuvre counts as
measurement noise and the gain falls just then. The safe form keeps D and J and decides who is to blame by the
whiteness of the residuals: successive ones that agree mean a manoeuvre (D grows), alternating ones a Q that
is too large (D shrinks), large white ones an R that is too small (J grows), a single large one an outlier.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.errors import InvalidInput
from service.tracking.filters.base import FilterState, Prediction
from service.tracking.filters.correction import Innovations, symmetric
from service.tracking.filters.isolation import inflate, isolate
from service.tracking.filters.parameters import MastUkfParameters
from service.tracking.filters.robust import REJECTED
from service.tracking.filters.sigma_points import Linearised, SigmaPoints
from service.tracking.filters.space import Space, road, scale_axes
from service.tracking.filters.space_filter import OWN, Adaptation, SpaceFilter
from service.tracking.filters.weighted import diagonal, project, summarise
from service.tracking.model import F64

SAFE, PAPER, PRINTED = "safe", "paper", "printed"


def mast_ukf(p: MastUkfParameters, space: Space | None = None) -> SpaceFilter:
    """Return the MAST-UKF in a space (None: the road); raises InvalidInput for an unknown form."""
    if p.form not in {SAFE, PAPER, PRINTED}:
        raise InvalidInput.at("/filters/mast_ukf/form", f"want {SAFE}, {PAPER} or {PRINTED}, got {p.form!r}")
    space = space or road(p.accel_std_mps2, p.accel_tau_s)
    adaptation: Adaptation = Whiteness(p, space) if p.form == SAFE else Comparison(p, space)
    return SpaceFilter("mast-ukf", space, points=SigmaPoints(p.spread), adaptation=adaptation)


@dataclass(frozen=True, slots=True)
class Whiteness:
    """The safe form; its memory: per axis log D, last residual, running product; per channel log J."""

    parameters: MastUkfParameters
    space: Space

    @property
    def memory_size(self) -> int:
        """Columns: three for each axis, one for each channel."""
        return 3 * len(self.space.axes) + self.space.sensor.channels

    def noise(self, Q: F64, memory: F64) -> F64:
        """Return D^1/2 Q D^1/2 as learnt so far."""
        return scale_axes(Q, np.exp(memory[..., OWN : OWN + len(self.space.axes)]), self.space)

    def before(self, prediction: Prediction, seen: Linearised, i: Innovations) -> tuple[F64, Innovations]:
        """Return the covariance with D of this frame, doubled along an axis that manoeuvres, and R with J."""
        p, memory, scan, axes = self.parameters, prediction.memory, summarise(i), len(self.space.axes)
        log_d, last, product, log_j = np.split(memory[..., OWN:].copy(), [axes, 2 * axes, 3 * axes], axis=-1)
        noise = np.exp(log_j) * scan.R
        S = project(seen.H, prediction.cov) + seen.omega + noise[..., :, None] * np.eye(noise.shape[-1])
        along, spread = self.space.sensor.to_axes(scan.e, S, seen.z_hat)
        now = np.clip(along / np.sqrt(diagonal(spread)), -p.residual_max, p.residual_max)
        known = np.asarray(scan.used[..., :axes].all(axis=-1))[..., None]  # both coordinates of the position
        agreement = np.clip(now * last, -1.0, 1.0)
        step = np.where(known, p.axis_gain * agreement, 0.0)
        new_d = np.clip(log_d + step, -math.log(p.axis_max), math.log(p.axis_max))
        turn = known & (now * last > 0.0) & (np.minimum(np.abs(now), np.abs(last)) > p.manoeuvre_residual)
        product = np.where(known, (1.0 - p.product_gain) * product + p.product_gain * now * last, product)
        white = (np.abs(product).max(axis=-1) < p.white_product)[..., None]
        squared = np.minimum(scan.e**2 / diagonal(S), p.noise_cap)
        grown = np.clip(log_j + p.noise_gain * (squared - p.noise_mean), 0.0, math.log(p.noise_max))
        log_j = np.where(scan.used & white, grown, log_j)
        last = np.where(known, now, last)
        memory[..., OWN:] = np.concatenate([new_d, last, product, log_j], axis=-1)
        rescaled = scale_axes(prediction.noise, np.exp(new_d - log_d), self.space)
        fade = np.where(turn, p.manoeuvre_fading, 1.0)
        prior = symmetric(scale_axes(prediction.propagated + rescaled, fade, self.space))
        i = inflate(i, np.exp(log_j))
        return prior, isolate(i, project(seen.H, prior) + seen.omega, memory[..., REJECTED], p)

    def after(self, prediction: Prediction, seen: Linearised, i: Innovations, state: FilterState) -> None:
        """Learn nothing more."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """The paper's form: D and J by comparing the residual covariance C with its expectation S.

    "paper" is faithful where it can be: tests with Q inside, in Cartesian axes, D accumulated and clamped, J
    clamped. "printed" is without all that, and diverges. Memory: count, C, log D, and the last `window`
    outcomes of C_ii > S_ii for each axis.
    """

    parameters: MastUkfParameters
    space: Space

    @property
    def memory_size(self) -> int:
        """Columns: 1 + m^2 + A + A times the window."""
        axes = len(self.space.axes)
        return 1 + self.space.sensor.channels**2 + axes * (1 + self.parameters.window)

    def noise(self, Q: F64, memory: F64) -> F64:
        """Return D^1/2 Q D^1/2 as learnt so far."""
        at = OWN + 1 + self.space.sensor.channels**2
        return scale_axes(Q, np.exp(memory[..., at : at + len(self.space.axes)]), self.space)

    def before(self, prediction: Prediction, seen: Linearised, i: Innovations) -> tuple[F64, Innovations]:
        """Return the predicted covariance and R with J (eq. 9, 10), and find the next D (eq. 6-8)."""
        p, memory, scan = self.parameters, prediction.memory, summarise(i)
        m, axes = self.space.sensor.channels, len(self.space.axes)
        heard = scan.any
        count, C, log_d, flags = np.split(memory[..., OWN:].copy(), [1, 1 + m * m, 1 + m * m + axes], axis=-1)
        outer = scan.e[..., :, None] * scan.e[..., None, :]
        C = C.reshape(outer.shape)
        mixed = (p.forgetting * C + outer) / (1.0 + p.forgetting)
        C = np.where((count == 0.0)[..., None], outer, mixed)
        expected = project(seen.H, prediction.cov) + seen.omega
        tested = project(seen.H, prediction.propagated) + seen.omega if p.form == PRINTED else expected
        S = tested + scan.R[..., :, None] * np.eye(m)
        exceeds = diagonal(C) > diagonal(S)
        J = np.where(exceeds, np.maximum(diagonal(C - expected) / scan.R, 1.0), 1.0)
        if p.form == PAPER:
            J = np.minimum(J, p.noise_max)
        flags, share = self._window(flags, C, S, seen.z_hat, count)
        new_d = self._axis_factors(log_d, share, tested, S, seen.z_hat, count)
        new = np.concatenate([count + 1.0, C.reshape(*C.shape[:-2], m * m), new_d, flags], axis=-1)
        memory[..., OWN:] = np.where(heard[..., None], new, memory[..., OWN:])
        return prediction.cov, inflate(i, np.where(scan.used, J, 1.0))

    def after(self, prediction: Prediction, seen: Linearised, i: Innovations, state: FilterState) -> None:
        """Learn nothing more."""

    def _window(self, flags: F64, C: F64, S: F64, z_hat: F64, count: F64) -> tuple[F64, F64]:
        """Return the outcomes with this one written over the oldest, and their share (..., A)."""
        p, zero = self.parameters, np.zeros_like(z_hat)
        actual, expected = (diagonal(self.space.sensor.to_axes(zero, X, z_hat)[1]) for X in (C, S))
        place = np.arange(p.window) == (count % p.window)
        rings = flags.reshape(*flags.shape[:-1], len(self.space.axes), p.window)
        rings = np.where(place[..., None, :], (actual > expected)[..., None], rings)
        return rings.reshape(flags.shape), rings.mean(axis=-1)

    def _axis_factors(self, log_d: F64, share: F64, tested: F64, S: F64, z_hat: F64, count: F64) -> F64:  # noqa: PLR0913, PLR0917
        """Return log D: eq. 7 with the ratio of eq. 8, which as printed exceeds 1 and gives the maximum."""
        p, zero = self.parameters, np.zeros_like(z_hat)
        state, total = (diagonal(self.space.sensor.to_axes(zero, X, z_hat)[1]) for X in (tested, S))
        ratio = np.minimum(state / total if p.form == PAPER else total / np.maximum(state, 1e-300), 1.0)
        rare = share < 0.5  # noqa: PLR2004 - the paper's 50 %
        low, high = np.where(rare, 0.95, 1.0), np.where(rare, 1.0, 1.05)
        step = np.log(low + (high - low) * ratio)
        due = (count + 1.0 >= p.window) & ((count + 1.0) % p.every == 0.0)
        if p.form == PRINTED:  # D holds for the next frame only
            return np.where(due, step, 0.0)
        limit = math.log(p.axis_max)
        return np.where(due, np.clip(log_d + step, -limit, limit), log_d)
