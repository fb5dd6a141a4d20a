"""Interacting multiple models: several filters of one state, weighed by how well each predicts.

A vehicle cruises, accelerates or turns, and a filter that is right for one is too soft or too stiff for
another. Each model filters on its own; before each step their estimates are mixed by the chance that the
vehicle changed from one to another (Blom and Bar-Shalom 1988; Bar-Shalom, Li, Kirubarajan 2001, section
11.6).

Outliers are judged by the model that explains a measurement best, and by all models alike: a gate for each
model would let the one for cruising reject a braking vehicle, and lose it. After some rejected frames in a
row the next measurement is taken as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from service.tracking.filters.base import Expected, FilterState, Prediction
from service.tracking.filters.correction import Innovations, symmetric
from service.tracking.filters.parameters import ImmParameters
from service.tracking.filters.robust import LEAST_WEIGHT, REJECTED, Guard
from service.tracking.filters.sigma_points import Linearised, NonlinearStep, cholesky
from service.tracking.filters.space import ROAD_AXES, ROAD_SENSOR, Space, road, steady_road
from service.tracking.filters.space_filter import OWN, SpaceFilter
from service.tracking.filters.weighted import differences, own, project, weigh_scan
from service.tracking.model import F64
from service.tracking.motion import constant_acceleration

LEAST_PROBABILITY = 1e-4  # of a model: it can always come back within a few frames
SLOWEST_TURN_MPS = 2.0  # the turn rate of anything slower is not told from its noise


@dataclass(frozen=True, slots=True)
class Mixture:
    """The models of T tracks: what the memory of an IMM holds."""

    probability: F64  # (..., M)
    parts: tuple[Prediction, ...]  # each model's; after an update its noise is zero

    def moments(self) -> tuple[F64, F64]:
        """Return the mean (..., n) and covariance (..., n, n) of the mixture."""
        return mix(self.probability, [part.mean for part in self.parts], [part.cov for part in self.parts])

    def moved_to(self, mean: F64, cov: F64) -> Mixture:
        """Return the mixture with these moments, where they are not those that it has.

        Between frames the tracker learns of the vehicle's shape and heading, and changes the estimate. The
        models follow by the affine map x' = mean + A (x - m), A C A' = cov, from the moments m, C that they
        had.
        """
        m, C = self.moments()
        other = (mean != m).any(axis=-1) | (cov != C).any(axis=(-2, -1))
        if not other.any():
            return self
        A = np.linalg.solve(cholesky(C).swapaxes(-1, -2), cholesky(cov).swapaxes(-1, -2)).swapaxes(-1, -2)
        parts = []
        for part in self.parts:
            moved = mean + (A @ (part.mean - m)[..., None])[..., 0]
            spread, zero = symmetric(A @ part.cov @ A.swapaxes(-1, -2)), np.zeros_like(C)
            parts.append(
                Prediction(
                    np.where(other[..., None], moved, part.mean),
                    np.where(other[..., None, None], spread, part.propagated),
                    np.where(other[..., None, None], zero, part.noise),
                    part.memory,
                )
            )
        return Mixture(self.probability, tuple(parts))


@dataclass(frozen=True, slots=True)
class Imm:
    """Several filters of one space, of equal state and sensor; see `base.Filter` for what it does.

    Its predictions hold the noises of the models in `propagated`; what a caller adds as `noise` goes to each.
    """

    name: str
    models: tuple[SpaceFilter, ...]
    transition: Callable[[float], F64]  # time step [s] -> (M, M) chance of going from row to column
    states: int
    guard: Guard

    @property
    def memory_size(self) -> int:
        """Columns: rejected frames; per model its probability, mean, two covariances and memory."""
        n = self.states
        return OWN + sum(1 + n + 2 * n * n + model.memory_size for model in self.models)

    def start(self, mean: F64, cov: F64) -> FilterState:
        """Return new tracks, all models alike and equally probable."""
        many, cov = len(self.models), symmetric(cov)
        noise = np.zeros_like(cov)
        lead = mean.shape[:-1]
        parts = tuple(
            Prediction(mean, cov, noise, np.zeros((*lead, model.memory_size))) for model in self.models
        )
        memory = self._packed(np.zeros(lead), Mixture(np.full((*lead, many), 1.0 / many), parts))
        return FilterState(mean.astype(np.float64), cov, memory)

    def predict(self, state: FilterState, dt_s: float) -> Prediction:
        """Return the tracks moved `dt_s` seconds ahead, each model after mixing."""
        before = self.unpacked(state.memory).moved_to(state.mean, state.cov)
        change = self.transition(dt_s)
        joint = before.probability[..., :, None] * change  # (..., from, to)
        probability = joint.sum(axis=-2)
        means, covs = [part.mean for part in before.parts], [part.cov for part in before.parts]
        parts = []
        for to, model in enumerate(self.models):
            mixed = mix(joint[..., to] / probability[..., to, None], means, covs)
            part = model.predict(FilterState(*mixed, before.parts[to].memory), dt_s)
            noise = np.broadcast_to(part.noise, part.propagated.shape)
            parts.append(Prediction(part.mean, part.propagated, noise, part.memory))
        after = Mixture(probability, tuple(parts))
        mean, cov = after.moments()
        memory = self._packed(state.memory[..., REJECTED], after)
        return Prediction(mean, cov, np.zeros((self.states, self.states)), memory)

    def expected(self, prediction: Prediction) -> Expected:
        """Return the expected measurement of each predicted track, as of one Gaussian."""
        ours = own(prediction)
        seen = self.models[0].see(ours.mean, ours.cov)
        return Expected(seen.z_hat, seen.H, project(seen.H, ours.cov) + seen.omega)

    def update(self, prediction: Prediction, z: F64, R: F64, beta: F64, miss: F64) -> FilterState:
        """Return the tracks after the measurements of the frame."""
        ours = own(prediction)
        before, sensor = self.unpacked(ours.memory), self.models[0].space.sensor
        parts, seen = [], []
        for model, part in zip(self.models, before.parts, strict=True):
            wide = Prediction(part.mean, part.propagated, part.noise + ours.noise, part.memory)
            parts.append(wide)
            seen.append(model.see(wide.mean, wide.cov))
        first = weigh_scan(sensor, z, R, beta, miss, z_hat=seen[0].z_hat)
        scans = [first]
        for view in seen[1:]:
            e = differences(sensor, z, first.measured, view.z_hat)
            scans.append(Innovations(e, first.R, first.measured, first.beta, first.miss))
        count = ours.memory[..., REJECTED].copy()
        fits = [_nis(part, view, i) for part, view, i in zip(parts, seen, scans, strict=True)]
        growth, count = self._growth([nis for nis, _ in fits], scans[0].beta, count)
        if np.any(growth != 1.0):
            scans = [_grown(i, growth) for i in scans]
            fits = [_nis(part, view, i) for part, view, i in zip(parts, seen, scans, strict=True)]
        fit = evidence(before.probability, fits, scans[0])
        states = [
            model.update_seen(part, view, i)
            for model, part, view, i in zip(self.models, parts, seen, scans, strict=True)
        ]
        probability = np.maximum(before.probability * fit, LEAST_PROBABILITY)
        probability = np.where((1.0 - miss > 0.0)[..., None], probability, before.probability)
        probability = probability / probability.sum(axis=-1, keepdims=True)
        zero = np.zeros_like(ours.propagated)
        after = Mixture(probability, tuple(Prediction(s.mean, s.cov, zero, s.memory) for s in states))
        mean, cov = after.moments()
        heard = np.asarray(beta.sum(axis=-1) > 0.0)
        mean = np.where(heard[..., None], mean, ours.mean)
        cov = np.where(heard[..., None, None], cov, symmetric(ours.cov))
        memory = np.where(heard[..., None], self._packed(count, after), ours.memory)
        return FilterState(mean, cov, memory)

    def unpacked(self, memory: F64) -> Mixture:
        """Return the models that a memory (..., memory_size) holds."""
        many, n, lead = len(self.models), self.states, memory.shape[:-1]
        at, parts = OWN + many, []
        for model in self.models:
            cov_at, noise_at = at + n, at + n + n * n
            kept_at, end = noise_at + n * n, noise_at + n * n + model.memory_size
            cov = memory[..., cov_at:noise_at].reshape(*lead, n, n)
            noise = memory[..., noise_at:kept_at].reshape(*lead, n, n)
            parts.append(
                Prediction(memory[..., at:cov_at].copy(), cov, noise, memory[..., kept_at:end].copy())
            )
            at = end
        return Mixture(memory[..., OWN : OWN + many], tuple(parts))

    def _packed(self, count: F64, mixture: Mixture) -> F64:
        lead, columns = count.shape, [count[..., None], mixture.probability]
        for part in mixture.parts:
            flat = (m.reshape(*lead, self.states**2) for m in (part.propagated, part.noise))
            columns.extend((part.mean, *flat, part.memory))
        return np.concatenate(columns, axis=-1)

    def _growth(self, each: list[F64], beta: F64, count: F64) -> tuple[F64, F64]:
        """Return by how much each R (..., J) grows, and the rejected frames in a row (...).

        A measurement is an outlier when it is one for every model; each: their NIS (..., J).
        """
        gate, release = self.guard.robust_gate, self.guard.gate_release_frames
        if gate is None:
            return np.ones(beta.shape), count
        nis = np.min(each, axis=0)
        outside = (nis > gate) & (beta > 0.0)
        kept = np.ones(count.shape, np.bool_) if release is None else count < release
        growth = np.where(outside & kept[..., None], nis / gate, 1.0) ** 2
        weight, refused = beta.sum(axis=-1), (beta * outside).sum(axis=-1)
        counted = np.where(refused > weight / 2.0, count + 1.0, 0.0)
        return growth, np.where(weight > LEAST_WEIGHT, counted, count)


def mix(weights: F64, means: list[F64], covs: list[F64]) -> tuple[F64, F64]:
    """Return the moments of a mixture: weights (..., M), means (..., n), covariances (..., n, n)."""
    mean, cov = np.zeros_like(means[0]), np.zeros_like(covs[0])
    for m, x in enumerate(means):
        mean += weights[..., m, None] * x
    for m, (x, C) in enumerate(zip(means, covs, strict=True)):
        off = x - mean
        cov += weights[..., m, None, None] * (C + off[..., :, None] * off[..., None, :])
    return mean, symmetric(cov)


def evidence(probability: F64, fits: list[tuple[F64, F64]], i: Innovations) -> F64:
    """Return the likelihood (..., M) of each model, relative to that of the mixture.

    fits: e' S^-1 e and log det S (..., J) of each model; of the innovations only the probabilities count.

    miss + sum_j beta_j N(e_j; 0, S_j) / sum_m mu_m N_m: the association probabilities of the mixture are
    turned into those of the model.
    """
    log = np.stack([-0.5 * (nis + log_det) for nis, log_det in fits], axis=-2)  # (..., M, J)
    density = np.exp(log - log.max(axis=-2, keepdims=True))
    total = (probability[..., None] * density).sum(axis=-2)
    share = density / np.maximum(total, np.finfo(np.float64).tiny)[..., None, :]
    return np.asarray(i.miss[..., None] + (i.beta[..., None, :] * share).sum(axis=-1))


def _nis(part: Prediction, seen: Linearised, i: Innovations) -> tuple[F64, F64]:
    """Return e' S^-1 e and log det S (..., J) over the measured channels."""
    pair = i.measured[..., :, None] & i.measured[..., None, :]
    S = project(seen.H, part.cov) + seen.omega
    S = np.where(pair, S[..., None, :, :] + i.R, np.eye(S.shape[-1]))
    y = np.linalg.solve(S, i.e[..., None])[..., 0]
    return (i.e * y).sum(axis=-1), np.asarray(np.linalg.slogdet(S)[1])


def _grown(i: Innovations, growth: F64) -> Innovations:
    return Innovations(i.e, growth[..., None, None] * i.R, i.measured, i.beta, i.miss)


def sojourns(*seconds: float) -> Callable[[float], F64]:
    """Return the transitions of models that last so long on average and then change to any other."""

    def transition(dt_s: float) -> F64:
        stay = np.exp(-dt_s / np.array(seconds))
        leave = (1.0 - stay) / (len(seconds) - 1)
        return np.asarray(np.diag(stay - leave) + leave[:, None])

    return transition


def turn(states: F64, dt_s: float) -> F64:
    """Return the states [x vx ax y vy ay] after a turn at their own rate, (vx ay - vy ax) / v^2.

    The acceleration across the velocity turns the velocity; that along it is dropped.
    """
    x, vx, ax, y, vy, ay = np.moveaxis(states, -1, 0)
    squared = np.maximum(vx * vx + vy * vy, SLOWEST_TURN_MPS**2)
    rate = (vx * ay - vy * ax) / squared
    angle = rate * dt_s
    s, c = np.sin(angle), np.cos(angle)
    small = np.abs(angle) < 1e-6  # noqa: PLR2004 - the series is exact to rounding below
    safe = np.where(small, 1.0, rate)
    along, across = np.where(small, dt_s, s / safe), np.where(small, 0.5 * dt_s * angle, (1.0 - c) / safe)
    wx, wy = c * vx - s * vy, s * vx + c * vy
    moved = (x + along * vx - across * vy, wx, -rate * wy, y + across * vx + along * vy, wy, rate * wx)
    return np.stack(moved, axis=-1)


def imm(p: ImmParameters) -> Imm:
    """Return the IMM of the road: constant velocity, damped constant acceleration, constant turn."""
    turning = Space(
        lambda dt_s: NonlinearStep(
            lambda states: turn(states, dt_s), constant_acceleration(dt_s, p.turn_std_mps2).Q
        ),
        ROAD_SENSOR,
        ROAD_AXES,
    )
    spaces = {
        "cv": steady_road(p.velocity_density_m2ps3),
        "ca": road(p.accel_std_mps2, p.accel_tau_s),
        "ct": turning,
    }
    models = tuple(SpaceFilter(name, space, points=None) for name, space in spaces.items())
    return Imm("imm", models, sojourns(p.cruise_s, p.accelerate_s, p.turn_s), 6, p)
