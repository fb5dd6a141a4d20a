"""Boxes of standing vehicles while they are moved, and how boxes and vehicles lie to one another."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from service.tracking.births import BirthParameters
from service.tracking.model import F64, I64, Bool
from service.tracking.standing_rows import Stood
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
    slid_m: float = 10.0  # what has come further is not moved in a lane, either: what is born wrong slides
    lane_askew_rad: float = 0.4  # a box lies along such a lane if it is turned no more ...
    lane_beside_m: float = 1.1  # ... and on a vehicle of it if its centre is no further across
    gain_nats: float = 2.0  # of the likelihood of the points that a box moved in a lane must gain


class Block(NamedTuple):
    """Standing points near one another."""

    x: F64  # (N,) places
    y: F64
    times: F64  # points that each place stands for, of ...
    frames: int


@dataclass
class Boxes:
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

    @classmethod
    def of(cls, t: Tracks) -> Boxes:
        """Return the boxes of these tracks, none of them moved yet."""
        return cls(
            t, t.mean.copy(), t.cov.copy(), t.heading_rad.copy(), t.heading_var.copy(), t.length_m.copy(),
            t.extent_m.copy(), t.turn_rate_radps.copy(), t.drift.copy(), t.ahead_m.copy(),
        )  # fmt: skip

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


def near(t: Tracks, which: I64, x: F64, y: F64, margin_m: float) -> Bool:
    """Return which places (N,) lie in one of the boxes, or so near to it."""
    out = np.zeros(len(x), np.bool_)
    for i in which.tolist():
        along, across = seen_from(t, i, x, y)
        out |= (along < 0.5 * t.length_m[i] + margin_m) & (across < 0.5 * t.width_m[i] + margin_m)
    return out


def askew(t: Tracks, i: int, f: Stood, p: RearrangingParameters) -> bool:
    """Return whether box i lies across the row of the vehicle."""
    return abs(math.sin(float(t.heading_rad[i]) - f.heading_rad)) > math.sin(p.askew_rad)


def apart_m(t: Tracks, i: int, f: Stood) -> float:
    """Return how far the centres of box i and of the vehicle are apart."""
    return math.hypot(f.x_m - float(t.x_m[i]), f.y_m - float(t.y_m[i]))


def seen_from(t: Tracks, i: int, x: F64 | float, y: F64 | float) -> tuple[F64, F64]:
    """Return how far places are along box i and across it, from its centre."""
    s, c = math.sin(t.heading_rad[i]), math.cos(t.heading_rad[i])
    dx, dy = x - t.x_m[i], y - t.y_m[i]
    return np.abs(s * dx + c * dy), np.abs(c * dx - s * dy)


def seen_in_row(t: Tracks, i: int, f: Stood) -> tuple[float, float]:
    """Return how far the centre of box i is along the vehicle's row and across it, from the vehicle's."""
    s, c = math.sin(f.heading_rad), math.cos(f.heading_rad)
    dx, dy = float(t.x_m[i]) - f.x_m, float(t.y_m[i]) - f.y_m
    return abs(s * dx + c * dy), abs(c * dx - s * dy)


def holds(t: Tracks, i: int, f: Stood, p: RearrangingParameters) -> bool:
    """Return whether box i has the vehicle's centre in it, or half of the vehicle."""
    along, across = seen_from(t, i, f.x_m, f.y_m)
    if along < 0.5 * t.length_m[i] + p.holds_along_m and across < 0.5 * t.width_m[i] + p.holds_across_m:
        return True
    u, w = seen_in_row(t, i, f)
    turned = abs(math.cos(float(t.heading_rad[i]) - f.heading_rad))
    half = 0.5 * (t.length_m[i] * turned + t.width_m[i] * math.sqrt(1.0 - turned * turned))
    covered = min(u + 0.5 * f.length_m, half) - max(u - 0.5 * f.length_m, -half)
    return bool(w < p.holds_row_m and covered > 0.5 * f.length_m)


def inside(t: Tracks, i: int, f: Stood, p: RearrangingParameters) -> bool:
    """Return whether the centre of box i lies in the vehicle."""
    u, w = seen_in_row(t, i, f)
    return u < 0.5 * f.length_m + p.holds_along_m and w < p.inside_m


def touch(t: Tracks, i: int, f: Stood, birth: BirthParameters, p: RearrangingParameters) -> bool:
    """Return whether box i and a box of the vehicle overlap."""
    along, across = seen_from(t, i, f.x_m, f.y_m)
    turned = abs(math.cos(float(t.heading_rad[i]) - f.heading_rad))
    sideways = math.sqrt(1.0 - turned * turned)
    half_along = 0.5 * (f.length_m * turned + birth.width_m * sideways)
    half_across = 0.5 * (f.length_m * sideways + birth.width_m * turned)
    return bool(
        along < 0.5 * t.length_m[i] + half_along - p.touch_along_m
        and across < 0.5 * t.width_m[i] + half_across - p.touch_across_m
    )
