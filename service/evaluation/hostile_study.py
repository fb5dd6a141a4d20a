"""Feed a filter what no radar should send, and count where its estimates stop being numbers or covariances.

Vehicles pass over the radar and behind it, so that ranges vanish and azimuths jump by 2 pi. Of their
measurements half are missing, many lack Doppler or are off by up to thousands of standard deviations, several
share a track with random weights, and the noise that comes with them is wrong by up to a hundred times.
Frames come at uneven times.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.filters.base import Filter, FilterState
from service.tracking.measurement import AZIMUTH, RANGE_RATE, predict_measurement
from service.tracking.model import F64, Bool
from service.tracking.start import initial_state, undirected_prior

STD = np.array([0.75, math.radians(0.5), 0.25])
STEPS_S = (0.0, 0.02, 0.05, 0.1, 0.4, 2.0)
STEP_CHANCES = (0.05, 0.1, 0.6, 0.15, 0.05, 0.05)
CANDIDATES = 3
MISSES = 0.5
WILD, NO_DOPPLER, KICKED, STOPPED = 0.2, 0.3, 0.01, 0.5  # shares; of the last, of those that were kicked
LIFE = 400  # frames after which all tracks start again, elsewhere


@dataclass(frozen=True, slots=True)
class Endurance:
    """What became of a filter's tracks; a scan is one track in one frame."""

    scans: int
    not_finite: int
    not_symmetric: int
    not_definite: int
    least_eigenvalue: float  # of the correlation matrices, which have ones on the diagonal

    @property
    def sound(self) -> bool:
        """Tell whether nothing went wrong."""
        return self.not_finite == self.not_symmetric == self.not_definite == 0


def endure(chosen: Filter, scans: int, seed: int, tracks: int = 64) -> Endurance:
    """Return what became of a filter of the road over at least so many scans."""
    rng = np.random.default_rng(seed)
    frames = math.ceil(scans / tracks)
    finite = symmetric = definite = 0
    least = math.inf
    truth, state = _start(chosen, rng, tracks)
    for k in range(frames):
        if k % LIFE == LIFE - 1:
            truth, state = _start(chosen, rng, tracks)
        dt_s = float(rng.choice(STEPS_S, p=STEP_CHANCES))
        truth = _drive(truth, dt_s, rng)
        prediction = chosen.predict(state, dt_s)
        chosen.expected(prediction)
        state = chosen.update(prediction, *_scan(truth, rng))
        sane = np.isfinite(state.mean).all(axis=1) & np.isfinite(state.cov).all(axis=(1, 2))
        sane &= np.isfinite(state.memory).all(axis=1)
        even = (state.cov == state.cov.swapaxes(1, 2)).all(axis=(1, 2))
        smallest = _least_eigenvalues(state.cov, np.asarray(sane))
        finite += int((~sane).sum())
        symmetric += int((~even).sum())
        definite += int((~(smallest > 0.0)).sum())
        least = min(least, float(np.nanmin(smallest, initial=math.inf)))
        if not sane.all():  # one that is lost for good is counted once
            truth, state = _start(chosen, rng, tracks)
    return Endurance(frames * tracks, finite, symmetric, definite, least)


def _start(chosen: Filter, rng: np.random.Generator, tracks: int) -> tuple[F64, FilterState]:
    truth = rng.normal([0, 0, 0, 40, -14, 0], [6, 2, 0, 30, 8, 0], (tracks, 6))
    z = predict_measurement(truth) + STD * rng.standard_normal((tracks, 3))
    R = np.broadcast_to(np.diag(STD**2), (tracks, 3, 3))
    return truth, chosen.start(*initial_state(z, R, undirected_prior()))


def _drive(truth: F64, dt_s: float, rng: np.random.Generator) -> F64:
    """Return the vehicles a while later; now and then one stops or is hit by something."""
    moved = truth.copy()
    moved[:, [0, 3]] += dt_s * truth[:, [1, 4]]
    kick = rng.random(len(truth)) < KICKED
    moving = rng.random((int(kick.sum()), 1)) >= STOPPED
    moved[kick, 1:5:3] = rng.normal(0.0, 10.0, (int(kick.sum()), 2)) * moving
    return moved


def _scan(truth: F64, rng: np.random.Generator) -> tuple[F64, F64, F64, F64]:
    """Return z, R, beta and miss of the vehicles (T, 6)."""
    tracks = len(truth)
    z = np.repeat(predict_measurement(truth)[:, None], CANDIDATES, axis=1)
    wild = rng.random((tracks, CANDIDATES, 1)) < WILD
    z += STD * (1.0 + wild * 10.0 ** rng.uniform(0.0, 3.5, wild.shape)) * rng.standard_normal(z.shape)
    z[..., 0] = np.abs(z[..., 0])
    z[..., AZIMUTH] = np.arctan2(np.sin(z[..., AZIMUTH]), np.cos(z[..., AZIMUTH]))
    z[rng.random(z.shape[:2]) < NO_DOPPLER, RANGE_RATE] = np.nan
    R = np.diag(STD**2) * 10.0 ** rng.uniform(-2.0, 2.0, (tracks, CANDIDATES, 1, 1))
    weights = rng.dirichlet(np.full(CANDIDATES + 1, 0.4), tracks)
    weights[rng.random(tracks) < MISSES] = np.eye(CANDIDATES + 1)[-1]
    beta = weights[:, :CANDIDATES]
    return z, R, beta, 1.0 - beta.sum(axis=1)


def _least_eigenvalues(cov: F64, sane: Bool) -> F64:
    """Return the least eigenvalue of each correlation matrix (T,), NaN where it is not of numbers."""
    variance = np.diagonal(cov, axis1=1, axis2=2)
    usable = sane & (variance > 0.0).all(axis=1)
    scale = 1.0 / np.sqrt(np.where(usable[:, None], variance, 1.0))
    correlation = np.where(usable[:, None, None], scale[:, :, None] * cov * scale[:, None, :], np.eye(6))
    return np.where(usable, np.linalg.eigvalsh(correlation)[:, 0], np.nan)
