"""Four trackers of one target in clutter: PDAF, NNSF, MVFF and the hybrid of the first and third, HPFF.

Each is a function of its state and the returns of a scan; leading dimensions are batch dimensions. Missing
a single target, they start from two scans in which it is known (`start`).

Source: HPFF paper (Pak 2021), eq. 11-26 and algorithm 1; PDAF: Bar-Shalom and Tse 1975.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from service.tracking.filters.converted import (
    Returns,
    distances,
    invert_pairs,
    planar_step,
    two_point_difference,
)
from service.tracking.filters.fir import FEWEST, FirWindow, empty_window, fit_window
from service.tracking.model import F64, Bool


@dataclass(frozen=True, slots=True)
class SingleTargetParameters:
    """The constants of the four trackers; defaults of the HPFF paper where it states them."""

    dt_s: float = 0.3  # T
    accel_std_mps2: float = 2.0  # sigma_w; the paper's tables need 0.2, far below its own rule a_M/2 to a_M
    detection_probability: float = 0.95  # P_D
    gate_probability: float = 0.99  # P_G
    gate: float = 9.21  # gamma: chi-square of P_G in two dimensions
    horizon: int = 4  # N, scans in the FIR window
    # Eq. 15 prints |R| where the Gaussian of the innovation has |S|: every likelihood is then too large by
    # sqrt(|S|/|R|). True is the printed form.
    printed_likelihood: bool = False


@dataclass(frozen=True, slots=True)
class SingleTrack:
    """One track for each member of a batch."""

    mean: F64  # (..., 4) [x y vx vy]
    cov: F64  # (..., 4, 4)
    window: FirWindow  # the return nearest to the estimate in each of the last N scans
    gated: Bool  # (..., J) which returns of the newest scan lay in the gate
    reset: Bool  # (...) the FIR filter set this estimate


Step = Callable[[SingleTrack, Returns, SingleTargetParameters], SingleTrack]


def start(first: Returns, second: Returns, p: SingleTargetParameters) -> SingleTrack:
    """Return the tracks at the second of two scans with one return each (J = 1), that of the target."""
    mean, cov = two_point_difference(first, second, p.dt_s)
    window = empty_window(mean.shape[:-1], p.horizon)
    known = np.ones(mean.shape[:-1], dtype=np.bool_)
    for scan in (first, second):
        window = window.push(scan.z[..., 0, :], scan.R[..., 0, :, :], known)
    return SingleTrack(mean, cov, window, np.ones((*known.shape, 1), np.bool_), ~known)


def pdaf(track: SingleTrack, returns: Returns, p: SingleTargetParameters) -> SingleTrack:
    """Return the tracks after a scan: all gated returns, weighted by their probabilities (eq. 11-22)."""
    mean, cov = _predict(track, p)
    e, S_inv, det, d2 = distances(mean, cov, returns)
    gated = d2 <= p.gate
    beta = _probabilities(d2, det, returns, gated, p)
    mean, cov = weighted_update(mean, cov, e, S_inv, beta)
    unset = np.zeros(mean.shape[:-1], np.bool_)
    return SingleTrack(mean, cov, _remember(track.window, mean, cov, returns), gated, unset)


def nnsf(track: SingleTrack, returns: Returns, p: SingleTargetParameters) -> SingleTrack:
    """Return the tracks after a scan: the nearest gated return, taken as the target's."""
    mean, cov = _predict(track, p)
    e, S_inv, _, d2 = distances(mean, cov, returns)
    gated = d2 <= p.gate
    nearest = np.arange(d2.shape[-1]) == d2.argmin(axis=-1)[..., None]
    beta = (gated & nearest).astype(np.float64)
    mean, cov = weighted_update(mean, cov, e, S_inv, beta)
    unset = np.zeros(mean.shape[:-1], np.bool_)
    return SingleTrack(mean, cov, _remember(track.window, mean, cov, returns), gated, unset)


def mvff(track: SingleTrack, returns: Returns, p: SingleTargetParameters) -> SingleTrack:
    """Return the tracks after a scan: what the window before it says (eq. 23-26), without recursion."""
    fit = fit_window(track.window, p.dt_s, p.accel_std_mps2)
    gated = distances(fit.mean, fit.cov, returns)[-1] <= p.gate
    window = _remember(track.window, fit.mean, fit.cov, returns)
    return SingleTrack(fit.mean, fit.cov, window, gated, np.ones(fit.mean.shape[:-1], np.bool_))


def hpff(track: SingleTrack, returns: Returns, p: SingleTargetParameters) -> SingleTrack:
    """Return the tracks after a scan: the PDAF, set anew by the FIR filter when its gate is empty."""
    after = pdaf(track, returns, p)
    lost = ~after.gated.any(axis=-1) & (track.window.seen.sum(axis=-1) >= FEWEST)
    if not lost.any():
        return after
    fit = fit_window(track.window.take(lost), p.dt_s, p.accel_std_mps2)
    mean, cov = after.mean.copy(), after.cov.copy()
    mean[lost], cov[lost] = fit.mean, fit.cov
    window = _remember(track.window, mean, cov, returns)
    return replace(after, mean=mean, cov=cov, window=window, reset=np.asarray(lost))


SINGLE_TARGET: Mapping[str, Step] = MappingProxyType({"pdaf": pdaf, "hpff": hpff, "nnsf": nnsf, "mvff": mvff})


def _predict(track: SingleTrack, p: SingleTargetParameters) -> tuple[F64, F64]:
    A, Q = planar_step(p.dt_s, p.accel_std_mps2)
    return track.mean @ A.T, A @ track.cov @ A.T + Q


def _probabilities(d2: F64, det: F64, returns: Returns, gated: Bool, p: SingleTargetParameters) -> F64:
    """Return beta (..., J), the probability of each return that it is the target's (eq. 14-16).

    The clutter density is the number of gated returns over the volume of the gate, pi gamma |S|^1/2, which
    cancels the determinant of the Gaussian: L = P_D gamma exp(-d2/2) / (2 n).
    """
    likelihood = np.where(gated, np.exp(-0.5 * np.where(gated, d2, 0.0)), 0.0)
    if p.printed_likelihood:
        likelihood = likelihood * np.sqrt(det / invert_pairs(returns.R)[1])
    count = np.maximum(gated.sum(axis=-1), 1)[..., None]
    likelihood = likelihood * (p.detection_probability * p.gate / 2.0) / count
    none = 1.0 - p.detection_probability * p.gate_probability
    return np.asarray(likelihood / (none + likelihood.sum(axis=-1, keepdims=True)))


def weighted_update(mean: F64, cov: F64, e: F64, S_inv: F64, beta: F64) -> tuple[F64, F64]:
    """Return the moment-matched update of predictions (eq. 17-22); what beta lacks to one is no return."""
    y = (S_inv @ e[..., None])[..., 0]
    d = (beta[..., None] * y).sum(axis=-2)
    inner = (beta[..., None, None] * S_inv).sum(axis=-3)
    spread = (beta[..., None, None] * y[..., :, None] * y[..., None, :]).sum(axis=-3) - d[..., :, None] * d[
        ..., None, :
    ]
    PC = cov[..., :, :2]
    new = cov - PC @ (inner - spread) @ PC.swapaxes(-1, -2)
    return mean + (PC @ d[..., None])[..., 0], (new + new.swapaxes(-1, -2)) * 0.5


def _remember(window: FirWindow, mean: F64, cov: F64, returns: Returns) -> FirWindow:
    """Return the windows with the return nearest to the estimate, gated or not (eq. 23-25)."""
    d2 = distances(mean, cov, returns)[-1]
    nearest = d2.argmin(axis=-1)[..., None]
    z = np.take_along_axis(returns.z, nearest[..., None], axis=-2)[..., 0, :]
    R = np.take_along_axis(returns.R, nearest[..., None, None], axis=-3)[..., 0, :, :]
    return window.push(z, R, np.asarray(d2.min(axis=-1, initial=math.inf) < math.inf))
