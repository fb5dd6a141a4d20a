"""Turn predicted tracks and their weighted measurements into corrected tracks: the moment-matched PDA update.

Each measurement j of a track has its own innovation e_j, covariance R_j and probability beta_j, so each has
its own gain K_j = P H' S_j^-1, S_j = H P H' + R_j. The posterior is the mixture of the single updates and
of the prediction; `correct` returns its exact mean and covariance. A channel that was not measured has zero
rows in e, R and S^-1, which equals leaving it out of z.

Source: Bar-Shalom, Daum, Huang 2009, "The probabilistic data association filter", with R_j in place of R.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.errors import InvalidInput
from service.tracking.filters.base import Prediction
from service.tracking.filters.correction_kernels import BALANCED, correct_bank, weigh_pairs
from service.tracking.kernel import ready
from service.tracking.measurement import CHANNELS
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
class Rejection:
    """When the covariance R_j of a measurement grows by (NIS_j / gate)^2; by default never. See `robust`."""

    count: F64  # (T,) rejected frames in a row
    gate: float = math.inf  # NIS above which a measurement is rejected
    release: float = math.inf  # count from which R stays as it is
    least_weight: float = 0.0  # sum of beta from which a frame counts


def symmetric(cov: F64) -> F64:
    """Return (C + C')/2 over the last two axes."""
    return (cov + cov.swapaxes(-1, -2)) * 0.5


def owned(array: F64) -> F64:
    """Return a copy for the kernels, which compile anew for other types, read-only and strided arrays."""
    return np.array(array, np.float64, order="C")


def own_prediction(prediction: Prediction) -> Prediction:
    """Return a prediction for the kernels, with Q (T, 6, 6) or (1, 6, 6), and a memory to write in."""
    return Prediction(
        ready(prediction.mean),
        ready(prediction.propagated),
        ready(prediction.noise).reshape(-1, STATES, STATES),
        owned(prediction.memory),
    )


def weigh(z: F64, R: F64, beta: F64, miss: F64, z_hat: F64) -> Innovations:
    """Return the innovations of measurements z (T, J, 3) about the expected z_hat (T, 3).

    Raises InvalidInput when the shapes do not fit or the probabilities of a track do not add up to one.
    """
    tracks, many = beta.shape
    wanted = (tracks, many, CHANNELS)
    if z.shape != wanted or R.shape != (*wanted, CHANNELS) or miss.shape != (tracks,) or len(z_hat) != tracks:
        raise InvalidInput(
            f"want z {wanted}, R {(*wanted, CHANNELS)}, miss {(tracks,)}, z_hat {(tracks, CHANNELS)}; "
            f"got z {z.shape}, R {R.shape}, miss {miss.shape}, z_hat {z_hat.shape}"
        )
    beta, miss = ready(beta), ready(miss)
    e, own_R, measured = np.zeros(wanted), np.zeros((*wanted, CHANNELS)), np.zeros(wanted, np.bool_)
    unbalanced = weigh_pairs(ready(z), ready(R), beta, miss, z_hat, BALANCE_TOLERANCE, e, own_R, measured)
    if unbalanced != BALANCED:
        raise InvalidInput(
            f"sum of beta and miss must be 1 for each track, "
            f"got {beta[unbalanced].sum() + miss[unbalanced]} for track {unbalanced}"
        )
    return Innovations(e, own_R, measured, beta, miss)


def correct(
    prediction: Prediction, prior: F64, H: F64, innovations: Innovations, rejection: Rejection
) -> tuple[F64, F64, F64]:
    """Return mean (T, 6) and covariance (T, 6, 6) of the mixture of single updates, and the new count (T,).

    prior: (T, 6, 6) covariance for the update; it differs from that of the prediction, which holds if no
    measurement belongs to the track, by the fading.

    With W = sum beta, w = beta/W, A = sum w_j S_j^-1 and y_j = S_j^-1 e_j:
    x = x + P H' d
    P = miss P_predicted + W [(I - P H' A H) P (I - P H' A H)' + P H' B H P] + P H' C H P
    d = sum beta_j y_j
    B = sum w_j [S_j^-1 R_j S_j^-1 + (S_j^-1 - A) H P H' (S_j^-1 - A)]
    C = sum beta_j y_j y_j' - d d'
    The bracket is the mean of the updated covariances in Joseph form, the last term the spread of the updated
    means. Every term is positive semidefinite; where rounding is larger than what is left of a variance,
    some of the prediction is mixed in, so that P stays positive definite (`keep_definite`).
    """
    i, r = innovations, rejection
    mean, cov, count = np.empty_like(prediction.mean), np.empty_like(prior), np.empty_like(r.count)
    room = np.empty((i.beta.shape[1], CHANNELS, CHANNELS))
    correct_bank(
        prediction.mean, prediction.cov, prior, H, i.e, i.R, i.measured, i.beta, i.miss,
        r.count, r.gate, r.release, r.least_weight, room, mean, cov, count,
    )  # fmt: skip
    return mean, cov, count
