"""How much nearer vehicles weaken the echoes of points behind them: 3-D rays against boxes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.simulation.vehicles import VehicleStates
from service.tracking.model import F64, I64

BODY_SHARE = 0.97  # of the box in plan; corners are rounded
ROOF_SHARE = 0.95  # of the height; bonnet and screen are lower than the roof
TALL_M = 2.5  # boxes higher than this let nothing through their windows
BEARING_MARGIN_RAD = 0.02
NEARLY_THERE = 0.999  # share of the ray; the point's own place is no obstacle


@dataclass(frozen=True, slots=True)
class ShadowParameters:
    """Loss of a two-way path whose ray passes below a roof line.

    At grazing a knife edge costs 6 dB (ITU-R P.526, J(0)); it grows with the depth until what creeps around
    and under the vehicle dominates.
    """

    grazing_db: float = 6.0
    per_metre_db: float = 14.0
    most_db: float = 18.0
    most_behind_tall_db: float = 24.0


def shadow_loss_db(  # noqa: PLR0913 - the points come as columns
    boxes: VehicleStates,
    x_m: F64,
    y_m: F64,
    z_m: F64,
    owner: I64,
    *,
    radar_height_m: float,
    parameters: ShadowParameters,
) -> F64:
    """Return the loss (P,) of the rays from the radar to points, each the largest over the boxes that cut it.

    `owner` (P,) is the index of the box a point belongs to (-1: none); a box does not shadow its own points.
    """
    loss = np.zeros(len(x_m))
    point, box = _candidates(boxes, x_m, y_m, owner)
    if not len(point):
        return loss
    enter, leave = _crossed_span(boxes, box, x_m[point], y_m[point])
    # the ray falls towards the point, so it is lowest where it leaves the box (or at the point, inside it)
    lowest = radar_height_m + (z_m[point] - radar_height_m) * np.clip(leave, 0.0, 1.0)
    height = boxes.height_m[box]
    depth = height * ROOF_SHARE - lowest
    hit = (enter < leave) & (leave > 0) & (enter < NEARLY_THERE) & (depth > 0)
    most = np.where(height > TALL_M, parameters.most_behind_tall_db, parameters.most_db)
    each = np.minimum(parameters.grazing_db + parameters.per_metre_db * depth, most)
    np.maximum.at(loss, point[hit], each[hit])
    return loss


def _candidates(boxes: VehicleStates, x_m: F64, y_m: F64, owner: I64) -> tuple[I64, I64]:
    """Return the pairs (point, box) of which the box is nearer and in the point's bearing, roughly."""
    box_range, box_bearing = boxes.ground_range_m(), boxes.azimuth_rad()
    reach = np.hypot(boxes.length_m, boxes.width_m) / 2
    half_width = np.arctan2(reach, np.maximum(box_range - reach, 1.0)) + BEARING_MARGIN_RAD
    nearest = box_range - reach
    off = np.abs(np.arctan2(x_m, y_m)[:, None] - box_bearing[None, :])
    behind = np.hypot(x_m, y_m)[:, None] > nearest[None, :]
    other = owner[:, None] != np.arange(len(boxes))[None, :]
    point, box = np.nonzero((off < half_width[None, :]) & behind & other)
    return point, box


def _crossed_span(boxes: VehicleStates, box: I64, x_m: F64, y_m: F64) -> tuple[F64, F64]:
    """Return where along the rays (0 radar, 1 point) they enter and leave the boxes in plan (slab method)."""
    sine, cosine = np.sin(boxes.heading_rad)[box], np.cos(boxes.heading_rad)[box]
    cx, cy = boxes.x_m[box], boxes.y_m[box]
    from_forward, from_right = -(cx * sine + cy * cosine), -(cx * cosine - cy * sine)
    go_forward, go_right = x_m * sine + y_m * cosine, x_m * cosine - y_m * sine
    half_length, half_width = BODY_SHARE * boxes.length_m[box] / 2, BODY_SHARE * boxes.width_m[box] / 2
    tiny = np.finfo(np.float64).tiny
    go_forward = np.where(go_forward == 0, tiny, go_forward)
    go_right = np.where(go_right == 0, tiny, go_right)
    with np.errstate(over="ignore"):  # a ray along a side: its slab limits are infinite, as they should be
        f0, f1 = (-half_length - from_forward) / go_forward, (half_length - from_forward) / go_forward
        r0, r1 = (-half_width - from_right) / go_right, (half_width - from_right) / go_right
    enter = np.maximum(np.minimum(f0, f1), np.minimum(r0, r1))
    leave = np.minimum(np.maximum(f0, f1), np.maximum(r0, r1))
    return enter, leave
