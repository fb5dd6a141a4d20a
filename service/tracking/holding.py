"""Hold settled boxes that stand where they are, whatever their points say."""

from __future__ import annotations

import math

from service.tracking.extent import ExtentParameters
from service.tracking.kernel import kernel
from service.tracking.model import F64, I64
from service.tracking.state import Tracks


def held_noise(tracks: Tracks, predicted: F64, R: F64, p: ExtentParameters) -> F64:
    """Return the noise (T, J, 3, 3) of the measured centres, larger where held boxes are measured.

    Which end of a standing vehicle answers, and which neighbour's echo lies in its gate, stays the same for
    seconds: taken for news in every frame it pulls ever harder at a box that is held, and once a noisy range
    rate lets the box go it leaps.
    """
    if not len(tracks):
        return R
    out = R.copy()
    _spread(out, predicted, tracks.hits, p.held_hits, p.held_below_mps, p.held_noise_times)
    return out


@kernel
def _spread(R: F64, predicted: F64, hits: I64, settled: int, below: float, times: float) -> None:
    for i in range(len(hits)):
        if hits[i] >= settled and math.hypot(predicted[i, 1], predicted[i, 4]) <= below:
            for j in range(R.shape[1]):
                for r in range(2):
                    for c in range(2):
                        R[i, j, r, c] *= times


def hold(tracks: Tracks, predicted: F64, mean: F64, p: ExtentParameters) -> F64:
    """Return the means (T, 6) after an update with settled boxes that stand held where they were predicted.

    tracks: before the update; predicted (T, 6). Which end of a standing vehicle answers changes from frame
    to frame, and a filter takes that for motion, against what the range rate says.
    """
    if not len(tracks):
        return mean
    out = mean.copy()
    limits = (p.held_below_mps, p.held_step_m, p.held_side_on_step_m)
    _hold(out, predicted, tracks.heading_rad, tracks.hits, p.held_hits, limits)
    return out


@kernel
def _hold(
    mean: F64, predicted: F64, heading: F64, hits: I64, settled: int, limits: tuple[float, float, float]
) -> None:
    below, step, side_on = limits
    for i in range(len(hits)):
        if hits[i] < settled or math.hypot(predicted[i, 1], predicted[i, 4]) > below:
            continue
        if math.hypot(mean[i, 1], mean[i, 4]) > below:
            continue
        end_on = abs(math.cos(heading[i] - math.atan2(predicted[i, 0], predicted[i, 3])))
        most = step if end_on > 0.5 else side_on
        dx, dy = mean[i, 0] - predicted[i, 0], mean[i, 3] - predicted[i, 3]
        far = math.hypot(dx, dy)
        if far > most:
            mean[i, 0] = predicted[i, 0] + dx * most / far
            mean[i, 3] = predicted[i, 3] + dy * most / far
