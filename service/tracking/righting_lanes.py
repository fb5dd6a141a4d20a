"""Put boxes that lie across lanes seen end-on, or between them, onto the vehicles that stand there.

A box may be born of one vehicle of each of two lanes, or turn towards its neighbour's points while it
stands. A second of points tells how the vehicles of the lanes stand (see `end_on_rows`). A box that lies as
a vehicle of its lane may stays as it is. Any other one goes onto a vehicle in it that has no box, if the
points are far likelier then, or ends, if they are as likely without it, as of two boxes on one car.
"""

from __future__ import annotations

import math

import numpy as np

from service.tracking.births import ROW_X, ROW_Y, BirthParameters, standing_row
from service.tracking.model import F64, I64, Bool
from service.tracking.moved_boxes import (
    Block,
    Boxes,
    RearrangingParameters,
    apart_m,
    holds,
    inside,
)
from service.tracking.row_direction import explained
from service.tracking.standing_rows import RowParameters, Stood
from service.tracking.state import Tracks


def settle(  # noqa: PLR0913, PLR0917 - boxes, vehicles, points, and what is known of the road there
    boxes: Boxes, still: I64, found: list[Stood], block: Block, birth: BirthParameters,
    p: RearrangingParameters, *, driven: bool,
) -> None:  # fmt: skip
    """Put those of the boxes `still` that lie wrong onto the vehicles found in one block of points.

    Vehicles that are left without a box start tracks where they give enough points.
    """
    t = boxes.as_put()
    there = t.confirmed
    there[list(boxes.gone)] = False
    slow = there & (t.speed_mps < p.still_mps)
    right, taken, stood_on = np.zeros(len(t), np.bool_), set[int](), set[int]()
    for k, f in enumerate(found):
        on_it = there & _lie_on(t, f, p)
        right |= on_it
        if on_it.any():
            taken.add(k)
        if (on_it & slow).any():  # what drives by stays on nobody
            stood_on.add(k)
    wrong = [i for i in still.tolist() if not right[i] and i not in boxes.put_on | boxes.gone]
    laid = _Laid(t, np.flatnonzero(there).tolist(), block, birth.rows)
    held = [(apart_m(t, i, f), i, k) for i in wrong for k, f in enumerate(found) if holds(t, i, f, p)]
    for _, i, k in sorted(held):
        if i not in boxes.put_on and k not in taken and laid.gains(i, found[k], p.gain_nats):
            boxes.put(i, found[k], birth, p)
            taken.add(k)
            stood_on.add(k)
    for i in wrong:
        spare = i not in boxes.put_on and any(inside(t, i, found[k], p) for k in stood_on)
        if spare and laid.gains(i, None, 0.0):
            boxes.gone.add(i)
    for k, f in enumerate(found):
        enough = driven or f.rate >= birth.standing_points_per_frame
        starts = k not in taken and enough and not _started(boxes.born, f)
        if starts and laid.gains(-1 - k, f, p.gain_nats):
            boxes.born.append(standing_row(f, told=True, p=birth))


def _started(born: list[F64], f: Stood) -> bool:
    """Return whether a track starts on the vehicle already: as one of a row across."""
    return any(math.hypot(row[ROW_X] - f.x_m, row[ROW_Y] - f.y_m) < 0.5 * f.length_m for row in born)


class _Laid:
    """Where boxes lie on a block of points, and how likely that makes the points."""

    def __init__(self, t: Tracks, which: list[int], block: Block, p: RowParameters) -> None:
        self._block, self._p = block, p
        self._area_m2 = (float(np.ptp(block.x)) + 2.0) * (float(np.ptp(block.y)) + 2.0)
        lies = {i: self._at(t.x_m[i], t.y_m[i], t.heading_rad[i], t.length_m[i]) for i in which}
        self._lies = {i: box for i, box in lies.items() if box[1].any()}
        self._nats = self._likelihood(self._lies)

    def gains(self, i: int, onto: Stood | None, nats: float) -> bool:
        """Put box i onto a vehicle, or away, if the points gain so much by that; return whether they do."""
        lies = {j: box for j, box in self._lies.items() if onto is not None or j != i}
        if onto is not None:
            lies[i] = self._at(onto.x_m, onto.y_m, onto.heading_rad, onto.length_m)
        after = self._likelihood(lies)
        if after < self._nats + nats:
            return False
        self._lies, self._nats = lies, after
        return True

    def _at(self, x_m: float, y_m: float, heading_rad: float, length_m: float) -> tuple[float, Bool]:
        """Return the length of a box and which places (N,) lie in it."""
        dx, dy, p = self._block.x - x_m, self._block.y - y_m, self._p
        s, c = math.sin(heading_rad), math.cos(heading_rad)
        along, across = np.abs(s * dx + c * dy), np.abs(c * dx - s * dy)
        places = (along < 0.5 * length_m + p.before_m) & (across < 0.5 * (p.before_m + p.depth_m))
        return float(length_m), places

    def _likelihood(self, lies: dict[int, tuple[float, Bool]]) -> float:
        block = self._block
        return explained(lies.values(), block.times, block.frames, self._area_m2, self._p)


def _lie_on(t: Tracks, f: Stood, p: RearrangingParameters) -> Bool:
    """Return which boxes (T,) lie along the lane of the vehicle, on it."""
    s, c = math.sin(f.heading_rad), math.cos(f.heading_rad)
    dx, dy = t.x_m - f.x_m, t.y_m - f.y_m
    turned = np.abs(np.sin(t.heading_rad - f.heading_rad))
    reach_m = np.maximum(0.5 * t.length_m, max(0.5 * f.length_m, p.same_m))
    on_it = (np.abs(s * dx + c * dy) < reach_m) & (np.abs(c * dx - s * dy) < p.lane_beside_m)
    return np.asarray(on_it & (turned < math.sin(p.lane_askew_rad)))
