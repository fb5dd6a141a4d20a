"""Foot points of points on a polyline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, Bool

_SHORTEST = 1e-9  # squared length of a segment (m^2), and length of a direction (m), taken for a point


@dataclass(frozen=True, slots=True)
class Feet:
    """Where K points stand beside a polyline."""

    distance_m: F64  # (K,)
    beyond: Bool  # (K,) the nearest place is an end of the polyline: the point is not beside it
    direction: F64  # (K, 2) unit vector of the nearest segment


def feet(polyline_m: F64, points_m: F64) -> Feet:
    """Return the foot points of points (K, 2) on a polyline (M, 2), M at least 2."""
    start, span = polyline_m[:-1], np.diff(polyline_m, axis=0)
    x, y = points_m[:, 0, None] - start[:, 0], points_m[:, 1, None] - start[:, 1]
    length2 = np.maximum(span[:, 0] ** 2 + span[:, 1] ** 2, _SHORTEST)
    share = np.clip((x * span[:, 0] + y * span[:, 1]) / length2, 0.0, 1.0)
    distance = np.hypot(x - share * span[:, 0], y - share * span[:, 1])
    nearest = np.argmin(distance, axis=1)
    beyond = ((nearest == 0) & (share[:, 0] <= 0)) | ((nearest == len(span) - 1) & (share[:, -1] >= 1))
    return Feet(
        distance_m=distance[np.arange(len(points_m)), nearest],
        beyond=beyond,
        direction=unit(span)[nearest],
    )


def unit(vectors: F64) -> F64:
    """Return the vectors (K, 2) scaled to length one; a vector of no length stays one."""
    length = np.hypot(vectors[:, 0], vectors[:, 1])
    return np.asarray(vectors / np.maximum(length, _SHORTEST)[:, None], dtype=np.float64)
