"""Single targets in clutter by converted measurements: range and azimuth become x and y with a covariance.

The state is [x y vx vy] in the plan frame (azimuth clockwise from +y), the model white acceleration that is
constant within a step. Leading dimensions are batch dimensions, J is the number of returns of a scan.

Source: Pak 2021, "Hybrid PDA/FIR Filtering for Preceding Vehicle Tracking Using Automotive Radars" (the
"HPFF paper"), eq. 4-13; conversion and its limit: Bar-Shalom, Willett, Tian 2011, section 1.6.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from service.tracking.geometry import plan_covariance, plan_to_polar, polar_to_plan
from service.tracking.model import F64

PLANAR_STATES = 4
CONVERSION_LIMIT = 0.4  # r sigma_azimuth^2 / sigma_r; beyond it the converted noise is biased (eq. 6)


class ConversionInaccurate(UserWarning):
    """The noise of a range and azimuth is too bent in x and y for its covariance to describe."""


@dataclass(frozen=True, slots=True)
class PolarNoise:
    """The standard deviations of one return; the defaults are those of the HPFF paper."""

    range_std_m: float = 0.25
    azimuth_std_rad: float = float(np.deg2rad(1.5))


@dataclass(frozen=True, slots=True)
class Returns:
    """The returns of one scan for each member of a batch; NaN rows are padding."""

    z: F64  # (..., J, 2) x, y [m]
    R: F64  # (..., J, 2, 2), the identity where z is NaN


def conversion_index(range_m: F64, noise: PolarNoise) -> F64:
    """Return r sigma_azimuth^2 / sigma_r, which should stay below 0.4.

    The paper's eq. 6 prints sigma_r^2 below the line, which has no unit that fits; the textbook has sigma_r.
    """
    return np.asarray(range_m * noise.azimuth_std_rad**2 / noise.range_std_m)


def convert(range_m: F64, azimuth_rad: F64, noise: PolarNoise) -> Returns:
    """Return the plan positions (..., J, 2) of polar returns (..., J), NaN for none (eq. 4, 5).

    Warns `ConversionInaccurate` when a return breaks the condition of eq. 6.
    """
    there = np.isfinite(range_m) & np.isfinite(azimuth_rad)
    worst = float(conversion_index(np.where(there, range_m, 0.0), noise).max(initial=0.0))
    if worst >= CONVERSION_LIMIT:
        warnings.warn(
            f"range x azimuth variance / range std is {worst:.2f}, want below {CONVERSION_LIMIT}: "
            "converted positions are biased at that distance",
            ConversionInaccurate,
            stacklevel=2,
        )
    r, az = np.where(there, range_m, 1.0), np.where(there, azimuth_rad, 0.0)
    polar = np.diag([noise.range_std_m**2, noise.azimuth_std_rad**2])
    z = np.stack(polar_to_plan(r, az), axis=-1)
    R = np.where(there[..., None, None], plan_covariance(r, az, polar), np.eye(2))
    return Returns(np.where(there[..., None], z, np.nan), R)


def located(z: F64, noise: PolarNoise) -> Returns:
    """Return returns given by their plan positions (..., J, 2); see `convert`."""
    return convert(*plan_to_polar(z[..., 0], z[..., 1]), noise)


def planar_step(dt_s: float, accel_std_mps2: float) -> tuple[F64, F64]:
    """Return A (4, 4) and G Q G' (4, 4) of one step (eq. 7; eq. 11 leaves G out)."""
    A = np.eye(PLANAR_STATES)
    A[0, 2] = A[1, 3] = dt_s
    G = np.vstack([np.eye(2) * dt_s * dt_s / 2, np.eye(2) * dt_s])
    return A, accel_std_mps2**2 * (G @ G.T)


def two_point_difference(first: Returns, second: Returns, dt_s: float) -> tuple[F64, F64]:
    """Return mean (..., 4) and cov (..., 4, 4) from the only return of each of two scans (J = 1)."""
    z1, z2, R1, R2 = first.z[..., 0, :], second.z[..., 0, :], first.R[..., 0, :, :], second.R[..., 0, :, :]
    mean = np.concatenate([z2, (z2 - z1) / dt_s], axis=-1)
    cov = np.empty((*mean.shape, PLANAR_STATES))
    cov[..., :2, :2] = R2
    cov[..., :2, 2:] = cov[..., 2:, :2] = R2 / dt_s
    cov[..., 2:, 2:] = (R1 + R2) / dt_s**2
    return mean, cov


def invert_pairs(S: F64) -> tuple[F64, F64]:
    """Return the inverse (..., 2, 2) and the determinant (...) of stacked symmetric 2 x 2 matrices."""
    a, b, d = S[..., 0, 0], S[..., 0, 1], S[..., 1, 1]
    det = a * d - b * b
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=-2)
    return adjugate / det[..., None, None], det


def distances(mean: F64, cov: F64, returns: Returns) -> tuple[F64, F64, F64, F64]:
    """Return e (..., J, 2), S^-1 (..., J, 2, 2), |S| and d2 (..., J) of all returns; d2 is inf for padding.

    S is C P C' + R of each return (eq. 12, 13).
    """
    S_inv, det = invert_pairs(cov[..., None, :2, :2] + returns.R)
    e = np.nan_to_num(returns.z - mean[..., None, :2])
    y0 = S_inv[..., 0, 0] * e[..., 0] + S_inv[..., 0, 1] * e[..., 1]
    y1 = S_inv[..., 1, 0] * e[..., 0] + S_inv[..., 1, 1] * e[..., 1]
    d2 = y0 * e[..., 0] + y1 * e[..., 1]
    return e, S_inv, det, np.where(np.isfinite(returns.z[..., 0]), d2, np.inf)
