"""What the strong tracking filters measure: how far the innovations of a track betray a manoeuvre.

A filter that explains its target has white innovations. Where they are not, the past is forgotten faster: F
P F' is multiplied by a fading factor lambda >= 1, chosen so that the innovation covariance explains what
was seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.filters.correction import Innovations
from service.tracking.filters.robust import LEAST_WEIGHT
from service.tracking.model import F64, Bool

GRID_POINTS = 10  # candidates b_n = 1 + u n of the softening factor; as many as the paper's window of pairs
FIT_DEGREE = 5  # of the polynomial through the scores of the candidates; paper, eq. 20


@dataclass(frozen=True, slots=True)
class Evidence:
    """The association-weighted innovation of each track; not measured where the frame says too little."""

    e: F64  # (T, 3), 0 where not measured
    R: F64  # (T, 3) variances, 1 where not measured
    measured: Bool  # (T, 3)


@dataclass(frozen=True, slots=True)
class Residuals:
    """The evidence of a frame beside what the filter expected, channel by channel (T, 3)."""

    e: F64  # as in Evidence
    R: F64
    used: F64  # 1 where measured, else 0
    m: F64  # diagonal of H F P F' H', the part that fading scales
    q: F64  # diagonal of H Q H'
    shorten: F64  # (T, 1) share of the squared innovation that enters the statistics


def evidence(innovations: Innovations) -> Evidence:
    """Return the innovation that each track saw, averaged over its measurements by their probabilities.

    The average is divided by the probability that there was one (e / (1 - miss)), channel by channel;
    channels with too little probability count as not measured.
    """
    beta = innovations.beta[..., None] * innovations.measured
    weight = beta.sum(axis=1)
    measured = weight > LEAST_WEIGHT
    share = np.where(measured, beta.sum(axis=1), 1.0)
    e = np.where(measured, (beta * innovations.e).sum(axis=1) / share, 0.0)
    variances = np.diagonal(innovations.R, axis1=-2, axis2=-1)
    R = np.where(measured, (beta * variances).sum(axis=1) / share, 1.0)
    return Evidence(e, R, measured)


def residuals(seen: Evidence, propagated: F64, noise: F64, H: F64, clip: float | None) -> Residuals:
    """Return the evidence beside the expected variances.

    propagated: (T, 6, 6) F P F'.  noise: Q.  clip: normalised square to which innovations are shortened,
    None: never.
    """
    m = diagonal_of_congruence(H, propagated)
    q = diagonal_of_congruence(H, noise)
    used = seen.measured.astype(np.float64)
    shorten: F64 = np.ones((len(m), 1))
    if clip is not None:
        nis = (used * seen.e * seen.e / (m + q + seen.R)).sum(axis=1, keepdims=True)
        shorten = clip / np.maximum(nis, clip)
    return Residuals(seen.e, seen.R, used, m, q, shorten)


def diagonal_of_congruence(H: F64, cov: F64) -> F64:
    """Return the diagonal (T, 3) of H C H'."""
    return np.asarray(((H @ cov) * H).sum(axis=-1))


def grid(step: float) -> F64:
    """Return the candidates b_n = 1 + u n of the softening factor."""
    return 1.0 + step * np.arange(GRID_POINTS, dtype=np.float64)


def softening(scores: F64, step: float, tolerance: float) -> F64:
    """Return the largest candidate whose smoothed score is within `tolerance` of the best (...,).

    scores: (..., GRID_POINTS) cumulative predictive error of each candidate; flat scores are no evidence,
    and the largest candidate fades least. The scores are smoothed by the least-squares polynomial of degree
    5 through them.
    """
    smooth = scores @ _SMOOTHER
    good = smooth <= smooth.min(axis=-1, keepdims=True) + tolerance
    last = GRID_POINTS - 1 - np.argmax(good[..., ::-1], axis=-1)
    return np.asarray(grid(step)[last], dtype=np.float64)


def _smoother() -> F64:
    """Return the symmetric matrix that maps ten scores to their quintic fit; all affine grids share it."""
    points = np.linspace(-1.0, 1.0, GRID_POINTS)
    basis = np.linalg.qr(np.vander(points, FIT_DEGREE + 1))[0]
    return np.asarray(basis @ basis.T)


_SMOOTHER = _smoother()
