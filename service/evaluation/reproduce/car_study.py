"""Follow a vehicle through the four noise environments of the ISRCKF paper: twelve simulated drives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from service.evaluation.monte_carlo import run_filter
from service.evaluation.traffic_study import CAR_DOPPLER, changing, plane_start
from service.simulation.manoeuvres import FOLLOWING_PERIOD_S, following
from service.tracking.filters.base import Filter
from service.tracking.filters.cubature import isrckf, sh_ekf, srckf
from service.tracking.filters.parameters import SageHusaParameters, SrckfParameters
from service.tracking.filters.space import ROAD_COLUMNS, Space, plane
from service.tracking.model import F64

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

    def squared(self, name: str, column: int) -> F64:
        """Return the mean squared error of each run of the twelve drives (12, M) in a column of the state."""
        error = np.square(self.mean[name] - self.truth)[SETTLED:, :, column]
        return np.asarray(error.mean(axis=0).reshape(len(ENVIRONMENTS) * DRIVES, -1))

    def rmse(self, name: str, column: int) -> F64:
        """Return the RMSE of each of the twelve drives in a column of the state (12,)."""
        return np.asarray(np.sqrt(self.squared(name, column).mean(axis=1)))

    def rmse_error(self, name: str, column: int) -> F64:
        """Return the standard error over the runs of each of those (12,)."""
        squared = self.squared(name, column)
        error = squared.std(axis=1, ddof=1) / np.sqrt(squared.shape[1])
        return np.asarray(error / (2.0 * self.rmse(name, column)))


def drive_all(runs: int, seed: Sequence[int], advance: Callable[[str], None]) -> Drives:
    """Return the twelve drives, estimated by every filter of the paper."""
    rng = np.random.default_rng(seed)
    truths, scans, assumed = [], [], []
    for place in ENVIRONMENTS:
        for scale in _ASSUMED:
            truth = following(rng, runs, place.brake_mps2)
            truths.append(truth)
            noise = replace(CAR_DOPPLER.times(place.loudness), outlier_share=place.outliers)
            scans.append(changing(truth, noise, rng))
            believed = CAR_DOPPLER.times(scale).covariance()
            assumed.append(np.broadcast_to(believed, (runs, 3, 3)))
    columns = list(ROAD_COLUMNS)
    truth, z, R = np.concatenate(truths, axis=1), np.concatenate(scans, axis=1), np.concatenate(assumed)
    advance("twelve drives")
    found = {}
    for name, make in MAKERS.items():
        chosen = make(plane(ACCEL_STD_MPS2, doppler=True))
        start = plane_start(chosen, z, R, FOLLOWING_PERIOD_S)
        found[name] = run_filter(chosen, z[1:], R, FOLLOWING_PERIOD_S, start).mean
        advance(name)
    return Drives(truth[1:][..., columns], z[1:], found)
