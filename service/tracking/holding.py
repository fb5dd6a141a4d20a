"""Hold settled boxes that stand where they are, until their points have gone on for a while."""

from __future__ import annotations

import math

import numpy as np

from service.tracking.boxes import M_COUNT, M_U
from service.tracking.extent import ExtentParameters
from service.tracking.kernel import kernel
from service.tracking.model import F64, Bool
from service.tracking.state import Tracks

SIDE_ON_COSINE = 0.5  # of the aspect, up to which the side is seen and not an end
AHEAD_MOST_M = 3.0  # that one frame says of how far a box has to go on


def held_noise(tracks: Tracks, predicted: F64, R: F64, p: ExtentParameters) -> F64:
    """Return the noise (T, J, 3, 3) of the measured centres, larger where held boxes are measured.

    Which end of a standing vehicle answers, and which neighbour's echo lies in its gate, stays the same for
    seconds: taken for news in every frame it pulls ever harder at a box that is held, and once a noisy range
    rate lets the box go it leaps.
    """
    if not len(tracks):
        return R
    out = R.copy()
    _spread(out, predicted, _settled(tracks, p), p.held_below_mps, p.held_noise_times)
    return out


def _settled(tracks: Tracks, p: ExtentParameters) -> Bool:
    """Return which boxes (T,) are settled, and not carried on by their points."""
    return np.asarray((tracks.hits >= p.held_hits) & (np.abs(tracks.ahead_m) <= p.ahead_free_m))


@kernel
def _spread(R: F64, predicted: F64, settled: Bool, below: float, times: float) -> None:
    for i in range(len(settled)):
        if settled[i] and math.hypot(predicted[i, 1], predicted[i, 4]) <= below:
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
    _hold(out, predicted, tracks.heading_rad, _settled(tracks, p), limits)
    return out


@kernel
def _hold(mean: F64, predicted: F64, heading: F64, settled: Bool, limits: tuple[float, float, float]) -> None:
    below, step, side_on = limits
    for i in range(len(settled)):
        if not settled[i] or math.hypot(predicted[i, 1], predicted[i, 4]) > below:
            continue
        if math.hypot(mean[i, 1], mean[i, 4]) > below:
            continue
        end_on = abs(math.cos(heading[i] - math.atan2(predicted[i, 0], predicted[i, 3])))
        most = step if end_on > SIDE_ON_COSINE else side_on
        dx, dy = mean[i, 0] - predicted[i, 0], mean[i, 3] - predicted[i, 3]
        far = math.hypot(dx, dy)
        if far > most:
            mean[i, 0] = predicted[i, 0] + dx * most / far
            mean[i, 3] = predicted[i, 3] + dy * most / far


def watch_ends(tracks: Tracks, measured: F64, hit: Bool, p: ExtentParameters) -> Tracks:
    """Return the tracks after an update with the mean of how far ahead its points put each slow box.

    measured (T, MEASUREMENT_COLUMNS) of each track's own points, hit (T,). A vehicle seen side-on that drives
    off has no range rate to tell of it, and is held; but both ends of its row of points go on ahead of the
    box, where of one that stands now this end answers and now that.
    """
    if not len(tracks):
        return tracks
    ahead = tracks.ahead_m.copy()
    _watch(tracks.mean, tracks.heading_rad, measured, hit, ahead, p.ahead_gain, p.ahead_below_mps)
    return tracks.but(ahead_m=ahead)


@kernel
def _watch(mean: F64, heading: F64, measured: F64, hit: Bool, ahead: F64, gain: float, below: float) -> None:
    for i in range(len(ahead)):
        aspect = heading[i] - math.atan2(mean[i, 0], mean[i, 3])
        if math.hypot(mean[i, 1], mean[i, 4]) > below or abs(math.cos(aspect)) > SIDE_ON_COSINE:
            ahead[i] = 0.0
        elif hit[i] and measured[i, M_COUNT] > 0.0:
            ahead[i] += gain * (min(max(measured[i, M_U], -AHEAD_MOST_M), AHEAD_MOST_M) - ahead[i])
