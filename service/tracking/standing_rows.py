"""Tell vehicles that stand one behind another, seen from the side, apart from one another.

Vehicles seen end-on differ in range. Those of a row across the line of sight have one range, and stand out
from the next row by decimetres of it, but along their row only azimuth tells them apart: at 90 m its noise is
half a metre a point, and two cars stand 2 m apart. So a row is parted as a whole: into those vehicles and
gaps under which its points are likeliest, given how long vehicles are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.boxes import PX, PY
from service.tracking.model import F64, I64, Bool
from service.tracking.row_kernels import nearest_face, part_row

_PLACE_M = 0.3  # echoes of one scatterer lie this near to one another


@dataclass(frozen=True, slots=True)
class RowParameters:
    """How vehicles stand in rows, and how their points lie."""

    reach_m: float = 3.0  # points nearer to one another may be of one row, or of rows beside one another
    face_m: float = 1.2  # depth that holds most of the points of a side ...
    before_m: float = 0.3  # ... a few lie before it ...
    depth_m: float = 2.2  # ... and the rest up to here behind its beginning
    beside_m: float = 2.7  # rows are further apart: what lies nearer behind a vehicle is its far side
    bin_m: float = 0.25
    bin_told: float = 0.5  # neighbouring bins say the same, by half
    shape: float = 2.0  # of the negative binomial number of points in a bin
    gap_m: float = 1.5  # between two vehicles, at least
    leak: float = 0.2  # points in a gap, as a share of those beside it, at this range and beyond ...
    leak_range_m: float = 95.0
    leak_least: float = 0.4  # ... and fewer nearby, where azimuth is sharper, down to this share of it
    vehicle_points: int = 6  # fewer are no vehicle
    vehicle_nats: float = 1.0  # of likelihood that one vehicle more must gain
    across_nats: float = 5.0  # by which rows across must be likelier than rows along ...
    told_frames: float = 5.0  # ... where more frames tell no more: the same scatterers answer again
    told_share: float = 0.5  # weight of the points of fewer frames
    turn_rad: float = math.radians(30.0)  # from across the line of sight, of a row seen side-on at most
    long_m: float = 5.4  # what seems shorter is a car as far as anybody can tell
    face_to_centre_m: float = 1.2  # of a car, from where the slice of its side begins
    piece_m: float = 24.0  # of a road seen end-on, which may bend ...
    piece_margin_m: float = 10.0  # ... with so much on either side of it
    lane_m: float = 2.4  # width that holds most of the points of a lane's vehicles ...
    lane_beside_m: float = 0.35  # ... and the rest up to here beside it
    lane_leak: float = 0.05  # as leak, where range tells
    hollow_m: float = 2.5  # what has a longer gap in it is of several posts
    lane_rate: float = 2.0  # points a frame of the vehicles that tell an unknown lane's direction ...
    lane_vehicles: int = 2  # ... and how many it takes
    both_sides_m: float = 1.2  # what is wider is seen from side to side


@dataclass(frozen=True, slots=True)
class Stood:
    """A vehicle of a standing row: its centre, the row's heading, its length, and its points a frame."""

    x_m: float
    y_m: float
    heading_rad: float  # or the other way round
    length_m: float
    extent_m: float  # of its points along the row
    rate: float


def thin(points: F64) -> tuple[F64, F64, F64, I64]:
    """Return the places x, y of points (N, POINT_COLUMNS), the points that each stands for, and one of them.

    One scatterer repeats in every frame.
    """
    column, row = np.round(points[:, [PX, PY]] / _PLACE_M).astype(np.int64).T
    cell = column * (1 + np.ptp(row)) + row - row.min()
    _, first, back, times = np.unique(cell, return_index=True, return_inverse=True, return_counts=True)
    x = np.bincount(back, points[:, PX]) / times
    y = np.bincount(back, points[:, PY]) / times
    return x, y, times.astype(np.float64), first


def mostly(driven: Bool) -> bool:
    """Return whether more than half of the places (N,) are on a driven road."""
    return bool(2 * np.count_nonzero(driven) > len(driven))


def stand(  # noqa: PLR0913, PLR0917 - as for `direction_across`
    x: F64, y: F64, times: F64, frames: int, heading_rad: float, car_length_m: float, p: RowParameters
) -> tuple[list[Stood], Bool]:
    """Return the vehicles of rows in that direction, and which places (N,) belong to one.

    times (N,): points that each place stands for, of `frames` frames; car_length_m: of what may be a car.
    """
    u, depth, away = turned(x, y, heading_rad)
    s, c = math.sin(heading_rad), math.cos(heading_rad)
    found, inside = vehicles_across(u, depth, times, range_to(x, y), p)
    out = []
    for begin, end, near, count in found.tolist():
        length = end - begin if end - begin >= p.long_m else car_length_m
        middle, w = 0.5 * (begin + end), away * (near + p.face_to_centre_m)
        x_m, y_m = s * middle + c * w, c * middle - s * w
        out.append(Stood(x_m, y_m, heading_rad, length, end - begin, count / frames))
    return out, inside


def turned(x: F64, y: F64, heading_rad: float) -> tuple[F64, F64, float]:
    """Return how far along a heading places lie, and how far away across it; -1: that is to its left."""
    s, c = math.sin(heading_rad), math.cos(heading_rad)
    away = 1.0 if c * float(x.mean()) - s * float(y.mean()) > 0.0 else -1.0
    return s * x + c * y, away * (c * x - s * y), away


def range_to(x: F64, y: F64) -> float:
    """Return how far away the middle of places (N,) is."""
    return math.hypot(float(x.mean()), float(y.mean()))


def vehicles_across(u: F64, depth: F64, times: F64, range_m: float, p: RowParameters) -> tuple[F64, Bool]:
    """Return a row (K, 4) for each vehicle, and which places (N,) belong to one.

    u, depth (N,): places along the rows and away from the radar, which is `range_m` from them. A vehicle: its
    ends along the row, where its near side begins, and its points. The row with most points in its near side
    comes first.
    """
    found: list[tuple[float, float, float, float]] = []
    left, inside = np.ones(len(u), np.bool_), np.zeros(len(u), np.bool_)
    leak = p.leak * min(max((range_m / max(p.leak_range_m, 1.0)) ** 3, p.leak_least), 1.0)
    limits = (p.bin_m, p.gap_m, leak, float(p.vehicle_points), p.vehicle_nats, p.bin_told, p.shape)
    while times[left].sum() >= p.vehicle_points:
        near = nearest_face(depth, times, left, p.face_m)
        band = left & (depth >= near - p.before_m) & (depth < near + p.depth_m)
        if not band.any():
            break
        left &= ~band
        for begin, end, count in part_row(u[band], times[band], limits).tolist():
            if any(begin < b and a < end and abs(near - w) < p.beside_m for a, b, w, _ in found):
                continue
            found.append((begin, end, near, count))
            inside |= (
                (u >= begin - 0.5) & (u < end + 0.5) & (depth >= near - 1.0) & (depth < near + p.beside_m)
            )
    return np.array(found).reshape(-1, 4), inside
