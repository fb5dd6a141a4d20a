"""Tell vehicles that stand in lanes beside one another, seen end-on, apart from one another.

A mast looks down on a queue: of each vehicle it sees the face, the roof and, near by, the sides. Range, which
is sharp, tells those of one lane apart; lanes are told by azimuth, which a second of points makes sharp
enough. So standing points are cut into lanes first, the fullest first, and each lane is parted along as a row
seen from the side is. A road may bend: this is done piece by piece, each in its own direction.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from service.tracking.model import F64, Bool
from service.tracking.row_kernels import nearest_face, part_row, sharpest
from service.tracking.standing_rows import RowParameters, Stood, mostly

STEP_RAD = math.radians(3.0)
LIKE_LOS_RAD = STEP_RAD * np.arange(-6.0, 7.0)  # rows turned no more are seen end-on


def lanes_end_on(  # noqa: PLR0913, PLR0917 - places, and what is known of the road there
    x: F64, y: F64, times: F64, frames: int, driven: Bool, road_heading_rad: F64, car_length_m: float,
    p: RowParameters,
) -> list[tuple[Stood, Bool]]:  # fmt: skip
    """Return the vehicles of lanes that lead along the line of sight, each with the places (N,) of its own.

    times (N,): points that each place stands for, of `frames` frames; driven (N,): vehicles have driven
    there, in direction road_heading_rad (N,). Elsewhere vehicles are held to face the radar, and one alone
    has no lane. car_length_m: of what may be a car.
    """
    if not len(x):
        return []
    range_m = np.hypot(x, y)
    first, last = float(range_m.min()), float(range_m.max())
    pieces = max(math.ceil((last - first) / p.piece_m), 1)
    size = (last - first) / pieces
    out: list[tuple[Stood, Bool]] = []
    for k in range(pieces):
        begin, end = first + k * size, first + (k + 1) * size
        here = np.flatnonzero((range_m >= begin - p.piece_margin_m) & (range_m <= end + p.piece_margin_m))
        u, v, n = x[here], y[here], times[here]
        heading, told = _heading(u, v, n, driven[here], road_heading_rad[here], p)
        if heading is None or n.sum() < p.vehicle_points:
            continue
        found = _lanes(u, v, n, frames, heading, car_length_m, p)
        if not told and sum(f.rate >= p.lane_rate for f, _ in found) < p.lane_vehicles:
            continue
        for f, places in found:
            middle = math.hypot(f.x_m, f.y_m)  # of a vehicle whose face alone is seen beyond the last place
            if (k == 0 or middle >= begin) and (k == pieces - 1 or middle < end):
                mine = np.zeros(len(x), np.bool_)
                mine[here[places]] = True
                out.append((_this_way(f, mine, times, driven, road_heading_rad), mine))
    return out


def _heading(  # noqa: PLR0913, PLR0917 - as for `lanes_end_on`
    x: F64, y: F64, times: F64, driven: Bool, road_heading_rad: F64, p: RowParameters
) -> tuple[float | None, bool]:
    """Return the direction in which a piece of road is driven, None for none, and whether it was told."""
    los = math.atan2(float(x.mean()), float(y.mean()))
    if mostly(driven):
        heading = float(road_heading_rad[int(np.argmax(np.where(driven, times, 0.0)))])
        if abs(math.cos(heading - los)) > math.sin(p.turn_rad):
            return heading, True
    best = sharpest(x, y, times, los + LIKE_LOS_RAD)
    if best in {0, len(LIKE_LOS_RAD) - 1}:  # sharper still beyond: not end-on, or no direction at all
        return None, False
    return los + float(LIKE_LOS_RAD[best]) + math.pi, False


def _this_way(f: Stood, mine: Bool, times: F64, driven: Bool, road_heading_rad: F64) -> Stood:
    """Return the vehicle turned over where others have driven the other way."""
    known = mine & driven
    if not known.any():
        return f
    heading = float(road_heading_rad[int(np.argmax(np.where(known, times, 0.0)))])
    return replace(f, heading_rad=f.heading_rad + math.pi) if math.cos(heading - f.heading_rad) < 0.0 else f


def _lanes(  # noqa: PLR0913, PLR0917 - as for `lanes_end_on`
    x: F64, y: F64, times: F64, frames: int, heading_rad: float, car_length_m: float, p: RowParameters
) -> list[tuple[Stood, Bool]]:
    """Return the vehicles of one piece of road, each with the places (N,) that are its own."""
    s, c = math.sin(heading_rad), math.cos(heading_rad)
    away = 1.0 if s * float(x.mean()) + c * float(y.mean()) > 0.0 else -1.0
    u, w = away * (s * x + c * y), c * x - s * y  # u: away from the radar
    limits = (
        p.bin_m, p.gap_m, p.lane_leak, float(p.vehicle_points), p.vehicle_nats, p.bin_told, p.shape
    )  # fmt: skip
    found: list[tuple[Stood, Bool]] = []
    left = np.ones(len(x), np.bool_)
    while times[left].sum() >= p.vehicle_points:
        edge = nearest_face(w, times, left, p.lane_m)
        band = left & (w >= edge - p.lane_beside_m) & (w < edge + p.lane_m + p.lane_beside_m)
        if not band.any():
            break
        left &= ~band
        for begin, end, count in part_row(u[band], times[band], limits).tolist():
            mine = band & (u >= begin - p.before_m) & (u < end + p.before_m)
            if _widest_gap_m(u[mine]) > p.hollow_m:
                continue
            length = end - begin if end - begin >= p.long_m else car_length_m
            middle, across = away * (begin + 0.5 * length), _middle(w[mine], times[mine], p)
            x_m, y_m = s * middle + c * across, c * middle - s * across
            found.append((Stood(x_m, y_m, heading_rad, length, end - begin, count / frames), mine))
    return found


def _widest_gap_m(u: F64) -> float:
    return float(np.diff(np.sort(u)).max(initial=0.0))


def _middle(w: F64, times: F64, p: RowParameters) -> float:
    """Return the middle of a vehicle's places across it: of its two sides where both are seen."""
    order = np.argsort(w, kind="stable")
    share = np.cumsum(times[order]) / times.sum()
    left, right = (float(w[order[k]]) for k in share.searchsorted([0.05, 0.95]))
    if right - left > p.both_sides_m:
        return 0.5 * (left + right)
    return float((w * times).sum() / times.sum())
