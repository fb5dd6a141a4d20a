"""The moment-matched PDA update of `correction`, for states and measurements of any size.

The filters of a `Space` use it; `correction` is the same update compiled for the six states and three
channels of the road. Beside the covariance it can return a square root, by QR of the factors of its terms,
none of which is ever subtracted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.errors import InvalidInput
from service.tracking.filters.base import FilterState, Prediction
from service.tracking.filters.correction import BALANCE_TOLERANCE, Innovations, Rejection, owned, symmetric
from service.tracking.filters.robust import LEAST_WEIGHT, REJECTED, Guard
from service.tracking.filters.sigma_points import Linearised, cholesky
from service.tracking.filters.space import Sensor
from service.tracking.model import F64, Bool

NEVER = np.inf


@dataclass(frozen=True, slots=True)
class Summary:
    """The association-weighted innovation of each track, channel by channel (..., m)."""

    e: F64  # 0 where not measured
    R: F64  # variances, 1 where not measured
    used: Bool  # measured with a probability that says something

    @property
    def any(self) -> Bool:
        """Return which tracks (...) have a channel that was used."""
        return np.asarray(self.used.any(axis=-1))


def own(prediction: Prediction) -> Prediction:
    """Return a copy in C order, Q with the dimensions of the covariance."""
    noise = owned(prediction.noise)
    lead = (1,) * (prediction.propagated.ndim - noise.ndim)
    return Prediction(
        owned(prediction.mean),
        owned(prediction.propagated),
        noise.reshape(*lead, *noise.shape),
        owned(prediction.memory),
    )


def weigh_scan(  # noqa: PLR0913 - the arguments of an update
    sensor: Sensor, z: F64, R: F64, beta: F64, miss: F64, *, z_hat: F64
) -> Innovations:
    """Return the innovations of measurements z (..., J, m) about z_hat (..., m).

    Raises InvalidInput when the shapes do not fit or the probabilities of a track do not add up to one.
    """
    wanted = (*z_hat.shape[:-1], beta.shape[-1], sensor.channels)
    fit = z.shape == wanted and R.shape == (*wanted, sensor.channels) and miss.shape == z_hat.shape[:-1]
    if not fit or beta.shape != wanted[:-1]:
        raise InvalidInput(
            f"want z {wanted}, R {(*wanted, sensor.channels)}, beta {wanted[:-1]}, miss {wanted[:-2]}; "
            f"got z {z.shape}, R {R.shape}, beta {beta.shape}, miss {miss.shape}"
        )
    z, R, beta, miss = owned(z), owned(R), owned(beta), owned(miss)
    total = miss + beta.sum(axis=-1)
    if not np.all(np.abs(total - 1.0) <= BALANCE_TOLERANCE):
        raise InvalidInput(f"sum of beta and miss must be 1 for each track, got {total.ravel().tolist()[:8]}")
    measured = np.isfinite(z) & (beta > 0.0)[..., None]
    R = np.where(measured[..., :, None] & measured[..., None, :], R, 0.0)
    return Innovations(differences(sensor, z, measured, z_hat), R, measured, beta, miss)


def differences(sensor: Sensor, z: F64, measured: Bool, z_hat: F64) -> F64:
    """Return z (..., J, m) less z_hat (..., m), zero where nothing was measured."""
    e = sensor.difference(np.where(measured, z, z_hat[..., None, :]), z_hat[..., None, :])
    return np.where(measured, e, 0.0)


def summarise(i: Innovations) -> Summary:
    """Return what the measurements of each track say together."""
    share = i.beta[..., None] * i.measured
    weight = share.sum(axis=-2)
    used = weight > LEAST_WEIGHT
    safe = np.where(used, weight, 1.0)
    variance = np.diagonal(i.R, axis1=-2, axis2=-1)
    return Summary(
        np.where(used, (share * i.e).sum(axis=-2) / safe, 0.0),
        np.where(used, (share * variance).sum(axis=-2) / safe, 1.0),
        used,
    )


def diagonal(matrix: F64) -> F64:
    """Return a copy of the diagonal (..., n) of (..., n, n)."""
    return np.diagonal(matrix, axis1=-2, axis2=-1).copy()


def project(H: F64, cov: F64) -> F64:
    """Return H P H' (..., m, m), symmetric."""
    return symmetric(H @ cov @ H.swapaxes(-1, -2))


def with_noise(i: Innovations, omega: F64) -> Innovations:
    """Return the innovations with the noise of the linearisation (..., m, m) added to each R."""
    if not omega.any():
        return i
    seen = i.measured[..., :, None] & i.measured[..., None, :]
    return Innovations(i.e, i.R + np.where(seen, omega[..., None, :, :], 0.0), i.measured, i.beta, i.miss)


def correct(  # noqa: PLR0913 - the parts of one formula
    prediction: Prediction,
    prior: F64,
    H: F64,
    i: Innovations,
    rejection: Rejection,
    *,
    square_root: bool = False,
) -> tuple[F64, F64, F64]:
    """Return mean (..., n), covariance (..., n, n) and count (...); formulas as in `correction.correct`.

    square_root: take the covariance as L L', L by QR of [sqrt(miss) L_predicted, sqrt(W) (I - K H) L_prior,
    P H' sqrt(B + C)] (Sensors 2020, eq. 19, for a weighted update).
    """
    S0 = project(H, prior)
    inverse, growth, y, count = _invert(S0, i, rejection)
    weight = i.beta.sum(axis=-1)
    share = i.beta / np.where(weight > 0.0, weight, 1.0)[..., None]
    A = (share[..., None, None] * inverse).sum(axis=-3)
    d = (i.beta[..., None] * y).sum(axis=-2)
    scaled = (i.beta * growth)[..., None, None] * (inverse @ i.R @ inverse)
    if i.beta.shape[-1] > 1:  # one measurement has the mean gain
        off = inverse - A[..., None, :, :]
        scaled = scaled + i.beta[..., None, None] * (off @ S0[..., None, :, :] @ off)
    spread = i.beta[..., None, None] * y[..., :, None] * y[..., None, :]
    M = symmetric((scaled + spread).sum(axis=-3) - d[..., :, None] * d[..., None, :])
    PHt = prior @ H.swapaxes(-1, -2)
    mean = prediction.mean + (PHt @ d[..., None])[..., 0]
    left = np.eye(prior.shape[-1]) - PHt @ A @ H
    predicted = symmetric(prediction.cov)  # Q of a long step is symmetric but for rounding
    if square_root:
        cov = _by_qr(predicted, prior, left, PHt, M, i.miss, weight)
    else:
        cov = i.miss[..., None, None] * predicted
        cov = cov + weight[..., None, None] * (left @ prior @ left.swapaxes(-1, -2))
        cov = symmetric(cov + PHt @ M @ PHt.swapaxes(-1, -2))
    seen = weight > 0.0
    mean = np.where(seen[..., None], mean, prediction.mean)
    return mean, np.where(seen[..., None, None], cov, predicted), count


def correct_guarded(  # noqa: PLR0913 - as above
    prediction: Prediction,
    prior: F64,
    seen: Linearised,
    i: Innovations,
    guard: Guard,
    *,
    square_root: bool = False,
) -> FilterState:
    """Return the corrected tracks; the count of rejected frames goes into the memory of the prediction."""
    count, memory = prediction.memory[..., REJECTED], prediction.memory
    gate, release = guard.robust_gate, guard.gate_release_frames
    rejection = Rejection(
        count,
        NEVER if gate is None else float(gate),
        NEVER if release is None else float(release),
        LEAST_WEIGHT,
    )
    mean, cov, new = correct(
        prediction, prior, seen.H, with_noise(i, seen.omega), rejection, square_root=square_root
    )
    if gate is not None:
        memory[..., REJECTED] = new
    return FilterState(mean, cov, memory)


def _invert(S0: F64, i: Innovations, rejection: Rejection) -> tuple[F64, F64, F64, F64]:
    """Return S^-1 (..., J, m, m), the growth of each R (..., J), S^-1 e (..., J, m), the new count (...)."""
    pair = i.measured[..., :, None] & i.measured[..., None, :]
    inverse = _masked_inverse(S0[..., None, :, :] + i.R, pair)
    y = (inverse @ i.e[..., None])[..., 0]
    nis = (i.e * y).sum(axis=-1)
    outside = (nis > rejection.gate) & (i.beta > 0.0)
    released = np.asarray(rejection.count >= rejection.release)
    grown = outside & ~released[..., None]
    growth = np.where(grown, nis / rejection.gate, 1.0) ** 2
    if grown.any():
        again = _masked_inverse(S0[..., None, :, :] + growth[..., None, None] * i.R, pair)
        inverse = np.where(grown[..., None, None], again, inverse)
        y = (inverse @ i.e[..., None])[..., 0]
    weight, refused = i.beta.sum(axis=-1), (i.beta * outside).sum(axis=-1)
    counted = np.where(refused > weight / 2.0, rejection.count + 1.0, 0.0)
    return inverse, growth, y, np.where(weight > rejection.least_weight, counted, rejection.count)


def _masked_inverse(S: F64, pair: Bool) -> F64:
    """Return the inverse of the measured block, zero elsewhere."""
    inverse = np.linalg.inv(np.where(pair, S, np.eye(S.shape[-1])))
    return np.where(pair, symmetric(inverse), 0.0)


def _by_qr(  # noqa: PLR0913, PLR0917 - the factors of one sum
    predicted: F64, prior: F64, left: F64, PHt: F64, M: F64, miss: F64, weight: F64
) -> F64:
    parts = [
        np.sqrt(weight)[..., None, None] * (left @ cholesky(prior)),
        PHt @ semidefinite_root(M),
    ]
    if (miss > 0.0).any():
        parts.append(np.sqrt(miss)[..., None, None] * cholesky(predicted))
    return gram(np.concatenate(parts, axis=-1))


def gram(factor: F64) -> F64:
    """Return A A' (..., n, n) of a wide factor (..., n, k) through its triangular root, Tri(A) of eq. 11."""
    root: F64 = np.asarray(np.linalg.qr(factor.swapaxes(-1, -2), mode="r"))
    return symmetric(root.swapaxes(-1, -2) @ root)


def semidefinite_root(M: F64) -> F64:
    """Return a root (..., m, m) of a positive semidefinite matrix, by eigenvalues."""
    values, vectors = np.linalg.eigh(M)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :])
