"""Tell from vehicles that stand one behind another in a lane how the lane goes on.

Where a recording begins with a queue, nobody has driven yet. Who is hardly seen behind the first few gives no
more points than posts do, and would be learned as clutter. But a queue stands in line: two of its vehicles
tell where a third one may be, and the echo of a post, unlike that of a vehicle, is nearly as strong in every
frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.tracking.model import F64, Bool
from service.tracking.queue_lane_kernels import in_line
from service.tracking.state import Tracks


@dataclass(frozen=True, slots=True)
class QueueLaneParameters:
    """Which vehicles tell a lane, how far they do, and which points in it may be of another vehicle."""

    reach_m: float = 24.0  # beyond the last of the two: three cars; 0: none is told
    half_width_m: float = 1.3
    still_mps: float = 1.0  # speed of either
    hits: int = 20
    points: float = 3.0  # a hit ...
    come_m: float = 5.0  # ... unless it was seen to come so far
    end_on_rad: float = 0.5  # from the line of sight
    apart_m: float = 30.0
    askew_rad: float = 0.2  # of either's heading to the line through both ...
    beside_m: float = 2.0  # ... which must not lead further past it
    near_m: float = 8.0  # nearer than this to where the view begins vehicles are seen in part
    place_m: float = 0.35  # echoes are from one place within this in range ...
    place_stds: float = 2.0  # ... and so many deviations in azimuth
    place_points: int = 5
    fades_db: float = 2.0  # deviation of the echoes from one place of a vehicle, at least


class Lately(NamedTuple):
    """What was seen before."""

    points: F64  # (M, POINT_COLUMNS) that stood in the last second and were of no track
    nearest_m: float  # range where the view begins


def queue_lanes(
    tracks: Tracks, points: F64, which: Bool, lately: Lately, p: QueueLaneParameters
) -> tuple[Bool, F64]:
    """Return which of the points (N, POINT_COLUMNS) are in line with a queue, and its direction (N,) [rad].

    which (N,): those that are asked about.
    """
    heading = np.zeros(len(points))
    if p.reach_m <= 0.0:
        return np.zeros(len(points), np.bool_), heading
    told = in_line(
        tracks.mean, tracks.heading_rad, tracks.length_m, tracks.status, tracks.hits, tracks.points_per_hit,
        tracks.born_x_m, tracks.born_y_m, points, which, lately.points,
        (p.still_mps, float(p.hits), p.points, p.come_m, math.cos(p.end_on_rad)),
        (p.reach_m, p.half_width_m, p.apart_m, math.sin(p.askew_rad), p.beside_m,
         lately.nearest_m + p.near_m),
        (p.place_m, p.place_stds, float(p.place_points), p.fades_db**2),
        heading,
    )  # fmt: skip
    return told, heading
