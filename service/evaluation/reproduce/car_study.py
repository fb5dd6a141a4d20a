"""Follow a vehicle through the four noise environments of the ISRCKF paper: twelve simulated drives."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from service.evaluation.traffic_study import CAR_DOPPLER, NOISE_LEVELS
from service.simulation.manoeuvres import FOLLOWING_PERIOD_S, following
from service.simulation.point_radar import PointNoise, measure
from service.tracking.filters.base import Filter
from service.tracking.filters.cubature import isrckf, sh_ekf, srckf
from service.tracking.filters.parameters import SageHusaParameters, SrckfParameters
from service.tracking.filters.space import ROAD_COLUMNS, Space, plane
from service.tracking.model import F64
from service.tracking.start import two_point_state, undirected_prior

DRIVES = 3  # in each environment
SETTLED = 50  # frames, two seconds
ACCEL_STD_MPS2 = 4.0
_ASSUMED = (
    1.0,
    1.0,
    3.0,
)  # the standard deviations that the filters of the three drives believe in, relative
AHEAD, AHEAD_RATE = 2, 3  # columns of y and vy in [x vx y vy]

MAKERS: Mapping[str, Callable[[Space], Filter]] = MappingProxyType({
    "SRCKF": lambda s: srckf(SrckfParameters(robust_gate=None), s),
    "SH-EKF": lambda s: sh_ekf(SageHusaParameters(form="mean"), s),
    "ISRCKF": lambda s: isrckf(SageHusaParameters(), s),
    "ISRCKF, literal": lambda s: isrckf(SageHusaParameters(form="fading"), s),
})  # fmt: skip


@dataclass(frozen=True, slots=True)
class Environment:
    """Where a drive takes place; the paper names the four places and gives no numbers."""

    name: str
    loudness: float  # of all standard deviations against the nominal ones
    outliers: float
    brake_mps2: float


ENVIRONMENTS = (
    Environment("underground parking", 1.5, 0.02, 0.0),
    Environment("tunnel", 2.0, 0.05, 0.0),
    Environment("campus", 1.0, 0.0, 0.0),
    Environment("expressway", 1.0, 0.0, 4.0),
)


@dataclass(frozen=True, slots=True)
class Drives:
    """Twelve drives, each driven M times: column (group * M + run)."""

    truth: F64  # (K, 12 M, 4)
    z: F64  # (K, 12 M, 3)
    mean: Mapping[str, F64]  # (K, 12 M, 4)

    def rmse(self, name: str, column: int) -> F64:
        """Return the RMSE of each of the twelve drives in a column of the state (12,)."""
        error = np.square(self.mean[name] - self.truth)[SETTLED:, :, column]
        return np.asarray(np.sqrt(error.mean(axis=0).reshape(len(ENVIRONMENTS) * DRIVES, -1).mean(axis=1)))


def drive_all(runs: int, seed: Sequence[int], advance: Callable[[str], None]) -> Drives:
    """Return the twelve drives, estimated by every filter of the paper."""
    rng = np.random.default_rng(seed)
    truths, scans, assumed = [], [], []
    for place in ENVIRONMENTS:
        for scale in _ASSUMED:
            truth = following(rng, runs, place.brake_mps2)
            truths.append(truth)
            scans.append(_measured(truth, place, rng))
            believed = _scaled(CAR_DOPPLER, scale).covariance()
            assumed.append(np.broadcast_to(believed, (runs, 3, 3)))
    columns = list(ROAD_COLUMNS)
    truth, z, R = np.concatenate(truths, axis=1), np.concatenate(scans, axis=1), np.concatenate(assumed)
    advance("twelve drives")
    found = {}
    for name, make in MAKERS.items():
        found[name] = _estimate(make(plane(ACCEL_STD_MPS2, doppler=True)), z, R)
        advance(name)
    return Drives(truth[1:][..., columns], z[1:], found)


def _measured(truth: F64, place: Environment, rng: np.random.Generator) -> F64:
    """Return measurements with 1, 4, 9 and 1 times the place's variances, a quarter of the drive each."""
    parts = np.array_split(truth, len(NOISE_LEVELS))
    noises = [
        replace(_scaled(CAR_DOPPLER, place.loudness * math.sqrt(level)), outlier_share=place.outliers)
        for level in NOISE_LEVELS
    ]
    return np.concatenate([measure(t, n, rng) for t, n in zip(parts, noises, strict=True)])


def _scaled(noise: PointNoise, by: float) -> PointNoise:
    velocity = noise.velocity_std_mps
    return replace(
        noise,
        range_std_m=by * noise.range_std_m,
        azimuth_std_rad=by * noise.azimuth_std_rad,
        velocity_std_mps=None if velocity is None else by * velocity,
    )


def _estimate(chosen: Filter, z: F64, R: F64) -> F64:
    """Return the means (K - 1, N, 4) from the second scan on; each track has its own R (N, 3, 3)."""
    mean, cov = two_point_state(z[0], R, z[1], R, dt_s=FOLLOWING_PERIOD_S, prior=undirected_prior())
    columns = list(ROAD_COLUMNS)
    state = chosen.start(mean[:, columns], cov[:, columns][:, :, columns])
    out = np.empty((len(z) - 1, len(R), len(columns)))
    out[0] = state.mean
    ones, zeros = np.ones((len(R), 1)), np.zeros(len(R))
    for k in range(2, len(z)):
        prediction = chosen.predict(state, FOLLOWING_PERIOD_S)
        state = chosen.update(prediction, z[k, :, None], R[:, None], ones, zeros)
        out[k - 1] = state.mean
    return out
