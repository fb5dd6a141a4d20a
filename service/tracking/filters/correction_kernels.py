"""The compiled kernels of the update: innovations of all pairs, and the moment-matched correction.

Each track is a turn of a plain loop, so that a track alone and in a bank gives the same bytes. Results are
written to arrays that the caller brings: an allocation costs little to run and much to compile.
"""

from __future__ import annotations

import numpy as np

from service.tracking.kernel import kernel, part
from service.tracking.measurement import AZIMUTH, CHANNELS
from service.tracking.model import F64, Bool
from service.tracking.motion import STATES

LEAST_PIVOT = 1e-12  # of a correlation matrix that rounding has left positive definite
MIXED = 1e-6  # share of the prediction's covariance that is tried first where rounding has not
BALANCED = -1  # in place of the number of the first track whose probabilities do not add up to one


@part
def add_congruence(total: F64, weight: float, A: F64, M: F64, row: F64) -> None:
    """Add weight A M A' to the symmetric total (n, n); A (n, m), M (m, m); `row` (at least m) is for work."""
    n, m = A.shape
    for i in range(n):
        for k in range(m):
            row[k] = 0.0
        for j in range(m):
            for k in range(m):
                row[k] += A[i, j] * M[j, k]
        for j in range(i + 1):
            value = 0.0
            for k in range(m):
                value += row[k] * A[j, k]
            total[i, j] += weight * value
            total[j, i] = total[i, j]


@kernel
def project(H: F64, cov: F64, S: F64) -> None:
    """Write H P H' (T, 3, 3), exactly symmetric; H (T, 3, 6), P (T, 6, 6)."""
    row = np.empty(STATES)
    for t in range(len(H)):
        for a in range(CHANNELS):
            for b in range(CHANNELS):
                S[t, a, b] = 0.0
        add_congruence(S[t], 1.0, H[t], cov[t], row)


@kernel
def weigh_pairs(
    z: F64,
    R: F64,
    beta: F64,
    miss: F64,
    z_hat: F64,
    tolerance: float,
    e: F64,
    own_R: F64,
    measured: Bool,
) -> int:
    """Fill e (T, J, 3), own_R (T, J, 3, 3) and measured (T, J, 3), all zero before, where z was measured.

    Returns the first track whose beta and miss do not add up to one within the tolerance, or BALANCED.
    """
    tracks, many = beta.shape
    for t in range(tracks):
        balance = miss[t]
        for j in range(many):
            balance += beta[t, j]
        if not (abs(balance - 1.0) <= tolerance):
            return t
        for j in range(many):
            for a in range(CHANNELS):
                if not (beta[t, j] > 0.0 and abs(z[t, j, a]) < np.inf):
                    continue
                measured[t, j, a] = True
                difference = z[t, j, a] - z_hat[t, a]
                if a == AZIMUTH:
                    difference -= 2.0 * np.pi * np.ceil((difference - np.pi) / (2.0 * np.pi))
                e[t, j, a] = difference
                for b in range(a + 1):
                    if measured[t, j, b]:
                        own_R[t, j, a, b] = own_R[t, j, b, a] = R[t, j, a, b]
    return BALANCED


@part
def invert_measured(S: F64, measured: Bool, L: F64, inverse: F64) -> None:
    """Write the inverse (3, 3) of the measured block of S, other rows zero; L (3, 3) is for work.

    S = L L' by Cholesky, where an unmeasured channel is apart from the others; inverse = L^-T L^-1.
    """
    for a in range(CHANNELS):
        for b in range(a + 1):
            value = S[a, b] if measured[a] and measured[b] else 1.0 * (a == b)
            for k in range(b):
                value -= L[a, k] * L[b, k]
            L[a, b] = np.sqrt(value) if a == b else value / L[b, b]
    for a in range(CHANNELS):  # L^-1 in place of L, row by row
        for b in range(a):
            value = 0.0
            for k in range(b, a):
                value -= L[a, k] * L[k, b]
            L[a, b] = value / L[a, a]
        L[a, a] = 1.0 / L[a, a]
    for a in range(CHANNELS):
        if not measured[a]:
            L[a, a] = 0.0
        for b in range(a + 1):
            value = 0.0
            for k in range(a, CHANNELS):
                value += L[k, a] * L[k, b]
            inverse[a, b] = inverse[b, a] = value


@part
def keep_definite(cov: F64, predicted: F64, L: F64) -> None:
    """Mix as much of the predicted covariance into cov as makes it positive definite; L (n, n) is for work.

    Every term of the update is semidefinite, but not its rounding: next to the radar an azimuth tells a
    position to nanometres, and what is left of a variance is smaller than what rounding adds. Mostly cov
    stays as it is: the pivots of the Cholesky factor of its correlations are above LEAST_PIVOT.
    """
    share = MIXED
    while share < 2.0:
        definite = True
        for i in range(len(cov)):
            for k in range(i + 1):
                value = cov[i, k]
                for m in range(k):
                    value -= L[i, m] * L[k, m]
                if k < i:
                    L[i, k] = value / L[k, k]
            definite = definite and value > 0.0 and value > LEAST_PIVOT * cov[i, i]
            L[i, i] = np.sqrt(value) if definite else 1.0
        if definite:
            return
        for i in range(len(cov)):
            for k in range(len(cov)):
                cov[i, k] = max(0.0, 1.0 - share) * cov[i, k] + min(share, 1.0) * predicted[i, k]
        share *= 10.0


@kernel
def correct_bank(
    mean: F64,
    predicted: F64,
    prior: F64,
    H: F64,
    e: F64,
    R: F64,
    measured: Bool,
    beta: F64,
    miss: F64,
    rejected: F64,
    gate: float,
    release: float,
    least_weight: float,
    S_inv: F64,
    new_mean: F64,
    cov: F64,
    count: F64,
) -> None:
    """Write the corrected mean (T, 6) and covariance (T, 6, 6), and the rejected frames in a row (T,).

    Arguments and formulas: those of `correction.correct`. S_inv (J, 3, 3) is for work.
    """
    small, PHt, left = (
        np.empty((6, CHANNELS, CHANNELS)),
        np.empty((STATES, CHANNELS)),
        np.empty((STATES, STATES)),
    )
    S0, A, B, C, S, L = small[0], small[1], small[2], small[3], small[4], small[5]
    PHt, left = np.empty((STATES, CHANNELS)), np.empty((STATES, STATES))
    y, d, row = np.empty(CHANNELS), np.empty(CHANNELS), np.empty(STATES)
    for t in range(len(mean)):
        weight = refused = 0.0
        for j in range(beta.shape[1]):
            weight += beta[t, j]
        for a in range(CHANNELS):
            d[a] = 0.0
            for b in range(CHANNELS):
                S0[a, b] = A[a, b] = B[a, b] = C[a, b] = 0.0
        add_congruence(S0, 1.0, H[t], prior[t], row)

        for j in range(beta.shape[1]):
            if not (beta[t, j] > 0.0):
                continue
            growth = 1.0
            for attempt in range(2):  # again with a larger R for an outlier
                for a in range(CHANNELS):
                    for b in range(CHANNELS):
                        S[a, b] = S0[a, b] + growth * R[t, j, a, b]
                invert_measured(S, measured[t, j], L, S_inv[j])
                nis = 0.0
                for a in range(CHANNELS):
                    y[a] = 0.0
                    for b in range(CHANNELS):
                        y[a] += S_inv[j, a, b] * e[t, j, b]
                    nis += e[t, j, a] * y[a]
                if attempt == 1 or not (nis > gate):
                    break
                refused += beta[t, j]
                if not (rejected[t] < release):
                    break
                growth = (nis / gate) ** 2
            add_congruence(B, beta[t, j] * growth, S_inv[j], R[t, j], row)
            for a in range(CHANNELS):
                d[a] += beta[t, j] * y[a]
                for b in range(CHANNELS):
                    A[a, b] += beta[t, j] / weight * S_inv[j, a, b]
                    C[a, b] += beta[t, j] * y[a] * y[b]
        for j in range(beta.shape[1]):
            if beta[t, j] > 0.0:
                for a in range(CHANNELS):
                    for b in range(CHANNELS):
                        S[a, b] = S_inv[j, a, b] - A[a, b]
                add_congruence(B, beta[t, j], S, S0, row)
        for a in range(CHANNELS):
            for b in range(CHANNELS):
                B[a, b] += C[a, b] - d[a] * d[b]
        count[t] = rejected[t]
        if weight > least_weight:
            count[t] = rejected[t] + 1.0 if refused > weight / 2.0 else 0.0

        for i in range(STATES):
            new_mean[t, i] = mean[t, i]
            for a in range(CHANNELS):
                PHt[i, a] = 0.0
                for k in range(STATES):
                    PHt[i, a] += prior[t, i, k] * H[t, a, k]
                new_mean[t, i] += PHt[i, a] * d[a]
            for k in range(STATES):
                left[i, k] = 1.0 * (i == k)
                cov[t, i, k] = miss[t] * predicted[t, i, k]
            for b in range(CHANNELS):
                gain = 0.0
                for a in range(CHANNELS):
                    gain += PHt[i, a] * A[a, b]
                for k in range(STATES):
                    left[i, k] -= gain * H[t, b, k]
        add_congruence(cov[t], weight, left, prior[t], row)
        add_congruence(cov[t], 1.0, PHt, B, row)
        keep_definite(cov[t], predicted[t], left)
