"""Give learned lanes the numbers that they had in the map before, and tell two maps apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from service.tracking.model import F64
from service.traffic.curves import along, beside, headings
from service.traffic.learning import Learned
from service.traffic.model import MOST_LANES, Direction, Lane
from service.traffic.steps import CALL_WORK, Steps


@dataclass(frozen=True, slots=True)
class IdentityParameters:
    """When two lanes are the same, and when two maps differ."""

    offset_m: float = 1.4  # between the centre lines of one lane in two maps
    overlap: float = 0.7  # of the shorter of the two, along which they lie so near and go the same way
    confidence: float = 0.6  # of a lane that is new; one that the map has stays down to learning.confidence
    confidence_at_end: float = 0.4  # of a new one in the map of a whole recording: no more will tell of it
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


def named(
    found: Sequence[Learned], before: Sequence[Lane], gone: Sequence[Lane], p: IdentityParameters
) -> Steps[tuple[Lane, ...]]:
    """Return the lanes with the numbers of the same lanes before, and numbers never used for new ones.

    before: of the map in force. gone: that maps before had, those that left first first; one that comes back
    takes its number again. Of the parts of a lane that was cut the one that shares most with it keeps it.
    """
    numbers = yield from _known(found, before, p)
    sure = [k for k, lane in enumerate(found) if k not in numbers and lane.confidence >= p.confidence]
    back = yield from _known([found[k] for k in sure], gone, p)
    numbers |= {sure[k]: index for k, index in back.items()}
    highest = max((lane.index for lane in (*before, *gone)), default=0)
    fresh = list(range(highest + 1, MOST_LANES + 1))
    # at the end of the byte: numbers that were never used after all, then those that left first
    taken = {lane.index for lane in before} | set(numbers.values())
    left = [lane.index for lane in gone if lane.index not in taken]
    fresh += [k for k in range(1, highest) if k not in taken and k not in left] + left
    numbers |= dict(zip((k for k in sure if k not in numbers), fresh, strict=False))
    lanes = [
        Lane(
            index=index,
            lane_id=f"L{index}",
            kind="turn" if found[k].turn else "lane",
            direction=direction_of(found[k].points_m, p),
            points_m=found[k].points_m,
            width_m=found[k].width_m,
            confidence=found[k].confidence,
            vehicles=found[k].paths,
        )
        for k, index in numbers.items()
    ]
    return tuple(sorted(lanes, key=lambda lane: lane.index))


def gone_with(gone: Sequence[Lane], before: Sequence[Lane], now: Sequence[Lane]) -> tuple[Lane, ...]:
    """Return the lanes whose numbers were used and are not in force now, those that left first first."""
    here = {lane.index for lane in now}
    last = {lane.index for lane in before}
    still = [lane for lane in gone if lane.index not in here and lane.index not in last]
    return (*still, *(lane for lane in before if lane.index not in here))


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


def _known(found: Sequence[Learned], lanes: Sequence[Lane], p: IdentityParameters) -> Steps[dict[int, int]]:
    """Return for those found that are one of the lanes its number: the pairs that share most in all."""
    rows = []
    for new in found:
        rows.append([_shared_m(new.points_m, lane.points_m, p) for lane in lanes])
        yield len(lanes) * CALL_WORK
    shared = np.array(rows)
    if not shared.size:
        return {}
    one, other = (index.tolist() for index in linear_sum_assignment(shared, maximize=True))
    return {k: lanes[j].index for k, j in zip(one, other, strict=True) if shared[k, j] > 0}


def _shared_m(new: F64, old: F64, p: IdentityParameters) -> float:
    """Return along how many metres two lanes are one, 0 where that is not most of the shorter."""
    place = beside(new, old)
    same = np.cos(headings(new) - place.heading_rad) > p.same_way
    one = ~place.beyond & same & (np.abs(place.right_m) < p.offset_m)
    length = float(along(new)[-1])
    shared = float(one.mean()) * length
    return shared if shared >= p.overlap * min(length, float(along(old)[-1])) else 0.0
