"""Distance of a track's point to a vehicle: a radar sees the near end of a long body.

The distance is taken to the segment from the centre of the face nearest to the radar to the centre of the
box, so that a tracker may report either point, or one between, while sideways every centimetre counts.
"""

from __future__ import annotations

import numpy as np

from service.tracking.model import F64

_SHORTEST_M2 = 1e-9  # squared length below which a segment is a point


def near_face_centres(x_m: F64, y_m: F64, heading_rad: F64, length_m: F64, width_m: F64) -> F64:
    """Return the centre of the face of each box that is nearest to the radar, (N, 2) in metres.

    Boxes are given by centre, heading (clockwise from +y), length and width, each (N,).
    """
    sin, cos = np.sin(heading_rad), np.cos(heading_rad)
    along, across = length_m / 2, width_m / 2
    face_x = np.stack([x_m + sin * along, x_m - sin * along, x_m + cos * across, x_m - cos * across])
    face_y = np.stack([y_m + cos * along, y_m - cos * along, y_m - sin * across, y_m + sin * across])
    nearest = np.argmin(face_x**2 + face_y**2, axis=0)
    column = np.arange(len(x_m))
    return np.stack([face_x[nearest, column], face_y[nearest, column]], axis=1)


def segment_distances(start_m: F64, end_m: F64, points_m: F64) -> F64:
    """Return the distance of each point to each segment, (S, P) in metres.

    start_m, end_m: (S, 2) ends of the segments.  points_m: (P, 2).
    """
    span = end_m - start_m
    offset = points_m[None, :, :] - start_m[:, None, :]
    length2 = np.maximum(np.einsum("sk,sk->s", span, span), _SHORTEST_M2)
    share = np.clip(np.einsum("spk,sk->sp", offset, span) / length2[:, None], 0.0, 1.0)
    rest = offset - share[:, :, None] * span[:, None, :]
    return np.asarray(np.hypot(rest[..., 0], rest[..., 1]), dtype=np.float64)
