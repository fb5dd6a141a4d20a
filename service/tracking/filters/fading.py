"""What the strong tracking filters measure: how far the innovations of a track betray a manoeuvre.

A filter that explains its target has white innovations. Where they are not, the past is forgotten faster: F
P F' is multiplied by a fading factor lambda >= 1, chosen so that the innovation covariance explains what
was seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.filters.base import Prediction
from service.tracking.filters.correction import Innovations
from service.tracking.filters.fading_kernels import GRID_POINTS, compare
from service.tracking.filters.robust import LEAST_WEIGHT
from service.tracking.measurement import CHANNELS
from service.tracking.model import F64

FIT_DEGREE = 5  # of the polynomial through the scores of the candidates; paper, eq. 20


@dataclass(frozen=True, slots=True)
class Residuals:
    """The association-weighted innovation of each track beside what the filter expected (T, 3).

    It is averaged over the track's measurements by their probabilities, divided by the probability that
    there was one, channel by channel. Channels with too little probability count as not measured.
    """

    e: F64  # 0 where not measured
    R: F64  # variances, 1 where not measured
    used: F64  # 1 where measured, else 0
    m: F64  # diagonal of H F P F' H', the part that fading scales
    q: F64  # diagonal of H Q H'
    shorten: F64  # (T,) share of the squared innovation that enters the statistics


def residuals(innovations: Innovations, prediction: Prediction, H: F64, clip: float | None) -> Residuals:
    """Return what a frame says about each track of a prediction made by `own_prediction`.

    clip: normalised square to which innovations are shortened, None: never.
    """
    i, tracks = innovations, len(innovations.beta)
    seen, shorten = np.empty((5, tracks, CHANNELS)), np.empty(tracks)
    compare(
        i.e, i.R, i.measured, i.beta, prediction.propagated, prediction.noise, H, LEAST_WEIGHT,
        math.inf if clip is None else float(clip), seen, shorten,
    )  # fmt: skip
    e, R, used, m, q = seen
    return Residuals(e, R, used, m, q, shorten)


def _smoother() -> F64:
    """Return the symmetric matrix that maps ten scores to their quintic fit; all affine grids share it.

    Scores of the candidates are cumulative predictive errors, and noisy: the least-squares polynomial
    through them is compared. Flat scores are no evidence, and the largest candidate fades least.
    """
    points = np.linspace(-1.0, 1.0, GRID_POINTS)
    basis = np.linalg.qr(np.vander(points, FIT_DEGREE + 1))[0]
    return np.array(basis @ basis.T, order="C")


SMOOTHER = _smoother()
