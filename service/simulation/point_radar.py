"""Polar measurements of single points with noise, outliers and misses: the radar of the filter studies.

For whole scenes with clutter, shadows and extended vehicles this is not meant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from service.tracking.geometry import wrap_angle
from service.tracking.measurement import AZIMUTH, RANGE_RATE, predict_measurement
from service.tracking.model import F64

CERTAIN_FRAMES = 2  # a track starts from two true measurements; who finds them is not the filter's business


@dataclass(frozen=True, slots=True)
class PointNoise:
    """Standard deviations and defects; the defaults are those of Electronics 2024, 13, 652."""

    range_std_m: float = 0.75
    azimuth_std_rad: float = math.radians(0.5)
    velocity_std_mps: float | None = None  # None: no Doppler
    outlier_share: float = 0.0
    outlier_sigmas: float = 10.0
    miss_share: float = 0.0

    def covariance(self) -> F64:
        """Return R (3, 3); without Doppler its last variance is 1 and means nothing."""
        velocity = 1.0 if self.velocity_std_mps is None else self.velocity_std_mps
        return np.diag(np.square([self.range_std_m, self.azimuth_std_rad, velocity]))

    def times(self, by: float) -> PointNoise:
        """Return the noise with `by` times its standard deviations."""
        velocity = self.velocity_std_mps
        return replace(
            self,
            range_std_m=by * self.range_std_m,
            azimuth_std_rad=by * self.azimuth_std_rad,
            velocity_std_mps=None if velocity is None else by * velocity,
        )


def measure(truth: F64, noise: PointNoise, rng: np.random.Generator) -> F64:
    """Return a measurement (K, N, 3) of each state (K, N, 6): range, azimuth, range rate.

    A missed frame is all NaN, a range rate not measured NaN. An outlier has all its channels off by
    `outlier_sigmas` standard deviations, each to a random side. The first two frames have neither.
    """
    std = np.sqrt(np.diag(noise.covariance()))
    z = predict_measurement(truth)
    z += std * rng.standard_normal(z.shape)
    shape = truth.shape[:2]
    later = (np.arange(shape[0]) >= CERTAIN_FRAMES)[:, None]
    outlier = (rng.random(shape) < noise.outlier_share) & later
    side = np.where(rng.random(z.shape) < 0.5, -1.0, 1.0)  # noqa: PLR2004 - either side
    z += np.where(outlier[..., None], noise.outlier_sigmas * std * side, 0.0)
    z[..., AZIMUTH] = wrap_angle(z[..., AZIMUTH])
    if noise.velocity_std_mps is None:
        z[..., RANGE_RATE] = np.nan
    z[(rng.random(shape) < noise.miss_share) & later] = np.nan
    return z
