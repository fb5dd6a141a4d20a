"""Put boxes that stand askew in a row of vehicles seen from the side onto those vehicles.

A box may be born of two vehicles one behind the other, or of one of each of two rows, and a vehicle of two
boxes; while they stand their points go on to feed them as if that were right. A second of points tells how
the rows stand (see `standing_rows`): a box that holds several vehicles goes onto one of them and the others
start tracks, a box that lies across its row is turned into it, of two boxes on one car one is dropped, and
the boxes on a bus or a truck become one that is as long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from service.tracking.births import MAX_STANDING_BOXES, ROW_POINTS, BirthParameters, standing_row
from service.tracking.model import F64, I64, Bool
from service.tracking.row_direction import direction_across
from service.tracking.row_kernels import chains
from service.tracking.standing_rows import Stood, mostly, stand, thin
from service.tracking.state import Tracks


@dataclass(frozen=True, slots=True)
class RearrangingParameters:
    """Which boxes may be moved, and when they are."""

    interval_frames: int = 20  # 0: never
    window_share: float = 0.8  # of the second that must have been seen: fewer frames leave holes in a side
    still_mps: float = 1.0
    travel_m: float = 5.0  # what has come further was seen moving, and its box is better known than its row
    side_on_cosine: float = 0.7  # of the aspect of a box seen from the side ...
    young_hits: int = 30  # ... while a younger one may lie any way
    near_m: float = 7.0  # points so far off a box may be of the next vehicle, all of it
    rate: float = 2.0  # points a frame of a vehicle that a box may be put onto
    same_m: float = 1.5  # a box whose centre is this near to a vehicle's is on it, or two partings agree ...
    same_share: float = 0.25  # ... or so much of its length
    askew_rad: float = 0.3  # it is turned into its row if it lies so far across it
    holds_along_m: float = 0.3  # a vehicle is held by a box that reaches so far beyond its centre ...
    holds_across_m: float = 0.8
    holds_row_m: float = 2.2  # ... or lies this near to its row and covers half of it
    car_m: float = 6.0  # no longer vehicle is sure to be one
    long_m: float = 7.0  # a longer one is, if it is found, too, with each vehicle so much likelier ...
    sure_nats: float = 2.0
    keep_nats: float = 2.0  # ... or, where a box has its length, so much less likely
    longer_m: float = 2.0  # a box has its length to this
    inside_m: float = 1.5  # a box whose centre is no further across a car is on it
    touch_along_m: float = 1.0  # boxes that overlap no more than this do not stand in one place
    touch_across_m: float = 0.3
    moved_std_m: float = 0.3


class _Block(NamedTuple):
    """Standing points that may be of one row, or of rows beside one another."""

    x: F64  # (N,) places
    y: F64
    times: F64  # points that each place stands for, of ...
    frames: int
    heading_rad: float  # of the rows


@dataclass
class _Boxes:
    """The boxes of all tracks while they are moved, and what comes of it."""

    tracks: Tracks
    mean: F64
    cov: F64
    heading_rad: F64
    heading_var: F64
    length_m: F64
    extent_m: F64
    turn_rate_radps: F64
    drift: F64
    ahead_m: F64
    put_on: set[int] = field(default_factory=set)  # boxes that have been moved
    gone: set[int] = field(default_factory=set)  # ... and that end
    born: list[F64] = field(default_factory=list)  # rows of Births

    def put(self, i: int, onto: Stood, birth: BirthParameters, p: RearrangingParameters) -> None:
        """Put box i onto a vehicle; it points the way that it pointed, or the nearer one."""
        self.mean[i] = (onto.x_m, 0.0, 0.0, onto.y_m, 0.0, 0.0)
        turn = (onto.heading_rad - self.heading_rad[i] + 0.5 * math.pi) % math.pi - 0.5 * math.pi
        self.heading_rad[i] += turn
        if abs(turn) > p.askew_rad:  # which end is its front nobody knows
            self.heading_var[i] = max(self.heading_var[i], birth.row_heading_std_rad**2)
        self.length_m[i], self.extent_m[i] = onto.length_m, np.nan
        self.turn_rate_radps[i] = self.drift[i] = self.ahead_m[i] = 0.0
        for axis in (0, 3):
            self.cov[i, axis, axis] += p.moved_std_m**2
        self.put_on.add(i)

    def as_put(self) -> Tracks:
        """Return all tracks with their boxes as they are now, the same object where none has been moved."""
        if not self.put_on:
            return self.tracks
        return self.tracks.but(
            mean=self.mean, cov=self.cov, heading_rad=self.heading_rad, heading_var=self.heading_var,
            length_m=self.length_m, extent_m=self.extent_m, turn_rate_radps=self.turn_rate_radps,
            drift=self.drift, ahead_m=self.ahead_m,
        )  # fmt: skip

    def left(self) -> Tracks:
        """Return the tracks that live on, the same object where nothing has changed."""
        if not self.gone:
            return self.as_put()
        stay = np.ones(len(self.tracks), np.bool_)
        stay[list(self.gone)] = False
        return self.as_put().take(stay)


def rearrange(  # noqa: PLR0913, PLR0917 - tracks, points, and what is known of the road there
    tracks: Tracks, points: F64, frames: int, driven: Bool, road_heading_rad: F64, birth: BirthParameters,
    p: RearrangingParameters,
) -> tuple[Tracks, list[F64]]:  # fmt: skip
    """Return the tracks with the boxes of standing rows put right, and rows for vehicles without a box.

    points (N, POINT_COLUMNS): all standing points of the last `frames` frames that are no clutter, claimed or
    not; driven (N,): vehicles have driven there, in direction road_heading_rad (N,). A row has the columns
    that `births.gather` takes.
    """
    which = _movable(tracks, p)
    if not len(which) or len(points) < birth.standing_cluster_points:
        return tracks, []
    x, y, times, first = thin(points)
    near = _near(tracks, which, x, y, p.near_m)
    x, y, times = x[near], y[near], times[near]
    on_road, along = driven[first][near], road_heading_rad[first][near]
    boxes = _Boxes(
        tracks, tracks.mean.copy(), tracks.cov.copy(), tracks.heading_rad.copy(), tracks.heading_var.copy(),
        tracks.length_m.copy(), tracks.extent_m.copy(), tracks.turn_rate_radps.copy(), tracks.drift.copy(),
        tracks.ahead_m.copy(),
    )  # fmt: skip
    block = chains(x, y, birth.rows.reach_m)
    for b in np.unique(block):
        mine = block == b
        if times[mine].sum() < 2.0 * p.rate * frames:
            continue  # one vehicle at the most
        u, v, n = x[mine], y[mine], times[mine]
        across = direction_across(u, v, n, frames, on_road[mine], along[mine], birth.rows)
        if across is None:
            continue
        found, sure = _parted(boxes, which, _Block(u, v, n, frames, across), birth, p)
        if len(found) > 1 or sure:
            _settle(boxes, which, found, sure, birth, p, driven=mostly(on_road[mine]))
    boxes.born.sort(key=lambda row: -row[ROW_POINTS])  # the best seen
    return boxes.left(), boxes.born[:MAX_STANDING_BOXES]


def _parted(
    boxes: _Boxes, which: I64, block: _Block, birth: BirthParameters, p: RearrangingParameters
) -> tuple[list[Stood], list[Stood]]:
    """Return the vehicles of one block of points, and those of them that are long for certain.

    Two cars with an echo in the gap look like a truck with a weak place in its side. So a long vehicle is
    certain where a parting that takes vehicles for likelier finds it, too; and once a box has its length, and
    no other lies in it, as long as one that takes them for less likely does.
    """

    def parted(nats: float) -> list[Stood]:
        rows = replace(birth.rows, vehicle_nats=birth.rows.vehicle_nats + nats)
        found, _ = stand(block.x, block.y, block.times, block.frames, block.heading_rad, birth.length_m, rows)
        return [f for f in found if f.rate >= p.rate]

    found, now = parted(0.0), boxes.as_put()
    known = [i for i in which.tolist() if i not in boxes.gone and now.length_m[i] >= p.long_m]
    known = [i for i in known if _near_block(now, i, block)]
    sure = [
        f
        for f in (parted(p.keep_nats) if known else [])
        if f.length_m >= p.long_m and _known_as_one(now, known, f, p)
    ]
    found = [f for f in found if not any(_covers(long, f, p) for long in sure)] + sure
    asked = [f for f in found if f.length_m >= p.long_m and f not in sure]
    likelier = parted(-p.sure_nats) if asked else []
    return found, sure + [f for f in asked if any(_same(f, other, p) for other in likelier)]


def _near_block(t: Tracks, i: int, block: _Block) -> bool:
    apart_m = np.hypot(block.x - t.x_m[i], block.y - t.y_m[i])
    return bool(apart_m.min() < 0.5 * t.length_m[i])


def _known_as_one(t: Tracks, known: list[int], f: Stood, p: RearrangingParameters) -> bool:
    """Return whether the only box in a long vehicle is one of the long ones that are known, and as long."""
    here = [i for i in np.flatnonzero(t.confirmed).tolist() if _inside(t, i, f, p)]
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


def _settle(  # noqa: PLR0913, PLR0917 - boxes, vehicles, and what is known of the road there
    boxes: _Boxes, which: I64, found: list[Stood], sure: list[Stood], birth: BirthParameters,
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
        held = sorted((_apart_m(tracks, i, found[k]), k) for k in free if _holds(tracks, i, found[k], p))
        if i not in on:
            if not held or _nearer_box(tracks, which, on, i, found[held[0][1]], p):
                continue
            onto, others = held[0][1], [k for _, k in held[1:]]
        else:
            onto, others = on[i], [k for _, k in held]
            if not others and not _askew(tracks, i, found[onto], p):
                continue
        if any(found[k].rate < least for k in others):
            continue  # without the box it would have none
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
        if found[k].rate >= least and not any(_touch(now, i, found[k], birth, p) for i in stay):
            boxes.born.append(standing_row(found[k], told=driven, p=birth))


def _unite(  # noqa: PLR0913, PLR0917 - as for `_settle`
    boxes: _Boxes, which: I64, long: dict[int, Stood], on: dict[int, int], birth: BirthParameters,
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
        here = [i for i in here if _inside(now, i, f, p)]
        if not here:
            continue
        if any(on[i] == k for i in on.keys() - movable):
            boxes.gone |= set(here)
            continue
        keep = here[0]
        if _apart_m(now, keep, f) > p.same_m or not _as_long(now, keep, f, p):
            boxes.put(keep, f, birth, p)
        boxes.gone |= set(here[1:])


def _drop(  # noqa: PLR0913, PLR0917 - as for `_settle`
    boxes: _Boxes, which: I64, found: list[Stood], on: dict[int, int], birth: BirthParameters,
    p: RearrangingParameters,
) -> None:  # fmt: skip
    """Let one of the boxes on a car live, the oldest as where tracks are merged, and put it onto the car."""
    movable = set(which.tolist())
    for i, k in sorted(on.items()):
        if found[k].length_m > p.car_m or i in boxes.gone:
            continue
        spare = movable - set(on) - boxes.put_on - boxes.gone
        here = {i} | {j for j in spare if _inside(boxes.tracks, j, found[k], p)}
        keep = min(here) if i in movable else i
        if keep != i:
            boxes.put(keep, found[k], birth, p)
        boxes.gone |= here - {keep}


def _movable(t: Tracks, p: RearrangingParameters) -> I64:
    """Return which confirmed tracks stand where they were born and are seen from the side, or are young."""
    still = t.confirmed & (t.speed_mps < p.still_mps)
    still &= t.come_m < p.travel_m
    end_on = np.abs(np.cos(t.heading_rad - np.arctan2(t.x_m, t.y_m)))
    return np.flatnonzero(still & ((end_on < p.side_on_cosine) | (t.hits < p.young_hits)))


def _near(t: Tracks, which: I64, x: F64, y: F64, margin_m: float) -> Bool:
    """Return which places (N,) lie in one of the boxes, or so near to it."""
    out = np.zeros(len(x), np.bool_)
    for i in which.tolist():
        along, across = _seen_from(t, i, x, y)
        out |= (along < 0.5 * t.length_m[i] + margin_m) & (across < 0.5 * t.width_m[i] + margin_m)
    return out


def _on(t: Tracks, found: list[Stood], p: RearrangingParameters) -> dict[int, int]:
    """Return the vehicle that each box is on, the nearest pairs first; no two boxes on one vehicle."""
    pairs = []
    for i in np.flatnonzero(t.confirmed).tolist():
        for k, f in enumerate(found):
            apart = _apart_m(t, i, f)
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
    return any(_apart_m(t, j, f) < _apart_m(t, i, f) and _holds(t, j, f, p) for j in others)


def _askew(t: Tracks, i: int, f: Stood, p: RearrangingParameters) -> bool:
    return abs(math.sin(float(t.heading_rad[i]) - f.heading_rad)) > math.sin(p.askew_rad)


def _apart_m(t: Tracks, i: int, f: Stood) -> float:
    return math.hypot(f.x_m - float(t.x_m[i]), f.y_m - float(t.y_m[i]))


def _seen_from(t: Tracks, i: int, x: F64 | float, y: F64 | float) -> tuple[F64, F64]:
    """Return how far places are along box i and across it, from its centre."""
    s, c = math.sin(t.heading_rad[i]), math.cos(t.heading_rad[i])
    dx, dy = x - t.x_m[i], y - t.y_m[i]
    return np.abs(s * dx + c * dy), np.abs(c * dx - s * dy)


def _seen_in_row(t: Tracks, i: int, f: Stood) -> tuple[float, float]:
    """Return how far the centre of box i is along the vehicle's row and across it, from the vehicle's."""
    s, c = math.sin(f.heading_rad), math.cos(f.heading_rad)
    dx, dy = float(t.x_m[i]) - f.x_m, float(t.y_m[i]) - f.y_m
    return abs(s * dx + c * dy), abs(c * dx - s * dy)


def _holds(t: Tracks, i: int, f: Stood, p: RearrangingParameters) -> bool:
    """Return whether box i has the vehicle's centre in it, or half of the vehicle."""
    along, across = _seen_from(t, i, f.x_m, f.y_m)
    if along < 0.5 * t.length_m[i] + p.holds_along_m and across < 0.5 * t.width_m[i] + p.holds_across_m:
        return True
    u, w = _seen_in_row(t, i, f)
    turned = abs(math.cos(float(t.heading_rad[i]) - f.heading_rad))
    half = 0.5 * (t.length_m[i] * turned + t.width_m[i] * math.sqrt(1.0 - turned * turned))
    covered = min(u + 0.5 * f.length_m, half) - max(u - 0.5 * f.length_m, -half)
    return bool(w < p.holds_row_m and covered > 0.5 * f.length_m)


def _inside(t: Tracks, i: int, f: Stood, p: RearrangingParameters) -> bool:
    """Return whether the centre of box i lies in the vehicle."""
    u, w = _seen_in_row(t, i, f)
    return u < 0.5 * f.length_m + p.holds_along_m and w < p.inside_m


def _touch(t: Tracks, i: int, f: Stood, birth: BirthParameters, p: RearrangingParameters) -> bool:
    """Return whether box i and a box of the vehicle overlap."""
    along, across = _seen_from(t, i, f.x_m, f.y_m)
    turned = abs(math.cos(float(t.heading_rad[i]) - f.heading_rad))
    sideways = math.sqrt(1.0 - turned * turned)
    half_along = 0.5 * (f.length_m * turned + birth.width_m * sideways)
    half_across = 0.5 * (f.length_m * sideways + birth.width_m * turned)
    return bool(
        along < 0.5 * t.length_m[i] + half_along - p.touch_along_m
        and across < 0.5 * t.width_m[i] + half_across - p.touch_across_m
    )
