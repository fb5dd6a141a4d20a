"""Tell standing rows seen from the side from lanes seen end-on: whichever explains the places better."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from service.tracking.end_on_rows import LIKE_LOS_RAD, STEP_RAD, lanes_end_on
from service.tracking.model import F64, Bool
from service.tracking.row_kernels import log_length_density, sharpest
from service.tracking.standing_rows import RowParameters, Stood, mostly, range_to, turned, vehicles_across


def direction_across(  # noqa: PLR0913, PLR0917 - places, and what is known of the road there
    x: F64, y: F64, times: F64, frames: int, driven: Bool, road_heading_rad: F64, p: RowParameters
) -> float | None:
    """Return the heading [rad] of rows that lie across the line of sight, None where there are none.

    times (N,): points that each place stands for, of `frames` frames. Where most places are on a driven road
    (N,) its heading (N,) tells; elsewhere rows across must explain the places better than rows along and
    lanes seen end-on do.
    """
    los = math.atan2(float(x.mean()), float(y.mean()))
    if mostly(driven):
        heading = _driven_heading(times, driven, road_heading_rad)
        return None if _leads_along(heading, los, p) else heading
    across = _sharpest_across(x, y, times, los, p)
    least = _rows(x, y, times, frames, across, p) - p.across_nats
    along = los + LIKE_LOS_RAD
    for heading in (los, float(along[sharpest(x, y, times, along)])):
        if _rows(x, y, times, frames, heading, p) >= least:
            return None
    lanes = lanes_end_on(x, y, times, frames, driven, road_heading_rad, p.long_m, p)
    return None if _lanes(lanes, x, y, times, frames, p) >= least else across


def sure_lanes(  # noqa: PLR0913, PLR0917 - as for `direction_across`
    x: F64, y: F64, times: F64, frames: int, driven: Bool, road_heading_rad: F64, car_length_m: float,
    p: RowParameters,
) -> list[Stood]:  # fmt: skip
    """Return the vehicles of lanes seen end-on where that is sure, else none.

    It is by the road, or where lanes are far likelier than rows across. Of some blocks neither is sure.
    car_length_m: of what may be a car.
    """
    los = math.atan2(float(x.mean()), float(y.mean()))
    by_road = mostly(driven)
    if by_road and not _leads_along(_driven_heading(times, driven, road_heading_rad), los, p):
        return []
    lanes = lanes_end_on(x, y, times, frames, driven, road_heading_rad, car_length_m, p)
    if not by_road:
        rows = _rows(x, y, times, frames, _sharpest_across(x, y, times, los, p), p)
        if _lanes(lanes, x, y, times, frames, p) < rows + p.across_nats:
            return []
    return [f for f, _ in lanes]


def _driven_heading(times: F64, driven: Bool, road_heading_rad: F64) -> float:
    """Return the direction in which others drove where most points lie."""
    return float(road_heading_rad[int(np.argmax(np.where(driven, times, 0.0)))])


def _leads_along(heading_rad: float, los_rad: float, p: RowParameters) -> bool:
    return abs(math.cos(heading_rad - los_rad)) > math.sin(p.turn_rad)


def _sharpest_across(x: F64, y: F64, times: F64, los_rad: float, p: RowParameters) -> float:
    """Return the heading across the line of sight along which the places line up best."""
    most = round(p.turn_rad / STEP_RAD)
    headings = los_rad + 0.5 * math.pi + STEP_RAD * np.arange(-most, most + 1.0)
    return float(headings[sharpest(x, y, times, headings)])


def _rows(  # noqa: PLR0913, PLR0917 - as for `direction_across`
    x: F64, y: F64, times: F64, frames: int, heading_rad: float, p: RowParameters
) -> float:
    """Return the log-likelihood of rows in that direction, nearest face first."""
    u, depth, _ = turned(x, y, heading_rad)
    found, _ = vehicles_across(u, depth, times, range_to(x, y), p)
    boxes = []
    for begin, end, near, _ in found.tolist():
        mine = (u >= begin - p.before_m) & (u < end + p.before_m)
        boxes.append((end - begin, mine & (depth >= near - p.before_m) & (depth < near + p.depth_m)))
    return explained(boxes, times, frames, (float(np.ptp(u)) + 2.0) * (float(np.ptp(depth)) + 2.0), p)


def _lanes(  # noqa: PLR0913, PLR0917 - vehicles, and places as for `direction_across`
    lanes: list[tuple[Stood, Bool]], x: F64, y: F64, times: F64, frames: int, p: RowParameters
) -> float:
    """Return the log-likelihood of lanes seen end-on."""
    boxes = []
    half = 0.5 * (p.before_m + p.depth_m)
    for f, mine in lanes:
        s, c = math.sin(f.heading_rad), math.cos(f.heading_rad)
        beside = np.abs(c * (x - f.x_m) - s * (y - f.y_m)) < half
        boxes.append((f.extent_m, mine & beside))
    u, depth, _ = turned(x, y, math.atan2(float(x.mean()), float(y.mean())))
    return explained(boxes, times, frames, (float(np.ptp(u)) + 2.0) * (float(np.ptp(depth)) + 2.0), p)


def explained(
    boxes: Iterable[tuple[float, Bool]], times: F64, frames: int, area_m2: float, p: RowParameters
) -> float:
    """Return the log-likelihood of vehicles (their length, and which places (N,) lie in them).

    In a vehicle points are as dense as there are; the others lie anywhere.
    """
    told = min(p.told_share, p.told_frames / max(frames, 1))
    rest, total = np.ones(len(times), np.bool_), 0.0
    for length_m, places in boxes:
        mine = rest & places
        rest &= ~mine
        count = float(times[mine].sum())
        if count > 0.0:
            total += told * count * math.log(count / (length_m * (p.before_m + p.depth_m)))
            total += log_length_density(length_m) - p.vehicle_nats
    anywhere = max(0.02, 0.1 * float(times.sum()) / area_m2)
    return total + told * float(times[rest].sum()) * math.log(anywhere)
