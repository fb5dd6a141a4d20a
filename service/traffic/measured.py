"""What the stages of one step read of the tracks that were measured: one table of doubles, made once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.model import F32, F64, I64, TrackEstimates, TrackStatus

_CONFIRMED = int(TrackStatus.CONFIRMED)
# rows of `real`
X, Y, VX, VY, LENGTH, EXISTENCE, HEADING, ACROSS_STD = range(8)
PLANE = slice(X, LENGTH)  # place and velocity


@dataclass(frozen=True, slots=True)
class Measured:
    """The M confirmed ones among the T tracks of a frame; where others coast to is only a guess."""

    row: I64  # (M,) among the tracks
    real: F64  # (8, M): x_m, y_m, vx_mps, vy_mps, length_m, existence, heading_rad, across_std_m
    across_std_m: F32  # (T,) standard deviation of the place across the heading, of all tracks
    everybody: bool  # were measured


def measured_of(now: TrackEstimates) -> Measured:
    """Return the tracks that had a measurement."""
    std = across_std_m(now)
    columns = (now.x_m, now.y_m, now.vx_mps, now.vy_mps, now.length_m, now.existence, now.heading_rad, std)
    real = np.array(columns, dtype=np.float64)
    row = (now.status == _CONFIRMED).nonzero()[0]
    everybody = len(row) == len(now)
    return Measured(row, real if everybody else real.take(row, axis=1), std, everybody)


def across_std_m(now: TrackEstimates) -> F32:
    """Return the standard deviation (T,) of each track's place across its heading."""
    right, back = np.cos(now.heading_rad), -np.sin(now.heading_rad)
    variance = (now.std_x_m * right) ** 2 + (now.std_y_m * back) ** 2 + 2.0 * now.cov_xy_m2 * right * back
    return np.sqrt(np.maximum(variance, 0.0)).astype(np.float32)
