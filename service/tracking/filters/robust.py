"""Resist outliers: where an innovation lies far outside its covariance, trust that measurement less.

The covariance R_j of a measurement with normalised innovation squared NIS_j above the gate grows by
k_j^2, k_j = NIS_j / gate; the estimate still moves towards it, by little. A gate alone can lock out a
vehicle that really brakes, so after some rejected frames in a row the next measurement is taken as it is.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from service.tracking.filters.base import FilterState, Prediction
from service.tracking.filters.correction import Innovations, correct, solve
from service.tracking.model import F64

REJECTED = 0  # column of every filter's memory: rejected frames in a row
# A frame says something about a track if its measurements belong to it with at least this probability.
LEAST_WEIGHT = 0.1
HALF = 0.5  # of the association weight on rejected measurements makes a rejected frame


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

    prediction: its memory is that after the frame already, but for the count of rejected frames.
    prior: (T, 6, 6) the (faded) covariance for the update; see `correction.correct`.
    """
    S_prior = H @ prior @ H.swapaxes(-1, -2)
    solved = solve(S_prior, innovations)
    memory = prediction.memory
    if guard.robust_gate is not None:
        rejected = memory[:, REJECTED]
        excess = solved.nis / guard.robust_gate
        outside = excess > 1.0
        inflated = outside
        if guard.gate_release_frames is not None:
            inflated = outside & (rejected < guard.gate_release_frames)[:, None]
        if inflated.any():
            solved = solve(S_prior, innovations, np.where(inflated, excess * excess, 1.0))
        memory = memory.copy()
        memory[:, REJECTED] = _count(rejected, innovations.beta * outside, innovations.beta)
    return FilterState(*correct(prediction, prior, H, innovations, solved), memory)


def _count(rejected: F64, refused: F64, beta: F64) -> F64:
    """Return the rejected frames in a row (T,) after one with weights `beta`, of them `refused`."""
    weight = beta.sum(axis=1)
    counted = np.where(refused.sum(axis=1) > HALF * weight, rejected + 1.0, 0.0)
    return np.where(weight > LEAST_WEIGHT, counted, rejected)
