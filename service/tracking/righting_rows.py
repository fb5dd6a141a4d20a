"""Put boxes that stand askew in a row of vehicles seen from the side onto those vehicles.

A box may be born of two vehicles one behind the other, or of one of each of two rows, and a vehicle of two
boxes; while they stand their points go on to feed them as if that were right. A second of points tells how
the rows stand (see `standing_rows`): a box that holds several vehicles goes onto one of them and the others
start tracks, a box that lies across its row is turned into it, of two boxes on one car one is dropped, and
the boxes on a bus or a truck become one that is as long.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from service.tracking.births import BirthParameters, standing_row
from service.tracking.model import I64
from service.tracking.moved_boxes import (
    Block,
    Boxes,
    RearrangingParameters,
    apart_m,
    askew,
    holds,
    inside,
    touch,
)  # fmt: skip
from service.tracking.standing_rows import Stood, stand
from service.tracking.state import Tracks


def parted(  # noqa: PLR0913, PLR0917 - boxes, points, and the direction of the rows
    boxes: Boxes, which: I64, block: Block, heading_rad: float, birth: BirthParameters,
    p: RearrangingParameters,
) -> tuple[list[Stood], list[Stood]]:  # fmt: skip
    """Return the vehicles of rows in that direction, and those of them that are long for certain.

    Two cars with an echo in the gap look like a truck with a weak place in its side. So a long vehicle is
    certain where a parting that takes vehicles for likelier finds it, too; and once a box has its length, and
    no other lies in it, as long as one that takes them for less likely does.
    """

    def vehicles(nats: float) -> list[Stood]:
        rows = replace(birth.rows, vehicle_nats=birth.rows.vehicle_nats + nats)
        found, _ = stand(block.x, block.y, block.times, block.frames, heading_rad, birth.length_m, rows)
        return [f for f in found if f.rate >= p.rate]

    found, now = vehicles(0.0), boxes.as_put()
    known = [i for i in which.tolist() if i not in boxes.gone and now.length_m[i] >= p.long_m]
    known = [i for i in known if _near_block(now, i, block)]
    sure = [
        f
        for f in (vehicles(p.keep_nats) if known else [])
        if f.length_m >= p.long_m and _known_as_one(now, known, f, p)
    ]
    found = [f for f in found if not any(_covers(long, f, p) for long in sure)] + sure
    asked = [f for f in found if f.length_m >= p.long_m and f not in sure]
    likelier = vehicles(-p.sure_nats) if asked else []
    return found, sure + [f for f in asked if any(_same(f, other, p) for other in likelier)]


def _near_block(t: Tracks, i: int, block: Block) -> bool:
    apart_m = np.hypot(block.x - t.x_m[i], block.y - t.y_m[i])
    return bool(apart_m.min() < 0.5 * t.length_m[i])


def _known_as_one(t: Tracks, known: list[int], f: Stood, p: RearrangingParameters) -> bool:
    """Return whether the only box in a long vehicle is one of the long ones that are known, and as long."""
    here = [i for i in np.flatnonzero(t.confirmed).tolist() if inside(t, i, f, p)]
    return len(here) == 1 and here[0] in known and _as_long(t, here[0], f, p)


def _as_long(t: Tracks, i: int, f: Stood, p: RearrangingParameters) -> bool:
    return abs(float(t.length_m[i]) - f.length_m) < p.longer_m


def _covers(long: Stood, f: Stood, p: RearrangingParameters) -> bool:
    """Return whether the centre of a vehicle lies in a long one."""
    s, c = math.sin(long.heading_rad), math.cos(long.heading_rad)
    dx, dy = f.x_m - long.x_m, f.y_m - long.y_m
    return abs(s * dx + c * dy) < 0.5 * long.length_m and abs(c * dx - s * dy) < p.inside_m


def _same(f: Stood, other: Stood, p: RearrangingParameters) -> bool:
    """Return whether two partings of the same points found the same long vehicle."""
    near = math.hypot(other.x_m - f.x_m, other.y_m - f.y_m) < p.same_m
    return near and abs(other.length_m - f.length_m) < p.same_m


def settle(  # noqa: PLR0913, PLR0917 - boxes, vehicles, and what is known of the road there
    boxes: Boxes, which: I64, found: list[Stood], sure: list[Stood], birth: BirthParameters,
    p: RearrangingParameters, *, driven: bool,
) -> None:  # fmt: skip
    """Put the boxes `which` onto the vehicles found in one block of points, once each.

    sure: those of the vehicles that are long for certain.
    """
    tracks = boxes.tracks
    least = birth.driven_points_per_frame if driven else birth.row_points_per_frame
    on = _on(tracks, found, p)  # the vehicle of each box that is on one
    free = set(range(len(found))) - set(on.values())
    for i in which.tolist():
        if i in boxes.put_on | boxes.gone:  # by another block
            continue
        held = sorted((apart_m(tracks, i, found[k]), k) for k in free if holds(tracks, i, found[k], p))
        if i not in on:
            if not held or _nearer_box(tracks, which, on, i, found[held[0][1]], p):
                continue
            onto, others = held[0][1], [k for _, k in held[1:]]
        else:
            onto, others = on[i], [k for _, k in held]
            if not others and not askew(tracks, i, found[onto], p):
                continue
        if any(found[k].rate < least for k in others):
            continue  # without the box it would have none
        if found[onto] not in sure and _holds_others(boxes, i, found[onto], p):
            continue  # it may be them
        on[i] = onto
        boxes.put(i, found[onto], birth, p)
        others = [k for k in others if found[k] not in sure]  # its own box goes onto it, or it starts a track
        boxes.born += [standing_row(found[k], told=driven, p=birth) for k in others]
        free -= {onto, *others}
    _unite(boxes, which, {k: f for k, f in enumerate(found) if f in sure}, on, birth, p)
    _drop(boxes, which, found, on, birth, p)
    now = boxes.as_put()
    stay = [i for i in np.flatnonzero(tracks.confirmed).tolist() if i not in boxes.gone]
    for k in sorted(free):
        if found[k].rate >= least and not any(touch(now, i, found[k], birth, p) for i in stay):
            boxes.born.append(standing_row(found[k], told=driven, p=birth))


def _holds_others(boxes: Boxes, i: int, f: Stood, p: RearrangingParameters) -> bool:
    """Return whether the centre of another box than i lies in a vehicle that is longer than a car."""
    if f.length_m < p.long_m:
        return False
    now = boxes.as_put()
    others = [j for j in np.flatnonzero(now.confirmed).tolist() if j != i and j not in boxes.gone]
    return any(inside(now, j, f, p) for j in others)


def _unite(  # noqa: PLR0913, PLR0917 - as for `_settle`
    boxes: Boxes, which: I64, long: dict[int, Stood], on: dict[int, int], birth: BirthParameters,
    p: RearrangingParameters,
) -> None:  # fmt: skip
    """Put the oldest of the boxes in each long vehicle onto all of it, and let the others end.

    long: the vehicles that are long for certain, by their numbers among all. A box that is on another vehicle
    stays there; where one is on it that may not be moved, that is the one which is known better.
    """
    movable = set(which.tolist())
    for k, f in long.items():
        now = boxes.as_put()
        here = [i for i in which.tolist() if i not in boxes.gone and on.get(i, k) == k]
        here = [i for i in here if inside(now, i, f, p)]
        if not here:
            continue
        if any(on[i] == k for i in on.keys() - movable):
            boxes.gone |= set(here)
            continue
        keep = here[0]
        if apart_m(now, keep, f) > p.same_m or not _as_long(now, keep, f, p):
            boxes.put(keep, f, birth, p)
        boxes.gone |= set(here[1:])


def _drop(  # noqa: PLR0913, PLR0917 - as for `_settle`
    boxes: Boxes, which: I64, found: list[Stood], on: dict[int, int], birth: BirthParameters,
    p: RearrangingParameters,
) -> None:  # fmt: skip
    """Let one of the boxes on a car live, the oldest as where tracks are merged, and put it onto the car."""
    movable = set(which.tolist())
    for i, k in sorted(on.items()):
        if found[k].length_m > p.car_m or i in boxes.gone:
            continue
        spare = movable - set(on) - boxes.put_on - boxes.gone
        here = {i} | {j for j in spare if inside(boxes.tracks, j, found[k], p)}
        keep = min(here) if i in movable else i
        if keep != i:
            boxes.put(keep, found[k], birth, p)
        boxes.gone |= here - {keep}


def _on(t: Tracks, found: list[Stood], p: RearrangingParameters) -> dict[int, int]:
    """Return the vehicle that each box is on, the nearest pairs first; no two boxes on one vehicle."""
    pairs = []
    for i in np.flatnonzero(t.confirmed).tolist():
        for k, f in enumerate(found):
            apart = apart_m(t, i, f)
            if apart < max(p.same_m, p.same_share * f.length_m):
                pairs.append((apart, k, i))
    on: dict[int, int] = {}
    for _, k, i in sorted(pairs):
        if i not in on and k not in on.values():
            on[i] = k
    return on


def _nearer_box(  # noqa: PLR0913, PLR0917 - which boxes, and on which vehicles they are
    t: Tracks, which: I64, on: dict[int, int], i: int, f: Stood, p: RearrangingParameters
) -> bool:
    """Return whether another box that is on no vehicle holds this one, and is nearer to it."""
    others = (j for j in which.tolist() if j != i and j not in on)
    return any(apart_m(t, j, f) < apart_m(t, i, f) and holds(t, j, f, p) for j in others)
