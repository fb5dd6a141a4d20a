"""Put boxes right that do not lie on the vehicles of standing rows or lanes, once a second."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from service.tracking import righting_lanes, righting_rows
from service.tracking.births import MAX_STANDING_BOXES, ROW_POINTS, BirthParameters
from service.tracking.model import F64, I64, Bool
from service.tracking.moved_boxes import Block, Boxes, RearrangingParameters, near
from service.tracking.row_direction import direction_across, sure_lanes
from service.tracking.row_kernels import chains
from service.tracking.standing_rows import mostly, thin
from service.tracking.state import Tracks


def rearrange(  # noqa: PLR0913, PLR0917 - tracks, points, and what is known of the road there
    tracks: Tracks, points: F64, frames: int, driven: Bool, road_heading_rad: F64, birth: BirthParameters,
    p: RearrangingParameters,
) -> tuple[Tracks, list[F64]]:  # fmt: skip
    """Return the tracks with the boxes of standing vehicles put right, and rows for those without a box.

    points (N, POINT_COLUMNS): all standing points of the last `frames` frames that are no clutter, claimed or
    not; driven (N,): vehicles have driven there, in direction road_heading_rad (N,). A row has the columns
    that `births.gather` takes.
    """
    still = _still(tracks, p)
    if not len(still) or len(points) < birth.standing_cluster_points:
        return tracks, []
    x, y, times, first = thin(points)
    known, along = driven[first], road_heading_rad[first]
    boxes = Boxes.of(tracks)
    movable = _of_rows(tracks, still, p)
    for here in _blocks(tracks, movable, x, y, times, frames, birth, p):
        block = Block(x[here], y[here], times[here], frames)
        heading = direction_across(*block, known[here], along[here], birth.rows)
        if heading is None:
            continue
        found, sure = righting_rows.parted(boxes, movable, block, heading, birth, p)
        if len(found) > 1 or sure:
            righting_rows.settle(boxes, movable, found, sure, birth, p, driven=mostly(known[here]))
    for here in _blocks(tracks, still, x, y, times, frames, birth, p):
        block = Block(x[here], y[here], times[here], frames)
        lanes = sure_lanes(*block, known[here], along[here], birth.length_m, birth.rows)
        found = [f for f in lanes if f.rate >= p.rate]
        righting_lanes.settle(boxes, still, found, block, birth, p, driven=mostly(known[here]))
    boxes.born.sort(key=lambda row: -row[ROW_POINTS])  # the best seen
    return boxes.left(), boxes.born[:MAX_STANDING_BOXES]


def _still(t: Tracks, p: RearrangingParameters) -> I64:
    """Return which confirmed tracks stand, not far from where they were born, nor seen to drive and long."""
    still = t.confirmed & (t.speed_mps < p.still_mps) & (t.come_m < p.slid_m)
    return np.flatnonzero(still & ((t.come_m < p.travel_m) | (t.length_m < p.long_m)))


def _of_rows(t: Tracks, still: I64, p: RearrangingParameters) -> I64:
    """Return which of the tracks are where they were born and are seen from the side, or are young."""
    end_on = np.abs(np.cos(t.heading_rad - np.arctan2(t.x_m, t.y_m)))
    movable = (t.come_m < p.travel_m) & ((end_on < p.side_on_cosine) | (t.hits < p.young_hits))
    return still[movable[still]]


def _blocks(  # noqa: PLR0913, PLR0917 - tracks, and places
    t: Tracks, which: I64, x: F64, y: F64, times: F64, frames: int, birth: BirthParameters,
    p: RearrangingParameters,
) -> Iterator[I64]:  # fmt: skip
    """Yield the places at or near those boxes, block by block, that may be of two vehicles or more."""
    here = np.flatnonzero(near(t, which, x, y, p.near_m))
    block = chains(x[here], y[here], birth.rows.reach_m)
    for b in np.unique(block):
        mine = here[block == b]
        if times[mine].sum() >= 2.0 * p.rate * frames:
            yield mine
