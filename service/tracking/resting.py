"""Keep the numbers of vehicles that fell silent in view, and give them back to those that are seen again.

Behind a truck, or far back in a queue, a vehicle is hidden for longer than any prediction of where it is can
be trusted. Its track ends then, so that it claims nobody else's points; its number rests. A track that is
confirmed later is given the number when the vehicle can have come there: on in its lane, no farther than its
speed allows, and with everybody who drove ahead of it in that lane still ahead and everybody behind it still
behind. Nobody overtakes within a lane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, I64, Bool, TrackStatus
from service.tracking.state import Place, Resting, Tracks

_TENTATIVE = int(TrackStatus.TENTATIVE)
View = tuple[float, float, float]  # least and greatest range [m], greatest azimuth [rad]


@dataclass(frozen=True, slots=True)
class RestingParameters:
    """How long a number rests, and who is given it."""

    keep_s: float = 30.0  # longest that a number rests, since its track's last hit; 0: none ever does
    least_hits: int = 4
    apart_m: float = 1.5  # a track that ended this near a confirmed one was the same vehicle
    edge_m: float = 4.0  # what was this near the ends of the view has left it
    faint_frames: int = 10  # a track silent for so long, as likely not to exist as to, is as good as ended
    faint_log_odds: float = 0.0
    turn_rad: float = 0.6  # most that the vehicle may have turned ...
    turn_stds: float = 2.0  # ... and so many standard deviations of a heading that is still a guess
    across_m: float = 2.6  # that it may be found beside its way on, most of it the error of both places ...
    across_share: float = 0.02  # ... and so much of the way
    lane_m: float = 2.0  # who drove less than this beside it was in its lane
    narrow_m: float = 1.2  # motorcycles overtake within a lane
    order_m: float = 3.0  # ... and ahead or behind, not abreast, if this far along
    slack_m: float = 4.0  # error of both places along the way
    accel_mps2: float = 2.0  # that it may have gained on both its speeds ...
    accel_s: float = 4.0  # ... for so long
    led_m: float = 12.0  # from where those of its lane say that it went
    alone_m: float = 6.0  # the same, of one without anybody in its lane, from where its speed says ...
    alone_mps: float = 2.0  # ... and the more the longer it rested
    awaited_across_m: float = 1.5  # so near to its way, and no further on it, it may stand by now:
    awaited_m: float = 4.0  # from behind where its track ended to as much ahead ...
    awaited_s: float = 2.0  # ... and so many seconds of its speed


def settle(  # noqa: PLR0913, PLR0917 - two moments, and who rested between them
    resting: Resting, before: Tracks, after: Tracks, time_us: int, view: View, p: RestingParameters,
) -> tuple[Resting, Tracks]:  # fmt: skip
    """Return the numbers that rest after a frame and its tracks, some with the number that they had before.

    before, after: all tracks before the frame and after it, tentative ones too; view: the least and the
    greatest range at which the radar sees [m], and the greatest azimuth [rad] to either side. The tracks stay
    in order of number.
    """
    resting = expire(resting, time_us, p)
    if p.keep_s <= 0.0:
        return resting, after
    listed, known = _confirmed_numbers(after), _confirmed_numbers(before)
    if np.array_equal(listed, known):
        return resting, after
    if not set(known.tolist()).issuperset(listed.tolist()):  # numpy's isin takes ten times as long
        resting, after = _give_all(resting, known, after, time_us, view, p)
    here = set(after.number.tolist())
    ended = np.flatnonzero(before.confirmed)
    ended = ended[[number not in here for number in before.number[ended].tolist()]]
    if len(ended):
        resting = _rest(resting, before, after, ended, time_us, view, p)
    return resting, after


def expire(resting: Resting, time_us: int, p: RestingParameters) -> Resting:
    """Return the numbers that still rest at a time; without frames none comes to rest."""
    if not len(resting.number):
        return resting
    stay = time_us - resting.hit_us <= 1e6 * p.keep_s
    return resting if stay.all() else resting.take(stay)


def _confirmed_numbers(tracks: Tracks) -> I64:
    return np.asarray(tracks.number[tracks.status != _TENTATIVE])


def awaited(resting: Resting, x_m: F64, y_m: F64, p: RestingParameters) -> Bool:
    """Return at which places (N,) a resting vehicle may stand by now: what stands there is no post."""
    s, c = np.sin(resting.heading_rad)[:, None], np.cos(resting.heading_rad)[:, None]
    dx, dy = x_m - resting.x_m[:, None], y_m - resting.y_m[:, None]
    along, across = s * dx + c * dy, c * dx - s * dy
    most = p.awaited_m + p.awaited_s * resting.speed_mps[:, None]
    here = (np.abs(across) <= p.awaited_across_m) & (along >= -p.awaited_m) & (along <= most)
    return np.asarray(here.any(axis=0))


# ---------------------------------------------------------------- numbers that come to rest


def _rest(  # noqa: PLR0913, PLR0917 - as for `settle`
    resting: Resting, before: Tracks, after: Tracks, ended: I64, time_us: int,
    view: View, p: RestingParameters,
) -> Resting:  # fmt: skip
    """Return the resting numbers with those of the tracks that ended in view and not beside another."""
    x, y = before.x_m[ended], before.y_m[ended]
    range_m, azimuth_rad = np.hypot(x, y), np.abs(np.arctan2(x, y))
    good = (before.hits[ended] >= p.least_hits) & (before.empty[ended] > 0)
    good &= (range_m > view[0] + p.edge_m) & (range_m < view[1] - p.edge_m)
    good &= (view[2] - azimuth_rad) * range_m > p.edge_m
    if not good.any():
        return resting
    others = after.confirmed
    away = np.hypot(x[:, None] - after.x_m[others], y[:, None] - after.y_m[others])
    good &= ~(away < p.apart_m).any(axis=1)
    for i in ended[good].tolist():
        mates = _mates(before, i, p)
        resting = resting.join(
            Resting(
                number=before.number[[i]], hit_us=before.hit_us[[i]],
                ended_us=np.array([time_us], dtype=np.int64), x_m=before.x_m[[i]], y_m=before.y_m[[i]],
                speed_mps=before.speed_mps[[i]], heading_rad=before.heading_rad[[i]],
                mate_of=np.full(len(mates), before.number[i]), mate=before.number[mates],
                mate_x_m=before.x_m[mates], mate_y_m=before.y_m[mates],
            )
        )  # fmt: skip
    return resting


def _mates(tracks: Tracks, i: int, p: RestingParameters) -> I64:
    """Return the confirmed tracks in the lane of track i, itself excepted."""
    _, across = _apart(_place(tracks, i), tracks.x_m, tracks.y_m)
    here = tracks.confirmed & (np.abs(across) <= p.lane_m) & (tracks.width_m > p.narrow_m)
    here[i] = False
    return np.flatnonzero(here)


# ---------------------------------------------------------------- numbers that are given back


def _give_all(  # noqa: PLR0913, PLR0917 - as for `settle`
    resting: Resting, known: I64, after: Tracks, time_us: int, view: View,
    p: RestingParameters,
) -> tuple[Resting, Tracks]:  # fmt: skip
    """Return what `_give_back` does for the tracks confirmed now; those as good as ended give theirs, too."""
    faint = after.confirmed & (after.empty >= p.faint_frames) & (after.log_odds <= p.faint_log_odds)
    if not len(resting.number) and not faint.any():
        return resting, after
    rest, others = after.take(faint), after.take(~faint)
    offered = _rest(resting, after, others, np.flatnonzero(faint), time_us, view, p) if len(rest) else resting
    fresh = np.flatnonzero(others.confirmed & ~np.isin(others.number, known))
    offered, others = _give_back(offered, others, fresh, time_us, p)
    stay = rest.take(~np.isin(rest.number, others.number))
    offered = offered.take(~np.isin(offered.number, stay.number))
    if not len(stay):
        return offered, others
    tracks = others.join(stay)
    return offered, tracks.take(np.argsort(tracks.number, kind="stable"))


def _give_back(
    resting: Resting, tracks: Tracks, fresh: I64, time_us: int, p: RestingParameters
) -> tuple[Resting, Tracks]:
    """Return the numbers that rest on, and the tracks with those of the fresh ones that they are given."""
    place = {int(number): i for i, number in enumerate(tracks.number) if tracks.status[i] != _TENTATIVE}
    number = tracks.number.copy()
    for i in fresh.tolist():
        misfit = [
            _misfit(resting, k, tracks, i, place, time_us, p) if hit_us < tracks.born_us[i] else math.inf
            for k, hit_us in enumerate(resting.hit_us.tolist())
        ]
        best = int(np.argmin(misfit)) if misfit else -1
        if best < 0 or misfit[best] == math.inf:
            continue
        number[i] = resting.number[best]
        place[int(number[i])] = place.pop(int(tracks.number[i]))
        resting = resting.take(np.arange(len(resting.number)) != best)
    if np.array_equal(number, tracks.number):
        return resting, tracks
    return resting, tracks.but(number=number).take(np.argsort(number, kind="stable"))


def _misfit(  # noqa: PLR0913, PLR0917 - who rests, who was found, and all others
    resting: Resting, k: int, tracks: Tracks, i: int, place: dict[int, int], time_us: int,
    p: RestingParameters,
) -> float:  # fmt: skip
    """Return how far track i is from where resting vehicle k should be now [m]; infinite where it cannot be.

    place: the confirmed tracks by number. The vehicles of its lane tell how far it went, else its speeds do.
    """
    was, here = resting.place(k), _place(tracks, i)
    turn = (here.heading_rad - was.heading_rad + math.pi) % (2.0 * math.pi) - math.pi
    along, across = (float(part) for part in _apart(was, here.x_m, here.y_m))
    since_s = (time_us - int(resting.hit_us[k])) / 1e6
    fastest = max(here.speed_mps, was.speed_mps)
    most = fastest * since_s + 0.5 * p.accel_mps2 * min(since_s, p.accel_s) ** 2 + p.slack_m
    beside = abs(across) > p.across_m + p.across_share * abs(along)
    turned = abs(turn) > p.turn_rad + p.turn_stds * math.sqrt(float(tracks.heading_var[i]))
    if turned or beside or not -p.slack_m <= along <= most:
        return math.inf
    went = _went(resting, k, here, tracks, place, p)
    if went is None:
        return math.inf
    if len(went):
        expected, far = float(went.mean()), p.led_m
    else:
        gone_s = (time_us - int(resting.ended_us[k])) / 1e6
        expected = 0.5 * (here.speed_mps + was.speed_mps) * gone_s
        far = p.alone_m + p.alone_mps * since_s
    misfit = abs(along - expected)
    return misfit if misfit <= far else math.inf


def _went(  # noqa: PLR0913, PLR0917 - as for `_misfit`
    resting: Resting, k: int, here: Place, tracks: Tracks, place: dict[int, int], p: RestingParameters
) -> F64 | None:
    """Return how far the next two of its lane went since [m], None where the order has become another.

    Only those count that are in the lane of the vehicle found, too.
    """
    was = resting.place(k)
    mine = [m for m in np.flatnonzero(resting.mate_of == resting.number[k]) if int(resting.mate[m]) in place]
    at = np.array([place[int(resting.mate[m])] for m in mine], dtype=np.int64)
    x, y, now_x, now_y = resting.mate_x_m[mine], resting.mate_y_m[mine], tracks.x_m[at], tracks.y_m[at]
    then_ahead, _ = _apart(was, x, y)
    now_ahead, now_across = _apart(here._replace(heading_rad=was.heading_rad), now_x, now_y)
    still = np.abs(now_across) <= p.lane_m
    overtaken = (then_ahead > p.order_m) & (now_ahead < 0.0)
    overtaken |= (then_ahead < -p.order_m) & (now_ahead > 0.0)
    if (overtaken & still).any():
        return None
    went = _apart(was, now_x, now_y)[0] - then_ahead
    nearest = np.argsort(np.where(still, np.abs(then_ahead), np.inf), kind="stable")[
        : min(2, int(still.sum()))
    ]
    return np.asarray(went[nearest])


def _place(tracks: Tracks, i: int) -> Place:
    return Place(
        float(tracks.x_m[i]), float(tracks.y_m[i]),
        math.hypot(float(tracks.mean[i, 1]), float(tracks.mean[i, 4])), float(tracks.heading_rad[i]),
    )  # fmt: skip


def _apart(place: Place, x_m: F64 | float, y_m: F64 | float) -> tuple[F64, F64]:
    """Return how far ahead of a place others are, along its heading, and how far to its right."""
    s, c = math.sin(place.heading_rad), math.cos(place.heading_rad)
    dx, dy = np.asarray(x_m) - place.x_m, np.asarray(y_m) - place.y_m
    return s * dx + c * dy, c * dx - s * dy
