"""The posterior Cramer-Rao bound: the least error that any filter can have on a trajectory.

Source: Tichavsky, Muravchik, Nehorai 1998. For linear motion and Gaussian noise the information recursion is
that of a Kalman filter whose measurement is linearised at the truth; here in covariance form.
"""

from __future__ import annotations

import numpy as np

from service.tracking.measurement import linearise
from service.tracking.model import F64


def posterior_bound(truth: F64, R: F64, F: F64, Q: F64, P0: F64) -> F64:
    """Return the least covariance (K, n, n) after each measurement of states truth (K, n).

    The state has the columns of the tracker, n = 6; R (m, m) is the covariance of the first m channels range,
    azimuth, range rate.  F, Q: (n, n) or (K, n, n), the step into each instant (the first is not used).
    P0: (n, n) covariance before the first measurement.
    """
    channels = len(R)
    H_all = linearise(truth)[1][:, :channels]
    bound, P = np.empty((len(truth), *P0.shape)), P0
    steps, noise = (np.broadcast_to(M, (len(truth), *P0.shape)) for M in (F, Q))
    for k, H in enumerate(H_all):
        if k:
            P = steps[k] @ P @ steps[k].T + noise[k]
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        left = np.eye(len(P0)) - K @ H
        P = left @ P @ left.T + K @ R @ K.T
        bound[k] = P
    return bound
