"""Turn the points of the last frames into clusters: one for each vehicle candidate."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from service.errors import InvalidInput
from service.tracking.clustering_kernels import ROUNDING, density_clusters, move_on, scale, split_clusters
from service.tracking.clustering_parameters import ClusteringParameters
from service.tracking.kernel import ready
from service.tracking.model import F64, I64

_NO_ROAD = np.full((1, 2), np.nan)


def cluster_window(  # noqa: PLR0913 - columns of the points
    *,
    x_m: F64,
    y_m: F64,
    radial_velocity_mps: F64,
    age_s: F64,
    azimuth_std_rad: F64,
    weights: F64,
    road_direction: F64 | None,
    parameters: ClusteringParameters,
) -> I64:
    """Return the cluster (N,) of each point of a window, -1 for noise.

    x_m, y_m: (N,) plan position as measured.  radial_velocity_mps: (N,) in the plan, NaN where unknown.
    age_s: (N,) time since the point was measured.  azimuth_std_rad: (N,).  weights: (N,) evidence of each
    point; 1 is a point of ordinary strength.  road_direction: (2,) unit vector along the road, either way, or
    None.
    """
    x_m, y_m, radial_velocity_mps = ready(x_m), ready(y_m), ready(radial_velocity_mps)
    x_m, y_m = compensate(x_m, y_m, radial_velocity_mps, age_s, road_direction, parameters)
    along_m, across_m = road_axes(x_m, y_m, road_direction)
    range_m = np.hypot(x_m, y_m)
    scaled = features(along_m, across_m, range_m, radial_velocity_mps, age_s, azimuth_std_rad, parameters)
    labels = dbscan(scaled, weights, parameters.min_points, engine=parameters.engine)
    return split_lateral(labels, across_m, range_m, azimuth_std_rad, parameters)


def compensate(  # noqa: PLR0913, PLR0917 - columns of the points
    x_m: F64,
    y_m: F64,
    radial_velocity_mps: F64,
    age_s: F64,
    road_direction: F64 | None,
    parameters: ClusteringParameters,
) -> tuple[F64, F64]:
    """Return x and y (N,) of each point at age 0, moved on by its Doppler; points without Doppler stay.

    With a road direction, (2,) or one for each point (N, 2), the point moves along the road at the speed
    whose radial part is its Doppler; without, along its line of sight.
    """
    moved = np.empty((2, len(x_m)))
    road = _NO_ROAD if road_direction is None else ready(road_direction).reshape(-1, 2)
    move_on(
        ready(x_m), ready(y_m), ready(radial_velocity_mps), ready(age_s), road,
        float(parameters.compensation_min_cosine), moved,
    )  # fmt: skip
    return moved[0], moved[1]


def road_axes(x_m: F64, y_m: F64, road_direction: F64 | None) -> tuple[F64, F64]:
    """Return how far along and across the road (N,) points lie; without a direction the road runs forward."""
    if road_direction is None:
        return y_m, x_m
    along_x, along_y = road_direction
    return x_m * along_x + y_m * along_y, x_m * along_y - y_m * along_x


def features(  # noqa: PLR0913, PLR0917 - columns of the points
    along_m: F64,
    across_m: F64,
    range_m: F64,
    radial_velocity_mps: F64,
    age_s: F64,
    azimuth_std_rad: F64,
    parameters: ClusteringParameters,
) -> F64:
    """Return (N, 4) along, across, Doppler and age, each in units of its neighbourhood's radius.

    The scales vary with range only, and slowly, so that the Euclidean distance stays the weighted one; the
    azimuth noise enters by its median. A point of unknown Doppler takes that of the nearest point which has
    one; where nobody has one, Doppler separates nothing and the along radius is the middle of its limits.
    """
    p, doppler = parameters, ready(radial_velocity_mps)
    scaled = np.empty((len(doppler), 4))
    with_doppler = scale(
        ready(along_m), ready(across_m), ready(range_m), doppler, ready(age_s), ready(azimuth_std_rad),
        (float(p.eps_along_offset_m), float(p.eps_along_slope_s), float(p.eps_along_min_m),
         float(p.eps_along_max_m), float(p.eps_along_growth_per_m), float(p.eps_across_m),
         float(p.eps_across_noise), float(p.eps_doppler_mps), float(p.eps_age_s)),
        scaled,
    )  # fmt: skip
    if 0 < with_doppler < len(doppler):
        known = np.isfinite(doppler)
        rest = [0, 1, 3]
        nearest = cKDTree(scaled[known][:, rest]).query(scaled[~known][:, rest])[1]
        scaled[~known, 2] = scaled[known, 2][nearest]
    return scaled


def dbscan(features: F64, weights: F64, min_weight: float, *, engine: str = "numba") -> I64:
    """Return the cluster (N,) of each point, numbered by first point, -1 for noise: DBSCAN with radius 1.

    features: (N, 4), finite; distances are Euclidean and a distance of 1 is inside.  weights: (N,).  A point
    is core when the weights within its radius, its own included, reach min_weight.  A border point joins its
    nearest core point's cluster (with the engine "scikit-learn" any that it touches), so that the order of
    the points changes the numbers only.
    """
    features, weights = ready(features), ready(weights)
    if features.shape != (len(weights), 4) or not np.isfinite(features).all():
        raise InvalidInput.at("/features", f"want (N, 4) finite numbers for {len(weights)} weights")
    if engine == "scikit-learn":
        return _dbscan_of_scikit_learn(features, weights, min_weight)
    labels = np.empty(len(features), np.int64)
    density_clusters(features, weights, float(min_weight), labels)
    return labels


def _dbscan_of_scikit_learn(features: F64, weights: F64, min_weight: float) -> I64:
    from sklearn.cluster import DBSCAN  # noqa: PLC0415 - a second of import time, for the reference only

    if len(features) == 0:
        return np.empty(0, np.int64)
    # Its limit must be a whole number, so the weights are scaled to the limit 1, and up by what scaling
    # rounds off.
    found = DBSCAN(eps=1.0, min_samples=1).fit(
        features, sample_weight=weights * (1.0 + ROUNDING) / min_weight
    )
    labels: I64 = found.labels_.astype(np.int64)
    inside = labels >= 0
    first_points = np.unique(labels[inside], return_index=True)[1]
    labels[inside] = np.argsort(np.argsort(first_points))[labels[inside]]
    return labels


def split_lateral(
    labels: I64, across_m: F64, range_m: F64, azimuth_std_rad: F64, parameters: ClusteringParameters
) -> I64:
    """Return the labels (N,) with clusters cut in two, and again, where two vehicles drive side by side.

    A cluster is cut at its best place across the road when the centres of both parts are further apart than
    one vehicle is wide, and the cut explains more of the variance than noise and width of one vehicle would
    by chance. across_m, range_m, azimuth_std_rad: (N,).  Noise stays noise, and clusters are never joined.
    """
    p = parameters
    labels = np.array(labels, np.int64, order="C")
    split_clusters(
        labels,
        ready(across_m),
        ready(range_m),
        ready(azimuth_std_rad),
        p.split_width_m**2 / 12,  # of points spread evenly over the width
        (float(p.split_skip_ratio), float(p.split_skip_margin_m2), float(p.split_separation_m),
         float(p.split_gain), float(p.split_gain_per_point)),
        int(p.split_min_points),
        int(p.split_rounds),
    )  # fmt: skip
    return labels
