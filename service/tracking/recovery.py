"""Set lost tracks anew from what a FIR filter makes of the last scans: the hybrid filter for many targets.

The HPFF paper (Pak 2021) resets the filter of its only target whenever the gate is empty. With several
targets and missed detections that rule is harmful: most empty gates are plain misses, and the nearest return
is somebody else's. A reset therefore wants evidence: a gate empty for some scans, positions that no other
track claims from at least all but one of those scans, a good fit with a speed the vehicle can have reached,
no other track there, and an unclaimed return of this scan where the fit expects one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import gammaincinv

from service.tracking.filters.converted import PLANAR_STATES, Returns, distances
from service.tracking.filters.fir import FirEstimate, FirWindow, empty_window, fit_window
from service.tracking.model import F64, I64, Bool


@dataclass(frozen=True, slots=True)
class RecoveryParameters:
    """When a track is set anew."""

    enabled: bool = False
    after: int = 2  # empty scans in a row, this one included; 3 where P_D < 0.9 or clutter > 2e-3 per m^2
    horizon: int = 5  # scans in the window
    fewest: int = 3  # positions in the window
    accel_std_mps2: float = 3.0  # process noise of the fit
    fit_probability: float = 0.999  # share of true windows whose misfit is accepted
    accel_max_mps2: float = 10.0  # hardest manoeuvre: braking and cornering on a dry road
    speed_sigmas: float = 3.0
    apart_d2: float = 13.3  # squared distance to other tracks; chi-square 0.99 in 4 dimensions
    gate: float = 9.21  # of the fit, for a return of this scan; chi-square 0.99 in 2 dimensions
    near_d2: float = 150.0  # the window takes returns within this squared distance of the estimate ...
    near_m: float = 6.0  # ... and this far
    speed_min_mps: float = 0.0  # slower tracks stay: in a queue the next vehicle is near
    claim: float = 0.4  # association probability from which a return is a track's own


@dataclass(frozen=True, slots=True)
class Trail:
    """The positions of the last scans of each track."""

    window: FirWindow  # (..., T, N)
    empty: Bool  # (..., T, N) the gate was empty in that scan

    def push(self, z: F64, R: F64, seen: Bool, empty: Bool) -> Trail:
        """Return the trails with one more scan: positions (..., T, 2), R (..., T, 2, 2), flags (..., T)."""
        flags = np.concatenate([self.empty[..., 1:], empty[..., None]], axis=-1)
        return Trail(self.window.push(z, R, seen), flags)

    def take(self, which: Bool | I64) -> Trail:
        """Return the chosen trails."""
        return Trail(self.window.take(which), self.empty[which])


@dataclass(frozen=True, slots=True)
class TrailBook:
    """The trails of numbered tracks, in order of number."""

    number: I64  # (M,)
    trail: Trail  # (M, N)

    def of(self, number: I64, horizon: int) -> Trail:
        """Return the trails of these tracks (T,); those not in the book have none yet."""
        fresh = no_trail((len(number),), horizon)
        if not len(self.number) or self.trail.empty.shape[-1] != horizon:
            return fresh
        at = np.minimum(np.searchsorted(self.number, number), len(self.number) - 1)
        known = self.number[at] == number
        old, w, flags = self.trail.take(at), fresh.window, known[:, None]
        window = FirWindow(
            np.where(flags[..., None], old.window.z, w.z),
            np.where(flags[..., None, None], old.window.R, w.R),
            old.window.seen & flags,
        )
        return Trail(window, old.empty & flags)


@cache
def no_book() -> TrailBook:
    """Return a book without trails."""
    return TrailBook(np.zeros(0, np.int64), no_trail((0,), 0))


def no_trail(leading: tuple[int, ...], horizon: int) -> Trail:
    """Return trails without a position."""
    return Trail(empty_window(leading, horizon), np.zeros((*leading, horizon), np.bool_))


def nearest(mean: F64, cov: F64, returns: Returns, free: Bool, p: RecoveryParameters) -> tuple[I64, Bool]:
    """Return the return (..., T) of the scan that each track's window takes, and whether there is one.

    mean (..., T, 4), cov (..., T, 4, 4); returns: z (..., T, J, 2) or broadcastable; free (..., T, J): not
    claimed by another track.
    """
    e, _, _, d2 = distances(mean, cov, returns)
    fits = free & (d2 <= p.near_d2) & (np.hypot(e[..., 0], e[..., 1]) <= p.near_m)
    d2 = np.where(fits, d2, np.inf)
    return np.asarray(d2.argmin(axis=-1)), np.asarray(fits.any(axis=-1))


@dataclass(frozen=True, slots=True)
class Scan:
    """T tracks after the update of a scan, and the J returns of it."""

    mean: F64  # (T, 4) [x y vx vy]
    cov: F64  # (T, 4, 4)
    empty: I64  # (T,) scans in a row without a return in the gate, this one included
    firm: Bool  # (T,) tracks that may be set anew, and onto which none may land
    trail: Trail  # of the scans before this one
    returns: Returns  # (T, J), each track its own view of a return, or (1, J)
    free: Bool  # (J,) claimed by nobody
    dt_s: float


@dataclass(frozen=True, slots=True)
class Reset:
    """One track set anew."""

    track: int
    by: int  # the return of this scan that confirms it
    mean: F64  # (4,) [x y vx vy] before that return
    cov: F64  # (4, 4)


def find_resets(s: Scan, p: RecoveryParameters) -> list[Reset]:
    """Return the tracks of a scan to be set anew, in their order, each with a return of its own."""
    found: list[Reset] = []
    candidates = np.flatnonzero(
        s.firm & (s.empty >= p.after) & (s.trail.window.seen.sum(axis=-1) >= p.fewest)
    )
    if not len(candidates) or not s.free.any():
        return found
    chosen = s.trail.take(candidates)
    fit = fit_window(chosen.window, s.dt_s, p.accel_std_mps2)
    good = (chosen.window.seen & chosen.empty).sum(axis=-1) >= p.after - 1
    good &= fit.misfit <= _largest_misfit(p.fit_probability, p.horizon)[fit.count]
    good &= _reachable(s, candidates, fit, p)
    for velocity in (s.mean[candidates, 2:], fit.mean[:, 2:]):
        good &= np.linalg.norm(velocity, axis=-1) >= p.speed_min_mps
    free, place, spread = s.free.copy(), s.mean.copy(), s.cov.copy()
    for k in np.flatnonzero(good):
        track, mean, cov = int(candidates[k]), fit.mean[k], fit.cov[k]
        own, others = min(track, len(s.returns.z) - 1), s.firm & (np.arange(len(place)) != track)
        d2 = distances(mean, cov, Returns(s.returns.z[own], s.returns.R[own]))[-1]
        d2 = np.where(free, d2, np.inf)
        by = int(d2.argmin())
        if not d2[by] <= p.gate or _occupied(mean, cov, place[others], spread[others], p):
            continue
        found.append(Reset(track, by, mean, cov))
        free[by], place[track], spread[track] = False, mean, cov
    return found


def _reachable(s: Scan, which: I64, fit: FirEstimate, p: RecoveryParameters) -> Bool:
    """Return whether the fitted speeds can have been reached since the windows began."""
    change = np.linalg.norm(fit.mean[:, 2:] - s.mean[which, 2:], axis=-1)
    doubt = np.trace(s.cov[which, 2:, 2:] + fit.cov[:, 2:, 2:], axis1=-2, axis2=-1)
    most = p.accel_max_mps2 * s.dt_s * (s.empty[which] + p.horizon)
    return np.asarray(change <= most + p.speed_sigmas * np.sqrt(doubt))


def _occupied(mean: F64, cov: F64, place: F64, spread: F64, p: RecoveryParameters) -> bool:
    """Tell whether a track of those at place (M, 4), spread (M, 4, 4) may be where this one would land."""
    gap = place - mean
    d2 = (gap * np.linalg.solve(spread + cov, gap[..., None])[..., 0]).sum(axis=-1)
    return bool((d2 < p.apart_d2).any())


@cache
def _largest_misfit(probability: float, horizon: int) -> F64:
    """Return the chi-square threshold by number of positions in the window.

    Its quantile is twice that of the gamma distribution; scipy.stats takes half a second to import.
    """
    freedom = 2 * np.arange(horizon + 1) - PLANAR_STATES
    return np.where(freedom > 0, 2.0 * gammaincinv(0.5 * np.maximum(freedom, 1), probability), np.inf)
