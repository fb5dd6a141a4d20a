"""Track several points by JPDA, with and without the guarded FIR reset, and count the lost tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from service.simulation.crossing_vehicles import NOISE, PERIOD_S, SCENES, observe, surroundings
from service.tracking.association import marginals
from service.tracking.filters.converted import Returns, distances, located, planar_step
from service.tracking.filters.fir import FEWEST, fit_window
from service.tracking.filters.single_target import weighted_update
from service.tracking.model import F64, I64, Bool
from service.tracking.recovery import RecoveryParameters, Reset, Scan, Trail, find_resets, nearest, no_trail

LOST_M = 5.0  # a track further from its vehicle at the end is lost
OTHER_M = 2.0  # a track, or a reset, so near to another vehicle and not to its own is on that one
_WIDEN_AFTER, _WIDEN_MPS2, _WIDEN_MPS = 2, 5.0, 3.0


@dataclass(frozen=True, slots=True)
class Method:
    """How tracks are kept."""

    recovery: RecoveryParameters = field(default_factory=RecoveryParameters)
    widen: bool = False  # grow the covariance while the gate is empty
    naive: bool = False  # the paper's rule: reset at the first empty gate by the nearest returns of anyone


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What the radar sees besides."""

    accel_std_mps2: float = 2.0
    density_per_m2: float = 2e-3
    detection: float = 0.9
    gate: float = 9.21
    gate_probability: float = 0.99


@dataclass(frozen=True, slots=True)
class Outcome:
    """Counts of one run."""

    lost: int
    switched: int  # tracks that end on another vehicle
    resets: int
    beside_another: int  # resets nearer to another vehicle than to their own
    squared_m2: float  # mean squared position error of the tracks held to the end; NaN: none


@dataclass(slots=True)
class _Bank:
    mean: F64  # (T, 4)
    cov: F64
    empty: I64
    trail: Trail


def run(scene: str, method: Method, around: Surroundings, rng: np.random.Generator) -> Outcome:
    """Return what became of the tracks of one run, started at the truth."""
    truth = SCENES[scene]()
    box = surroundings(truth)
    bank = _start(truth[0], method.recovery)
    resets, beside, squared = 0, 0, np.zeros(truth.shape[:2])
    for k in range(1, len(truth)):
        z = observe(truth[k], box, around.density_per_m2, around.detection, rng)
        done = _step(bank, located(z[np.isfinite(z[:, 0])], NOISE), method, around)
        resets += len(done)
        beside += sum(_beside_another(r, truth[k]) for r in done)
        squared[k] = np.sum((bank.mean[:, :2] - truth[k, :, :2]) ** 2, axis=1)
    gap = np.linalg.norm(bank.mean[:, None, :2] - truth[-1][None, :, :2], axis=-1)
    own = np.diagonal(gap)
    lost = own > LOST_M
    on_other = (gap.argmin(axis=1) != np.arange(len(gap))) & (gap.min(axis=1) < OTHER_M) & (own > OTHER_M)
    held = squared[1:, ~lost]
    return Outcome(
        int((lost | on_other).sum()), int(on_other.sum()), resets, beside,
        float(held.mean()) if held.size else float("nan"),
    )  # fmt: skip


def repeat(scene: str, method: Method, around: Surroundings, runs: int, seed: Sequence[int]) -> list[Outcome]:
    """Return the outcomes of `runs` runs; equal seeds give equal scans to every method."""
    return [run(scene, method, around, np.random.default_rng((*seed, k))) for k in range(runs)]


def _start(states: F64, p: RecoveryParameters) -> _Bank:
    cov = np.broadcast_to(np.diag([0.3**2, 0.3**2, 1.0, 1.0]), (len(states), 4, 4)).copy()
    return _Bank(states.copy(), cov, np.zeros(len(states), np.int64), no_trail((len(states),), p.horizon))


def _step(bank: _Bank, returns: Returns, method: Method, around: Surroundings) -> list[Reset]:
    p = method.recovery
    A, Q = planar_step(PERIOD_S, around.accel_std_mps2)
    mean, cov = bank.mean @ A.T, A @ bank.cov @ A.T + Q
    each = Returns(returns.z[None], returns.R[None])
    e, S_inv, det, d2 = distances(mean, cov, each)
    gated = d2 <= around.gate
    beta = _probabilities(d2, det, gated, around)
    bank.mean, bank.cov = weighted_update(mean, cov, e, S_inv, beta)
    bank.empty = np.where(gated.any(axis=1), 0, bank.empty + 1)
    claimed = beta >= p.claim
    done = _resets(bank, returns, claimed, method)
    for r in done:
        one = Returns(returns.z[None, r.by : r.by + 1], returns.R[None, r.by : r.by + 1])
        e, S_inv, _, _ = distances(r.mean[None], r.cov[None], one)
        m, c = weighted_update(r.mean[None], r.cov[None], e, S_inv, np.ones((1, 1)))
        bank.mean[r.track], bank.cov[r.track], claimed[r.track, r.by] = m[0], c[0], True
    others = claimed.sum(axis=0)[None, :] - claimed > 0
    others &= not method.naive
    which, seen = nearest(bank.mean, bank.cov, each, ~others, p)
    which = which if returns.z.size else np.zeros_like(which)
    z = returns.z[which] if len(returns.z) else np.zeros((len(which), 2))
    R = returns.R[which] if len(returns.z) else np.broadcast_to(np.eye(2), (len(which), 2, 2))
    bank.trail = bank.trail.push(z, R, seen, bank.empty > 0)
    reset = [r.track for r in done]
    bank.empty[reset] = 0
    if method.widen:
        late = bank.empty >= _WIDEN_AFTER
        bank.cov[late] += np.diag([(_WIDEN_MPS2 * PERIOD_S) ** 2] * 2 + [_WIDEN_MPS**2] * 2)
    return done


def _resets(bank: _Bank, returns: Returns, claimed: Bool, method: Method) -> list[Reset]:
    p = method.recovery
    if not p.enabled:
        return []
    if method.naive:
        return _naive_resets(bank, p)
    each = Returns(returns.z[None], returns.R[None])
    free = np.asarray(~claimed.any(axis=0))
    firm = np.ones(len(bank.mean), np.bool_)
    return find_resets(Scan(bank.mean, bank.cov, bank.empty, firm, bank.trail, each, free, PERIOD_S), p)


def _naive_resets(bank: _Bank, p: RecoveryParameters) -> list[Reset]:
    fit = fit_window(bank.trail.window, PERIOD_S, p.accel_std_mps2)
    for t in np.flatnonzero((bank.empty == 1) & (fit.count >= FEWEST)):
        bank.mean[t], bank.cov[t] = fit.mean[t], fit.cov[t]
        bank.empty[t] = 0
    return []


def _probabilities(d2: F64, det: F64, gated: Bool, around: Surroundings) -> F64:
    log_weight = np.log(around.detection / around.density_per_m2 / (2 * np.pi)) - 0.5 * (d2 + np.log(det))
    none = np.full(len(d2), np.log(1.0 - around.detection * around.gate_probability))
    return marginals(np.where(gated, log_weight, -np.inf), none).beta


def _beside_another(reset: Reset, truth: F64) -> bool:
    gap = np.linalg.norm(truth[:, :2] - reset.mean[:2], axis=-1)
    return bool(gap.argmin() != reset.track and gap.min() < OTHER_M)
