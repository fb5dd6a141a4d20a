"""Tell posts that have a track from vehicles that stand.

When a sensor starts nobody knows yet where posts stand. Each gives one echo a frame, as steady as a
vehicle's, and a box is long enough for three of them. Later a box that waits for a hidden vehicle may come to
rest on one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.tracking.kernel import kernel, part
from service.tracking.model import F64, I64, U8, Bool, TrackStatus
from service.tracking.state import Tracks

_TENTATIVE, _CONFIRMED = int(TrackStatus.TENTATIVE), int(TrackStatus.CONFIRMED)


@dataclass(frozen=True, slots=True)
class PostParameters:
    """When a track that stands in plain sight is on a post.

    Points are those of a hit: a post gives one, and what is seen in plain sight of a standing vehicle four or
    five (of those in labelled scenes that had never moved 95 % gave more than 3.0 at 50 to 110 m).
    """

    still_mps: float = 1.0
    after_s: float = 1.0  # age from which a track may be found to be on a post
    travel_m: float = 15.0  # off the driven road: one that has not come further ...
    points: float = 1.8  # ... and gives fewer points
    weak_db: float = 6.0  # anywhere: one whose echoes are so much weaker than those of vehicles ...
    weak_points: float = 1.8
    unmoved_m: float = 8.0  # one that has never come further than from post to post ...
    unmoved_points: float = 3.1  # ... and gives no more points than three posts:
    alone_s: float = 2.0  # where nobody is known to have driven, from this age on ...
    unmoved_s: float = 20.0  # ... or from this one, with a vehicle that certainly stands so near, ...
    company_m: float = 25.0
    company_points: float = 2.6  # ... or one in a row across the line of sight, ...
    red_light_s: float = 240.0  # ... or from this one, with one that gives more than three posts
    # anywhere, hidden or not: one that has come no more than `unmoved_m` nearer or further away ...
    through_m: float = 1.0  # ... once a vehicle drives through, as near its middle ...
    through_mps: float = 3.0  # ... as fast ...
    through_hits: int = 20  # ... and as certain to be one


class Evidence(NamedTuple):
    """What else tells of T tracks whether they are posts."""

    hidden: Bool  # (T,) a nearer vehicle may hide it: few points say nothing
    driven: Bool  # (T,) vehicles have driven here, or too few have been seen to say
    known_road: Bool  # (T,) vehicles are known to have driven here, or one to have gone here
    crept: Bool  # (T,) was seen to stop or to set off


def on_posts(
    t: Tracks, seen: Evidence, time_us: int, echo_reference_db: float, p: PostParameters
) -> tuple[Bool, Bool]:
    """Return which tracks (T,) are on posts, and which of them are beyond doubt.

    Those are what vehicles drive through, and what gives weaker echoes than vehicles.
    """
    return _on_posts(
        t.mean, t.heading_rad, t.length_m, t.status, t.hits, t.empty, t.points_per_hit, t.echo_db,
        t.born_x_m, t.born_y_m, t.born_us, time_us, seen.hidden, seen.driven, seen.known_road, seen.crept,
        (p.still_mps, p.after_s, p.travel_m, p.points, p.weak_points, p.unmoved_m, p.unmoved_points,
         p.alone_s, p.unmoved_s, p.red_light_s, p.company_points, p.company_m),
        (p.through_m, p.through_mps, float(p.through_hits)), echo_reference_db - p.weak_db,
    )  # fmt: skip


@kernel
def _on_posts(
    mean: F64, heading: F64, length: F64, status: U8, hits: I64, empty: I64, points: F64, echo_db: F64,
    born_x: F64, born_y: F64, born_us: I64, time_us: int, hidden: Bool, driven: Bool, known_road: Bool,
    crept: Bool, q: tuple[float, ...], vehicle: tuple[float, float, float], weak_db: float,
) -> tuple[Bool, Bool]:  # fmt: skip
    still, after, most, few, weak_few, unmoved, unmoved_few, alone_s, unmoved_s, red_s, row, company = q
    out, certain = np.zeros(len(points), np.bool_), np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        age_s = (time_us - born_us[i]) / 1e6
        if math.hypot(mean[i, 1], mean[i, 4]) >= still or crept[i] or age_s <= after:
            continue
        travel = math.hypot(mean[i, 0] - born_x[i], mean[i, 3] - born_y[i])
        if travel >= most:
            continue
        nearer = abs(math.hypot(mean[i, 0], mean[i, 3]) - math.hypot(born_x[i], born_y[i]))
        if points[i] < unmoved_few and nearer < unmoved:
            certain[i] = _driven_through(i, mean, heading, length, status, hits, empty, vehicle)
        certain[i] |= not hidden[i] and points[i] < weak_few and echo_db[i] < weak_db
        out[i] = certain[i]
        if hidden[i]:
            continue
        out[i] |= points[i] < few and not driven[i]
        if points[i] < unmoved_few and travel < unmoved and not known_road[i] and age_s > alone_s:
            queue = (still, unmoved_few if age_s > unmoved_s else row, company)
            out[i] |= age_s > red_s or not _in_company(i, mean, status, points, crept, queue)
    return out, certain


@part
def _driven_through(
    i: int, mean: F64, heading: F64, length: F64, status: U8, hits: I64, empty: I64,
    q: tuple[float, float, float],
) -> bool:  # fmt: skip
    """Return whether a vehicle drives through track i now that is certain to be one, and seen."""
    near, fast, settled = q
    for j in range(len(hits)):
        if j == i or empty[j] != 0 or status[j] != _CONFIRMED or hits[j] < settled:
            continue
        dx, dy = mean[i, 0] - mean[j, 0], mean[i, 3] - mean[j, 3]
        s, c = math.sin(heading[j]), math.cos(heading[j])
        if abs(c * dx - s * dy) < near and abs(s * dx + c * dy) < 0.5 * length[j]:
            if math.hypot(mean[j, 1], mean[j, 4]) >= fast:
                return True
    return False


@part
def _in_company(
    i: int, mean: F64, status: U8, points: F64, crept: Bool, q: tuple[float, float, float]
) -> bool:
    """Return whether a vehicle stands near track i that is none of these posts: queues are of several."""
    still, few, near = q
    for j in range(len(points)):
        if j == i or status[j] == _TENTATIVE or not (crept[j] or points[j] >= few):
            continue
        if math.hypot(mean[j, 1], mean[j, 4]) > still:
            continue
        if math.hypot(mean[i, 0] - mean[j, 0], mean[i, 3] - mean[j, 3]) < near:
            return True
    return False
