"""Square-root cubature Kalman filter, and those that estimate their noises: SRCKF, SH-EKF, ISRCKF.

Source: Sensors 2020 ("Motion State Estimation of Target Vehicle under Unknown Time-Varying Noises Based on
Improved Square-Root Cubature Kalman Filter"), eq. 5-19; the estimators are in `sage_husa`. The update goes
through a triangular root by QR (eq. 19). Between updates a bank keeps covariances, as every filter does, and
takes their roots by Cholesky, which spares eq. 11 the root of a Q of rank two that does not exist.
"""

from __future__ import annotations

from service.errors import InvalidInput
from service.tracking.filters.parameters import SageHusaParameters, SrckfParameters
from service.tracking.filters.sage_husa import FADING, MEAN, SAFE, RawEstimator, SafeEstimator
from service.tracking.filters.sigma_points import CUBATURE
from service.tracking.filters.space import Space, road
from service.tracking.filters.space_filter import Adaptation, SpaceFilter


def srckf(p: SrckfParameters, space: Space | None = None) -> SpaceFilter:
    """Return the square-root cubature Kalman filter in a space (None: the road)."""
    space = space or road(p.accel_std_mps2, p.accel_tau_s)
    return SpaceFilter("srckf", space, points=CUBATURE, guard=p, square_root=True)


def isrckf(p: SageHusaParameters, space: Space | None = None) -> SpaceFilter:
    """Return the SRCKF with noise estimation in a space (None: the road)."""
    space = space or road(p.accel_std_mps2, p.accel_tau_s)
    return SpaceFilter("isrckf", space, points=CUBATURE, adaptation=_estimator(p, space), square_root=True)


def sh_ekf(p: SageHusaParameters, space: Space | None = None) -> SpaceFilter:
    """Return the EKF with noise estimation, the rival of the paper, in a space (None: the road)."""
    space = space or road(p.accel_std_mps2, p.accel_tau_s)
    return SpaceFilter("sh-ekf", space, points=None, adaptation=_estimator(p, space))


def _estimator(p: SageHusaParameters, space: Space) -> Adaptation:
    if p.form == SAFE:
        return SafeEstimator(p, space)
    if p.form in {FADING, MEAN}:
        return RawEstimator(p, space)
    raise InvalidInput.at("/filters/form", f"want {SAFE}, {FADING} or {MEAN}, got {p.form!r}")
