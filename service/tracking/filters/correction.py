"""Turn predicted tracks and their weighted measurements into corrected tracks: the moment-matched PDA update.

Each measurement j of a track has its own innovation e_j, covariance R_j and probability beta_j, so each has
its own gain K_j = P H' S_j^-1, S_j = H P H' + R_j. The posterior is the mixture of the single updates and
of the prediction; `correct` returns its exact mean and covariance. A channel that was not measured has zero
rows in e, R and S^-1, which equals leaving it out of z.

Source: Bar-Shalom, Daum, Huang 2009, "The probabilistic data association filter", with R_j in place of R.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.errors import InvalidInput
from service.tracking.filters.base import Prediction
from service.tracking.measurement import AZIMUTH, CHANNELS
from service.tracking.model import F64, Bool
from service.tracking.motion import STATES

BALANCE_TOLERANCE = 1e-6  # of sum beta + miss = 1; association in double precision keeps 1e-12


@dataclass(frozen=True, slots=True)
class Innovations:
    """The weighted innovations of T tracks, padded to J each; what was not measured is zero."""

    e: F64  # (T, J, 3)
    R: F64  # (T, J, 3, 3)
    measured: Bool  # (T, J, 3)
    beta: F64  # (T, J)
    miss: F64  # (T,)


@dataclass(frozen=True, slots=True)
class Solved:
    """Inverse innovation covariances and what follows from them."""

    R: F64  # (T, J, 3, 3) measurement covariances used, zero rows where not measured
    S_inv: F64  # (T, J, 3, 3) likewise
    y: F64  # (T, J, 3) S^-1 e
    nis: F64  # (T, J) e' S^-1 e


def symmetric(cov: F64) -> F64:
    """Return (C + C')/2 over the last two axes."""
    return (cov + cov.swapaxes(-1, -2)) * 0.5


def weigh(z: F64, R: F64, beta: F64, miss: F64, z_hat: F64) -> Innovations:
    """Return the innovations of measurements z (T, J, 3) about the expected z_hat (T, 3).

    Raises InvalidInput when the shapes do not fit or the probabilities of a track do not add up to one.
    """
    tracks, many = beta.shape
    wanted = (tracks, many, CHANNELS)
    if z.shape != wanted or R.shape != (*wanted, CHANNELS) or miss.shape != (tracks,):
        raise InvalidInput(
            f"want z {wanted}, R {(*wanted, CHANNELS)}, miss {(tracks,)}; "
            f"got z {z.shape}, R {R.shape}, miss {miss.shape}"
        )
    balance = beta.sum(axis=1) + miss
    if not np.all(np.abs(balance - 1.0) <= BALANCE_TOLERANCE):
        raise InvalidInput(f"sum of beta and miss must be 1 for each track, got {balance}")
    measured = np.isfinite(z) & (beta > 0.0)[..., None]
    e = np.where(measured, z, 0.0) - z_hat[:, None, :]
    e[..., AZIMUTH] = np.pi - np.remainder(np.pi - e[..., AZIMUTH], 2.0 * np.pi)
    e *= measured
    pairs = measured[..., :, None] & measured[..., None, :]
    return Innovations(e, np.where(pairs, R, 0.0), measured, beta, miss)


def solve(S_prior: F64, innovations: Innovations, factor: F64 | None = None) -> Solved:
    """Return the inverses of S_j = S_prior + factor_j R_j over the measured channels.

    S_prior: (T, 3, 3) H P H'.  factor: (T, J) or None for 1.
    """
    R = innovations.R if factor is None else innovations.R * factor[..., None, None]
    S_inv, _ = masked_inverse(S_prior[:, None] + R, innovations.measured)
    y = (S_inv @ innovations.e[..., None])[..., 0]
    return Solved(R, S_inv, y, np.sum(innovations.e * y, axis=-1))


def correct(
    prediction: Prediction, prior: F64, H: F64, innovations: Innovations, solved: Solved
) -> tuple[F64, F64]:
    """Return mean (T, 6) and covariance (T, 6, 6) of the mixture of the single updates.

    prior: (T, 6, 6) covariance from which `solved` was made; it differs from that of the prediction, which
    holds if no measurement belongs to the track, by the fading.

    With W = sum beta, w = beta/W, A = sum w_j S_j^-1 and y_j = S_j^-1 e_j:
    x = x + P H' d
    P = miss P_predicted + W [(I - P H' A H) P (I - P H' A H)' + P H' B H P] + P H' C H P
    d = sum beta_j y_j
    B = sum w_j [S_j^-1 R_j S_j^-1 + (S_j^-1 - A) H P H' (S_j^-1 - A)]
    C = sum beta_j y_j y_j' - d d'
    The bracket is the mean of the updated covariances in Joseph form, the last term the spread of the updated
    means. Every term is positive semidefinite as computed, so P stays positive definite.
    """
    beta = innovations.beta
    weight = beta.sum(axis=1)
    share = beta / np.where(weight > 0.0, weight, 1.0)[:, None]
    PHt = prior @ H.swapaxes(-1, -2)

    A = _mix(share, solved.S_inv)
    B = _mix(share, solved.S_inv @ solved.R @ solved.S_inv)
    if beta.shape[1] > 1:  # a single measurement is not apart from the mean
        apart = solved.S_inv - A[:, None]
        B += _mix(share, apart @ (H @ PHt)[:, None] @ apart)
    weighted = beta[..., None] * solved.y
    d = weighted.sum(axis=1)
    C = weighted.swapaxes(-1, -2) @ solved.y - d[:, :, None] * d[:, None, :]

    left = np.eye(STATES) - PHt @ A @ H
    W = weight[:, None, None]
    cov = innovations.miss[:, None, None] * prediction.cov + W * (left @ prior @ left.swapaxes(-1, -2))
    cov += PHt @ (W * B + C) @ PHt.swapaxes(-1, -2)
    return prediction.mean + (PHt @ d[..., None])[..., 0], symmetric(cov)


def _mix(share: F64, matrices: F64) -> F64:
    """Return sum_j share_j M_j (T, 3, 3)."""
    tracks, many = share.shape
    flat = matrices.reshape(tracks, many, CHANNELS * CHANNELS)
    return (share[:, None, :] @ flat).reshape(tracks, CHANNELS, CHANNELS)


def masked_inverse(S: F64, measured: Bool) -> tuple[F64, F64]:
    """Return inverse (..., 3, 3) and log determinant (...,) of the measured blocks of S; other rows are zero.

    Closed form on the correlation matrix, so that metres and radians meet as equals: with correlations a,
    b, c det = 1 + 2abc - a^2 - b^2 - c^2 and the inverse is the adjugate over it.
    """
    variance = np.where(measured, np.diagonal(S, axis1=-2, axis2=-1), 1.0)
    scale = measured / np.sqrt(variance)
    a = S[..., 0, 1] * scale[..., 0] * scale[..., 1]
    b = S[..., 0, 2] * scale[..., 0] * scale[..., 2]
    c = S[..., 1, 2] * scale[..., 1] * scale[..., 2]
    aa, bb, cc = a * a, b * b, c * c
    det = 1.0 + 2.0 * a * b * c - aa - bb - cc
    adjugate = np.empty(S.shape)
    adjugate[..., 0, 0], adjugate[..., 1, 1], adjugate[..., 2, 2] = 1.0 - cc, 1.0 - bb, 1.0 - aa
    adjugate[..., 0, 1] = adjugate[..., 1, 0] = b * c - a
    adjugate[..., 0, 2] = adjugate[..., 2, 0] = a * c - b
    adjugate[..., 1, 2] = adjugate[..., 2, 1] = a * b - c
    adjugate *= (scale / det[..., None])[..., :, None]
    adjugate *= scale[..., None, :]
    return adjugate, np.log(det) + np.log(variance).sum(axis=-1)
