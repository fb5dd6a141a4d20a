"""See a Gaussian through a nonlinear function by points: unscented and cubature transformations.

The points are x and x +- a sqrt(n) c_k, with c_k the columns of a root of P. What they say of z = h(x) is
kept in the form that every update needs: z = z_hat + H (x - mean) + v, v ~ N(0, Omega), the statistical
linearisation, with H = Pxz' P^-1 and Omega = Pzz - H P H' positive semidefinite as computed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from service.tracking.filters.space import Sensor
from service.tracking.model import F64

LEAST_EIGENVALUE = 1e-12  # of a covariance that rounding made indefinite, relative to its largest


@dataclass(frozen=True, slots=True)
class SigmaPoints:
    """How far the points reach and how the centre weighs; kappa = 0.

    The default has no negative weight. A spread of 0.001, usual in papers, gives the same to four digits, in
    double precision only. Cubature (`CUBATURE`) has no centre point.
    """

    spread: float = 1.0  # alpha
    kurtosis: float = 2.0  # beta; 2 is best for a Gaussian

    def offsets(self, root: F64) -> F64:
        """Return the offsets (..., n, n) of the points on one side, a row a point."""
        return np.asarray(self.spread * np.sqrt(root.shape[-1]) * root.swapaxes(-1, -2))


CUBATURE = SigmaPoints(1.0, 0.0)  # Sensors 2020, eq. 5-7: 2n points of equal weight


@dataclass(frozen=True, slots=True)
class Linearised:
    """A measurement as a linear function of the state with noise of its own."""

    z_hat: F64  # (..., m)
    H: F64  # (..., m, n)
    omega: F64  # (..., m, m), zero for a Jacobian


def cholesky(cov: F64) -> F64:
    """Return the lower root (..., n, n); a matrix that rounding made indefinite is lifted first."""
    try:
        return np.asarray(np.linalg.cholesky(cov))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh((cov + cov.swapaxes(-1, -2)) * 0.5)
        least = LEAST_EIGENVALUE * np.maximum(values[..., -1:], LEAST_EIGENVALUE)
        lifted = (vectors * np.maximum(values, least)[..., None, :]) @ vectors.swapaxes(-1, -2)
        bad = values[..., 0] < least[..., 0]  # the others keep their root to the bit
        return np.asarray(np.linalg.cholesky(np.where(bad[..., None, None], lifted, cov)))


def through_points(mean: F64, root: F64, sensor: Sensor, points: SigmaPoints) -> Linearised:
    """Return the statistical linearisation of the sensor for N(mean, root root').

    mean (..., n), root (..., n, n).  With odd and even parts o_k, v_k of h about the mean along column k: H =
    (sqrt(w) o)' root^-1, b = w sum v_k, z_hat = h(mean) + b, Omega = w sum v_k v_k' + (beta - alpha^2) b b',
    w = 1/(alpha^2 n). No weight is large, so nothing cancels (weights of eq. 15 reach -10^6).
    """
    n = mean.shape[-1]
    offsets = points.offsets(root)
    both = np.concatenate([mean[..., None, :] + offsets, mean[..., None, :] - offsets], axis=-2)
    centre = sensor.predict(mean)
    e = sensor.difference(sensor.predict(both), centre[..., None, :])
    odd, even = (e[..., :n, :] - e[..., n:, :]) * 0.5, (e[..., :n, :] + e[..., n:, :]) * 0.5
    weight = 1.0 / (points.spread**2 * n)
    shift = weight * even.sum(axis=-2)
    H = np.linalg.solve(root.swapaxes(-1, -2), np.sqrt(weight) * odd).swapaxes(-1, -2)
    rest = points.kurtosis - points.spread**2
    if rest < 0.0:  # cubature: the spread of the even parts about their own mean
        even, rest = even - shift[..., None, :], rest + 2.0 - 1.0 / points.spread**2
    omega = weight * even.swapaxes(-1, -2) @ even + rest * shift[..., :, None] * shift[..., None, :]
    z_hat = sensor.difference(centre + shift, np.zeros_like(centre))  # angles wrapped
    return Linearised(z_hat, H, omega)


@dataclass(frozen=True, slots=True)
class NonlinearStep:
    """x' = f(x) + w: the mean and covariance of f by sigma points."""

    function: Callable[[F64], F64]  # (..., n) -> (..., n)
    Q: F64
    points: SigmaPoints = CUBATURE

    def move(self, mean: F64, cov: F64) -> tuple[F64, F64]:
        """Return the mean and covariance of f(x), x ~ N(mean, cov)."""
        n, offsets = mean.shape[-1], self.points.offsets(cholesky(cov))
        both = np.concatenate([mean[..., None, :] + offsets, mean[..., None, :] - offsets], axis=-2)
        centre = self.function(mean)
        e = self.function(both) - centre[..., None, :]
        weight = 0.5 / (self.points.spread**2 * n)
        shift = weight * e.sum(axis=-2)
        rest = self.points.kurtosis - self.points.spread**2
        moved = weight * e.swapaxes(-1, -2) @ e + rest * shift[..., :, None] * shift[..., None, :]
        return centre + shift, (moved + moved.swapaxes(-1, -2)) * 0.5
