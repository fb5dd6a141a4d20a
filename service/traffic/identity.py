"""Give learned lanes the numbers that they had in the map before, and tell two maps apart."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from service.tracking.model import F64
from service.traffic.curves import along, beside, headings
from service.traffic.learning import Learned
from service.traffic.model import MOST_LANES, Direction, Lane
from service.traffic.steps import CALL_WORK, Steps

_FAR_M = 1e3  # cost of lanes that are not the same


@dataclass(frozen=True, slots=True)
class IdentityParameters:
    """When two lanes are the same, and when two maps differ."""

    offset_m: float = 1.4  # mean distance of the same lane in two maps
    overlap: float = 0.4  # of the shorter of the two
    same_way: float = 0.8  # cosine between their directions
    shift_m: float = 0.25  # a lane that moved more makes a new map
    longer_m: float = 10.0  # ... or became so much longer or shorter
    radial_share: float = 0.6  # of its length that a lane must come nearer to be approaching


@dataclass(frozen=True, slots=True)
class MapDifference:
    """What one map has that another has not."""

    added: tuple[int, ...]
    removed: tuple[int, ...]
    moved: tuple[tuple[int, float], ...]  # index, and the largest shift where both are [m]
    resized: tuple[tuple[int, float], ...]  # index, and how much longer the lane is [m]

    def __bool__(self) -> bool:
        return bool(self.added or self.removed or self.moved or self.resized)


def named(found: Sequence[Learned], before: Sequence[Lane], p: IdentityParameters) -> Steps[tuple[Lane, ...]]:
    """Return the lanes with the numbers of the same lanes before, and new numbers for new ones."""
    rows_of_cost = []
    for new in found:
        rows_of_cost.append([_apart(new.points_m, old.points_m, p) for old in before])
        yield len(before) * CALL_WORK
    cost = np.array(rows_of_cost)
    known: dict[int, int] = {}
    if cost.size:
        rows, columns = linear_sum_assignment(cost)
        known = {
            int(row): before[column].index
            for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
            if cost[row, column] < p.offset_m
        }
    fresh = _fresh_numbers({lane.index for lane in before})
    lanes = []
    for k, lane in enumerate(found):
        index = known.get(k) or next(fresh, 0)
        if index:
            lanes.append(
                Lane(
                    index=index,
                    lane_id=f"L{index}",
                    kind="turn" if lane.turn else "lane",
                    direction=direction_of(lane.points_m, p),
                    points_m=lane.points_m,
                    width_m=lane.width_m,
                    confidence=lane.confidence,
                    vehicles=lane.paths,
                )
            )
    return tuple(sorted(lanes, key=lambda lane: lane.index))


def direction_of(points_m: F64, p: IdentityParameters) -> Direction:
    """Return whether a lane comes nearer to the radar, goes away from it, or neither."""
    nearer = np.hypot(*points_m[0]) - np.hypot(*points_m[-1])
    share = nearer / max(float(along(points_m)[-1]), 1e-9)
    if abs(share) < p.radial_share:
        return "crossing"
    return "approaching" if share > 0 else "receding"


def difference(before: Sequence[Lane], after: Sequence[Lane], p: IdentityParameters) -> MapDifference:
    """Return what `after` has that `before` has not, and the other way round."""
    old, new = {lane.index: lane for lane in before}, {lane.index: lane for lane in after}
    moved, resized = [], []
    for index in sorted(old.keys() & new.keys()):
        place = beside(new[index].points_m, old[index].points_m)
        shift = float(np.abs(place.right_m[~place.beyond]).max(initial=0.0))
        if shift > p.shift_m:
            moved.append((index, shift))
        longer = new[index].length_m - old[index].length_m
        if abs(longer) > p.longer_m:
            resized.append((index, longer))
    return MapDifference(
        tuple(sorted(new.keys() - old.keys())),
        tuple(sorted(old.keys() - new.keys())),
        tuple(moved),
        tuple(resized),
    )


def _fresh_numbers(taken: set[int]) -> Iterator[int]:
    """Yield numbers above all that are taken, then, at the end of the byte, those that are free below."""
    highest = max(taken, default=0)
    yield from range(highest + 1, MOST_LANES + 1)
    yield from (k for k in range(1, highest) if k not in taken)


def _apart(new: F64, old: F64, p: IdentityParameters) -> float:
    """Return the mean distance of two lanes where they lie beside one another in the same direction."""
    place = beside(new, old)
    same = np.cos(headings(new) - place.heading_rad) > p.same_way
    both = ~place.beyond & same
    length = both.mean() * float(along(new)[-1])
    if length < p.overlap * min(float(along(new)[-1]), float(along(old)[-1])):
        return _FAR_M
    return float(np.abs(place.right_m[both]).mean())
