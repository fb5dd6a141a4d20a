"""Bound the influence of single wrong channels, without ever locking a track out.

A measurement channel far outside its variance is given so much more noise that it is no farther out than the
limit: it still pulls the track, by a bounded amount. After some such frames in a row the track is wrong, not
the radar, and the next is taken as it is.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from service.tracking.filters.correction import Innovations
from service.tracking.filters.robust import LEAST_WEIGHT
from service.tracking.filters.weighted import diagonal
from service.tracking.model import F64


class Limit(Protocol):
    """The part of a filter's parameters that says what an outlier is."""

    @property
    def outlier_limit(self) -> float:
        """Normalised square of a channel's innovation from which its R grows."""
        ...

    @property
    def gate_release_frames(self) -> int | None:
        """Frames in a row with an outlier after which R stays as it is, None for never."""
        ...


def inflate(i: Innovations, factor: F64) -> Innovations:
    """Return the innovations with R scaled to J^1/2 R J^1/2, J (..., m) by channel."""
    root = np.sqrt(factor)[..., None, :]
    return Innovations(i.e, (root[..., :, None] * root[..., None, :]) * i.R, i.measured, i.beta, i.miss)


def isolate(i: Innovations, S: F64, count: F64, limit: Limit) -> Innovations:
    """Return the innovations with larger R_ii where a channel is an outlier, and update the count in place.

    S: (..., m, m) H P H' + Omega.  count: (...) frames in a row with an outlier; a frame has one when more
    than half of its association weight lies on measurements with one. For t_i = e_i^2 / (S_ii + R_ii) above
    the limit R_ii grows by (t_i/limit - 1)(S_ii + R_ii), which makes t_i equal to it.
    """
    total = diagonal(S)[..., None, :] + diagonal(i.R)
    over = np.maximum(i.e**2 / (limit.outlier_limit * np.where(i.measured, total, 1.0)) - 1.0, 0.0)
    over = np.where(i.measured, over, 0.0)
    refused, weight = (i.beta * (over > 0.0).any(axis=-1)).sum(axis=-1), i.beta.sum(axis=-1)
    release = limit.gate_release_frames
    kept = np.ones(count.shape, np.bool_) if release is None else count < release
    extra = np.where(kept[..., None, None], over * total, 0.0)[..., :, None] * np.eye(i.e.shape[-1])
    count[...] = np.where(weight > LEAST_WEIGHT, np.where(refused > weight / 2.0, count + 1.0, 0.0), count)
    return Innovations(i.e, i.R + extra, i.measured, i.beta, i.miss)
