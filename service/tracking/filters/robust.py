"""Resist outliers: where an innovation lies far outside its covariance, trust that measurement less.

The covariance R_j of a measurement with normalised innovation squared NIS_j above the gate grows by
k_j^2, k_j = NIS_j / gate; the estimate still moves towards it, by little. A gate alone can lock out a
vehicle that really brakes, so after some rejected frames in a row the next measurement is taken as it is. A
frame is rejected when more than half of its association weight lies on measurements outside the gate.
"""

from __future__ import annotations

import math
from typing import Protocol

from service.tracking.filters.base import FilterState, Prediction
from service.tracking.filters.correction import Innovations, Rejection, correct
from service.tracking.model import F64

REJECTED = 0  # column of every filter's memory: rejected frames in a row
# A frame says something about a track if its measurements belong to it with at least this probability.
LEAST_WEIGHT = 0.1


class Guard(Protocol):
    """The part of a filter's parameters that says how it resists outliers."""

    @property
    def robust_gate(self) -> float | None:
        """NIS above which R grows, None for never."""
        ...

    @property
    def gate_release_frames(self) -> int | None:
        """Rejected frames in a row after which R stays as it is, None for never."""
        ...


def correct_robustly(
    prediction: Prediction, prior: F64, H: F64, innovations: Innovations, guard: Guard
) -> FilterState:
    """Return the corrected tracks.

    prediction: made by `own_prediction`; its memory is that after the frame already, but for the count of
    rejected frames, which is written into it.
    prior: (T, 6, 6) the (faded) covariance for the update; see `correction.correct`.
    """
    gate, release, memory = guard.robust_gate, guard.gate_release_frames, prediction.memory
    count = memory[:, REJECTED].copy()
    if gate is None:
        mean, cov, _ = correct(prediction, prior, H, innovations, Rejection(count))
        return FilterState(mean, cov, memory)
    rejection = Rejection(count, float(gate), math.inf if release is None else float(release), LEAST_WEIGHT)
    mean, cov, memory[:, REJECTED] = correct(prediction, prior, H, innovations, rejection)
    return FilterState(mean, cov, memory)
