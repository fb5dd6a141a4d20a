"""The compiled kernels of the fading: what a frame says about each track, and the factors that follow.

Arrays by channel (T, 3) are range, azimuth, range rate. Where a channel was not measured `used` is 0.
"""

from __future__ import annotations

import numpy as np

from service.tracking.kernel import kernel, part
from service.tracking.measurement import CHANNELS
from service.tracking.model import F64, Bool
from service.tracking.motion import STATES

GRID_POINTS = 10  # candidates b_n = 1 + u n of the softening factor; as many as the paper's window of pairs
AXES = 2  # of the line of sight: radial, tangential
DERIVATIVES = 3  # position, velocity, acceleration

# columns of a filter's memory; column 0 is the count of rejected frames
COUNT = 1  # measurements so far
STATISTIC = 2  # by channel: running mean of the innovation, or the residual covariance
SCORES = STATISTIC + CHANNELS  # of each softening factor, by axis if there are two


@kernel
def compare(
    e: F64,
    R: F64,
    measured: Bool,
    beta: F64,
    propagated: F64,
    noise: F64,
    H: F64,
    least: float,
    clip: float,
    seen: F64,
    shorten: F64,
) -> None:
    """Write e, R, used, m, q (5, T, 3) and shorten (T,) of `fading.Residuals`.

    e (T, J, 3) to beta (T, J): of `correction.Innovations`.  least: weight from which a channel counts as
    measured.  clip: normalised square to which innovations are shortened.
    """
    for t in range(len(beta)):
        nis, n = 0.0, min(t, len(noise) - 1)
        for a in range(CHANNELS):
            weight = sum_e = sum_R = m = q = 0.0
            for j in range(beta.shape[1]):
                if measured[t, j, a]:
                    weight += beta[t, j]
                    sum_e += beta[t, j] * e[t, j, a]
                    sum_R += beta[t, j] * R[t, j, a, a]
            for i in range(STATES):
                if H[t, a, i] == 0.0:  # most of H is
                    continue
                for k in range(STATES):
                    both = H[t, a, i] * H[t, a, k]
                    m += both * propagated[t, i, k]
                    q += both * noise[n, i, k]
            seen[0, t, a], seen[1, t, a], seen[2, t, a] = 0.0, 1.0, 0.0
            if weight > least:
                seen[0, t, a], seen[1, t, a], seen[2, t, a] = sum_e / weight, sum_R / weight, 1.0
                nis += seen[0, t, a] ** 2 / (m + q + seen[1, t, a])
            seen[3, t, a], seen[4, t, a] = m, q
        shorten[t] = clip / nis if nis > clip else 1.0


@part
def soften(score: F64, smoother: F64, step: float, tolerance: float) -> float:
    """Return the largest candidate whose smoothed score (10,) is within the tolerance of the best."""
    smooth, least, chosen = np.empty(GRID_POINTS), np.inf, 0
    for n in range(GRID_POINTS):
        smooth[n] = 0.0
        for k in range(GRID_POINTS):
            smooth[n] += score[k] * smoother[k, n]
        least = min(least, smooth[n])
    for n in range(GRID_POINTS):
        if smooth[n] <= least + tolerance:
            chosen = n
    return 1.0 + step * chosen


@kernel
def axis_factors(
    e: F64,
    R: F64,
    used: F64,
    m: F64,
    q: F64,
    shorten: F64,
    memory: F64,
    alpha: F64,
    gain: float,
    largest: float,
    fixed: float,
    start: float,
    step: float,
    warm_up: int,
    forgetting: float,
    tolerance: float,
    smoother: F64,
    factors: F64,
) -> None:
    """Write the factors (T, 2, 3) by axis and derivative, and update the memory (T, 25) in place.

    Formulas and arguments: `strong_tracking.fading_factors`; fixed: softening factor, NaN to search it.
    """
    white = (2.0 - gain) / gain
    for t in range(len(memory)):
        root, count = np.sqrt(shorten[t]), memory[t, COUNT]
        for axis in range(AXES):
            spread = channels = noise = old = new = 0.0
            for a in range(axis, CHANNELS, 2):  # radial: range and range rate, tangential: azimuth
                if used[t, a] == 0.0:
                    continue
                before = memory[t, STATISTIC + a]
                after = (1.0 - gain) * before + gain * root * e[t, a]
                memory[t, STATISTIC + a] = after
                channels += 1.0
                spread += alpha[a // 2] * m[t, a] / R[t, a]  # range rate sees the velocity
                noise += q[t, a] / R[t, a]
                old += white * before * before / R[t, a]
                new += white * after * after / R[t, a]
            if not (spread > 0.0):  # no channel: all sums are zero, and so is c
                spread = 1.0
            scores, chosen = SCORES + axis * GRID_POINTS, fixed
            if np.isnan(fixed):
                for n in range(GRID_POINTS):
                    if channels == 0.0 or count == 0.0:
                        break
                    c, score = (old - noise - channels * (1.0 + step * n)) / spread, 0.0
                    for a in range(axis, CHANNELS, 2):
                        if used[t, a] > 0.0:
                            factor = min(max(alpha[a // 2] * c, 1.0), largest)
                            variance = factor * m[t, a] + q[t, a] + R[t, a]
                            score += np.log(variance) + shorten[t] * e[t, a] * e[t, a] / variance
                    memory[t, scores + n] = forgetting * memory[t, scores + n] + score
                chosen = start
                if count >= warm_up:
                    chosen = soften(memory[t, scores : scores + GRID_POINTS], smoother, step, tolerance)
            c = (new - noise - chosen * channels) / spread
            for i in range(DERIVATIVES):
                factors[t, axis, i] = min(max(alpha[i] * c, 1.0), largest)
        if used[t, 0] + used[t, 1] + used[t, 2] > 0.0:
            memory[t, COUNT] = count + 1.0


@kernel
def fade_axes(propagated: F64, noise: F64, mean: F64, factors: F64, nearest_m: float, faded: F64) -> None:
    """Write W (F P F') W' + Q (T, 6, 6); see `strong_tracking.fade`."""
    W = np.empty((DERIVATIVES, AXES, AXES))
    for t in range(len(mean)):
        P, Q, x, y = propagated[t], noise[min(t, len(noise) - 1)], mean[t, 0], mean[t, 3]
        r = max(np.hypot(x, y), nearest_m)
        ux, uy = x / r, y / r
        for i in range(DERIVATIVES):
            # across * identity + (along - across) u u', which is the identity without fading
            across = np.sqrt(factors[t, 1, i])
            extra = np.sqrt(factors[t, 0, i]) - across
            W[i, 0, 0], W[i, 1, 1] = across + extra * ux * ux, across + extra * uy * uy
            W[i, 0, 1] = W[i, 1, 0] = extra * ux * uy
        for row in range(STATES):
            i, p = row % DERIVATIVES, row // DERIVATIVES
            for column in range(row + 1):
                k, s = column % DERIVATIVES, column // DERIVATIVES
                x_part = W[i, p, 0] * P[i, k] + W[i, p, 1] * P[i + 3, k]
                y_part = W[i, p, 0] * P[i, k + 3] + W[i, p, 1] * P[i + 3, k + 3]
                value = x_part * W[k, s, 0] + y_part * W[k, s, 1] + Q[row, column]
                faded[t, row, column] = faded[t, column, row] = value


@kernel
def fade_states(
    e: F64,
    R: F64,
    used: F64,
    q: F64,
    shorten: F64,
    memory: F64,
    propagated: F64,
    noise: F64,
    H: F64,
    alpha: F64,
    remembrance: float,
    largest: float,
    fixed: float,
    start: float,
    step: float,
    warm_up: int,
    forgetting: float,
    tolerance: float,
    smoother: F64,
    faded: F64,
) -> None:
    """Write the covariance L^1/2 F P F' L^1/2 + Q (T, 6, 6), and update the memory in place.

    Formulas and arguments: `strong_tracking_paper.fade`; fixed: softening factor, NaN to search it.
    """
    # S = sum over derivatives d, f of root_d root_f parts[:, :, d, f], and a rest that does not fade
    parts = np.empty((CHANNELS, CHANNELS, DERIVATIVES, DERIVATIVES))
    rest, L = np.empty((CHANNELS, CHANNELS)), np.empty((CHANNELS, CHANNELS))
    root, white = np.empty(DERIVATIVES), np.empty(CHANNELS)
    for t in range(len(memory)):
        Q, count = noise[min(t, len(noise) - 1)], memory[t, COUNT]
        for a in range(CHANNELS):
            for b in range(a + 1):
                rest[a, b] = R[t, a] * (a == b)
                for d in range(DERIVATIVES):
                    for f in range(DERIVATIVES):
                        parts[a, b, d, f] = 0.0
                for i in range(STATES):
                    if H[t, a, i] == 0.0:
                        continue
                    for k in range(STATES):
                        both = H[t, a, i] * H[t, b, k]
                        rest[a, b] += both * Q[i, k]
                        parts[a, b, i % DERIVATIVES, k % DERIVATIVES] += both * propagated[t, i, k]
        spread = channels = old = new = 0.0
        for a in range(CHANNELS):
            if used[t, a] > 0.0:
                before, squared = memory[t, STATISTIC + a], shorten[t] * e[t, a] ** 2
                after = squared if count == 0.0 else (remembrance * before + squared) / (1.0 + remembrance)
                memory[t, STATISTIC + a] = after
                channels += 1.0
                old += (before - q[t, a]) / R[t, a]
                new += (after - q[t, a]) / R[t, a]
                for d in range(DERIVATIVES):
                    for f in range(DERIVATIVES):
                        spread += alpha[d] * parts[a, a, d, f] / R[t, a]
        if not (spread > 0.0):  # no channel: all sums are zero, and so is c
            spread = 1.0
        chosen = fixed
        if np.isnan(fixed):
            for n in range(GRID_POINTS):
                if channels == 0.0 or count == 0.0:
                    break
                c, score = (old - channels * (1.0 + step * n)) / spread, 0.0
                for d in range(DERIVATIVES):
                    root[d] = np.sqrt(min(max(alpha[d] * c, 1.0), largest))
                for a in range(CHANNELS):  # Cholesky of S, where an unmeasured channel is apart
                    white[a] = np.sqrt(shorten[t]) * e[t, a]
                    for b in range(a + 1):
                        value = rest[a, b]
                        for d in range(DERIVATIVES):
                            for f in range(DERIVATIVES):
                                value += root[d] * root[f] * parts[a, b, d, f]
                        value = used[t, a] * used[t, b] * value + (1.0 - used[t, a]) * (a == b)
                        for k in range(b):
                            value -= L[a, k] * L[b, k]
                        if b < a:
                            L[a, b] = value / L[b, b]
                            white[a] -= L[a, b] * white[b]
                        else:
                            L[a, a] = np.sqrt(value)
                            white[a] /= L[a, a]
                            score += np.log(value) + white[a] ** 2
                memory[t, SCORES + n] = forgetting * memory[t, SCORES + n] + score
            chosen = start
            if count >= warm_up:
                chosen = soften(memory[t, SCORES : SCORES + GRID_POINTS], smoother, step, tolerance)
        c = (new - chosen * channels) / spread
        for d in range(DERIVATIVES):
            root[d] = np.sqrt(min(max(alpha[d] * c, 1.0), largest))
        for i in range(STATES):
            for k in range(STATES):
                faded[t, i, k] = root[i % DERIVATIVES] * root[k % DERIVATIVES] * propagated[t, i, k] + Q[i, k]
        if channels > 0.0:
            memory[t, COUNT] = count + 1.0
