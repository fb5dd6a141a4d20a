"""Unscented Kalman filter, and the strong tracking ones with one fading factor: UKF, ST-UKF, AST-UKF.

Source: Appl. Sci. 2025, 15, 3276 ("Vehicle Target Tracking Algorithm Based on Improved Strong Tracking
Unscented Kalman Filter"), eq. 14-24, with the noise Q inside the tests (eq. 18, 21 leave it out) and the
update in Joseph form. AST-UKF is that paper's reference 20, of which it gives the idea only: residuals that
exceed their variance weigh more in the one factor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.filters.base import FilterState, Prediction
from service.tracking.filters.correction import Innovations, symmetric
from service.tracking.filters.parameters import StUkfParameters, UkfParameters
from service.tracking.filters.sigma_points import Linearised, SigmaPoints
from service.tracking.filters.space import Space, road
from service.tracking.filters.space_filter import OWN, SpaceFilter
from service.tracking.filters.weighted import diagonal, project, summarise
from service.tracking.model import F64

COUNT, RESIDUAL = OWN, OWN + 1  # columns of the memory: measurements so far, variance of each residual


@dataclass(frozen=True, slots=True)
class OneFactor:
    """Strong tracking: F P F' times one factor, found from the residuals (eq. 22 and after)."""

    parameters: StUkfParameters
    channels: int
    adaptive: bool  # weigh the residuals by how far they exceed their variance (AST-UKF)

    @property
    def memory_size(self) -> int:
        """Columns: the count and the residual variances."""
        return 1 + self.channels

    def noise(self, Q: F64, memory: F64) -> F64:  # noqa: ARG002 - the protocol
        """Return Q."""
        return Q

    def before(self, prediction: Prediction, seen: Linearised, i: Innovations) -> tuple[F64, Innovations]:
        """Return lambda F P F' + Q.

        C = (rho C + e e')/(1 + rho);  lambda = clip(sum w_i N_ii / sum w_i M_ii, 1, largest);
        N = C - beta R - H Q H', M = H F P F' H' + Omega;  w_i = 1/R_ii, times C_ii/S_ii when adaptive. The
        weights by R are ours: the trace of the paper adds square metres and square radians.
        """
        p, memory, scan = self.parameters, prediction.memory, summarise(i)
        squared, before = scan.e**2, memory[..., RESIDUAL:].copy()
        first = (memory[..., COUNT] == 0.0)[..., None]
        C = np.where(first, squared, (p.forgetting * before + squared) / (1.0 + p.forgetting))
        m = diagonal(project(seen.H, prediction.propagated)) + diagonal(seen.omega)
        q = diagonal(project(seen.H, prediction.noise))
        weight = scan.used / scan.R
        if self.adaptive:
            weight = weight * C / (m + q + scan.R)
        excess = (weight * (C - p.softening * scan.R - q)).sum(axis=-1)
        spread = (weight * m).sum(axis=-1)
        memory[..., RESIDUAL:] = np.where(scan.used, C, before)
        memory[..., COUNT] += scan.any
        factor = np.clip(excess / np.where(spread > 0.0, spread, 1.0), 1.0, p.lambda_max)
        return symmetric(factor[..., None, None] * prediction.propagated + prediction.noise), i

    def after(self, prediction: Prediction, seen: Linearised, i: Innovations, state: FilterState) -> None:
        """Learn nothing more."""


def ukf(p: UkfParameters, space: Space | None = None) -> SpaceFilter:
    """Return the unscented Kalman filter in a space (None: the road)."""
    return SpaceFilter(
        "ukf",
        space or road(p.accel_std_mps2, p.accel_tau_s),
        points=SigmaPoints(p.spread),
        guard=p,
    )


def st_ukf(p: StUkfParameters, space: Space | None = None) -> SpaceFilter:
    """Return the strong tracking UKF in a space (None: the road)."""
    return _strong(p, space, adaptive=False)


def ast_ukf(p: StUkfParameters, space: Space | None = None) -> SpaceFilter:
    """Return the adaptive strong tracking UKF in a space (None: the road)."""
    return _strong(p, space, adaptive=True)


def _strong(p: StUkfParameters, space: Space | None, *, adaptive: bool) -> SpaceFilter:
    space = space or road(p.accel_std_mps2, p.accel_tau_s)
    return SpaceFilter(
        "ast-ukf" if adaptive else "st-ukf",
        space,
        points=SigmaPoints(p.spread),
        adaptation=OneFactor(p, space.sensor.channels, adaptive),
        guard=p,
    )
