"""One step of the tracker: the points of a frame turn the tracks before it into the tracks after it.

points -> clutter map -> multi-frame DBSCAN -> claims by boxes -> JPDA -> filter -> extent -> existence ->
births. Everything is a function of the state and the frame: no clock, no randomness, and budgets are counts.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from service.tracking import births as birth
from service.tracking import clutter as clutter_map
from service.tracking import creeping, existence, extent, holding, lifecycle, resting, road_map, splitting
from service.tracking.assigning import Assignment, assign, box_array
from service.tracking.boxes import PG, PV, PVAR_AZ, PX, PY
from service.tracking.clustering import cluster_window
from service.tracking.filters.base import Filter, FilterState, Prediction
from service.tracking.filters.registry import make_filter
from service.tracking.kernel import kernel
from service.tracking.merging import merge
from service.tracking.model import F32, F64, I64, U8, Bool, Frame, StepReport, TrackEstimates, TrackStatus
from service.tracking.parameters import TrackerParameters
from service.tracking.points import point_array
from service.tracking.rearranging import rearrange
from service.tracking.recovering import Seen, recover
from service.tracking.recovery import TrailBook, no_book
from service.tracking.starting import driven_way, find_births, start
from service.tracking.state import (
    TrackerState,
    Tracks,
    Window,
    empty_window,
    no_tandems,
    no_tracks,
    none_resting,
)
from service.tracking.stood import Standing
from service.tracking.tandem import pairs_now, unite
from service.tracking.teaching import teach_clutter, teach_road

_TENTATIVE, _CONFIRMED = int(TrackStatus.TENTATIVE), int(TrackStatus.CONFIRMED)
_NOBODY = np.zeros(1, dtype=np.bool_)  # confirmed is not the owner -1
__all__ = ["TrackerState", "coast", "initial_state", "step"]

SIZED_HITS = 8  # hits from which length and width are told
Watch = Callable[[str], None]
STAGES = (
    "points", "clutter", "cluster", "filter", "associate", "recover", "extent", "existence", "births",
    "memory",
)  # fmt: skip
MAX_STEP_S = 2.0  # a longer gap is predicted as if it were this long: every track has ended by then


def _unwatched(_stage: str) -> None:
    """Do nothing when a stage is done."""


def initial_state(parameters: TrackerParameters | None = None) -> TrackerState:
    """Return the state of a tracker that has seen nothing."""
    p = parameters or TrackerParameters()
    return TrackerState(
        tracks=no_tracks(0), window=empty_window(), standing_window=empty_window(), frame_times_us=(),
        clutter=clutter_map.empty_map(p.clutter), road=road_map.empty_road_map(p.road), filter="",
        next_number=1, frames=0, time_us=0,
        range_seen_min_m=p.sensor.range_min_m, echo_reference_db=0.0, trails=no_book(),
        resting=none_resting(), tandems=no_tandems(),
    )  # fmt: skip


def step(
    state: TrackerState,
    frame: Frame,
    parameters: TrackerParameters,
    bank: Filter | None = None,
    watch: Watch = _unwatched,
) -> tuple[TrackerState, TrackEstimates, StepReport]:
    """Fold one frame, later than all before it; return the state, the confirmed tracks and the counts.

    bank: the filter itself, for who wants to watch it; None: the one that the parameters name.
    watch: called with the name of each stage (one of STAGES) when a part of it is done, for whoever times it.
    """
    p = parameters
    bank = bank or make_filter(p.filter, p.filters)
    state = _with_filter(state, bank)
    before = state.tracks
    seen = points = point_array(frame, p.sensor)
    watch("points")
    usable, standing, no_birth = clutter_map.sort_points(state.clutter, points, p.clutter)
    if not usable.all():
        points, standing, no_birth = points[usable], standing[usable], no_birth[usable]
    watch("clutter")
    window = _slide(state, points, standing, frame.time_us, p)
    label = _cluster(window, frame.time_us, p)
    watch("cluster")
    new = len(window.time_us) - len(points)

    stood = Standing(standing, no_birth, state.standing_window, len(state.frame_times_us))
    tracks, assignment, trails = _track(state, bank, points, label[new:], stood, frame.time_us, p, watch)
    owned = assignment.owner >= 0
    vehicle = tracks.confirmed | creeping.seen(tracks, p.creeping)
    sure = np.concatenate((vehicle, _NOBODY))[assignment.owner]
    unclaimed = np.ones(len(seen), dtype=np.bool_)
    unclaimed[usable] = ~sure
    window = Window(
        window.points, window.time_us, np.concatenate((window.owned[:new], owned)), window.standing
    )
    free = ~window.owned
    free[new:] &= ~no_birth
    numbers = tracks.number
    tracks, reference, ended, on_posts, certain = lifecycle.live(state, tracks, assignment, frame.time_us, p)
    tandems = pairs_now(state.tandems, tracks, p.tandem)
    tracks, half = unite(tandems, tracks, p.tandem, p.extent)
    halves = tracks.number[half]
    tracks, drop = merge(tracks.take(~half) if len(halves) else tracks, p.merging)
    merged = int(np.count_nonzero(drop))
    watch("existence")
    state = replace(
        state,
        tracks=tracks.take(~drop) if merged else tracks,
        window=window,
        echo_reference_db=reference,
        trails=trails,
    )
    born = find_births(state, label, free, points, frame.time_us, p)
    apart, abreast = splitting.part(
        state.tracks, window, frame.time_us, p.splitting, length_m=p.birth.length_m
    )
    if apart is not state.tracks:
        state, born = replace(state, tracks=apart), birth.gather([*birth.rows(born), *abreast])
    state, born, dropped = _put_right(state, born, frame.time_us, p)
    tracks = start(state, bank, born, frame.time_us, p)
    view = (p.sensor.range_min_m, p.sensor.range_max_m, p.sensor.azimuth_max_rad)
    no_loss = np.concatenate((dropped, on_posts, halves))  # neither a second box nor a post is a vehicle lost
    if len(no_loss):
        before = before.take(~np.isin(before.number, no_loss))
    at_rest, tracks = resting.settle(state.resting, before, tracks, frame.time_us, view, p.resting)
    watch("births")
    post = np.zeros(len(seen), dtype=np.bool_)
    if len(certain):
        post[usable] = np.isin(np.append(numbers, -1)[assignment.owner], certain)  # the owner -1 is the last
    clutter = teach_clutter(state, tracks, seen, unclaimed, post, p)
    watch("clutter")
    state = TrackerState(
        tracks=tracks, window=window,
        standing_window=_slide_standing(state, points, standing & ~no_birth, owned, frame.time_us, p),
        frame_times_us=_recent_times(state, frame.time_us, p),
        clutter=clutter, road=state.road, filter=state.filter, next_number=state.next_number + len(born),
        frames=state.frames + 1, time_us=frame.time_us,
        range_seen_min_m=min(state.range_seen_min_m, float(points[:, PG].min(initial=1e9))),
        echo_reference_db=reference, trails=trails, resting=at_rest, tandems=tandems,
    )  # fmt: skip
    state = teach_road(state, p)
    report = StepReport(
        points=len(frame),
        points_static=len(frame) - len(points),
        clusters=int(label[new:].max(initial=-1)) + 1,
        tentative=int(np.count_nonzero(state.tracks.status == _TENTATIVE)),
        components=assignment.components,
        approximated=assignment.approximated,
        born=len(born),
        deleted=ended + merged + len(dropped) + len(halves),
    )
    found = estimates(state.tracks)
    watch("memory")
    return state, found, report


def coast(
    state: TrackerState, time_us: int, parameters: TrackerParameters
) -> tuple[TrackerState, TrackEstimates, StepReport]:
    """Let time pass without a frame: predict the tracks, and end those that have been silent for too long."""
    p = parameters
    bank = make_filter(p.filter, p.filters)
    state = _with_filter(state, bank)
    prediction = bank.predict(_filter_state(state.tracks), _dt_s(state, time_us))
    tracks = replace(state.tracks, mean=prediction.mean, cov=prediction.cov, memory=prediction.memory)
    tracks, ended = lifecycle.let_go(tracks, time_us, p)
    state = replace(
        state, tracks=tracks, time_us=time_us, window=empty_window(), standing_window=empty_window(),
        resting=resting.expire(state.resting, time_us, p.resting),
    )  # fmt: skip
    state = replace(state, frame_times_us=(), trails=no_book(), tandems=no_tandems())
    return state, estimates(tracks), StepReport(deleted=ended)


def estimates(tracks: Tracks) -> TrackEstimates:
    """Return the confirmed and coasting tracks as they are reported."""
    t = tracks
    index, columns = _listed(
        t.mean, t.cov, t.heading_rad, t.length_m, t.width_m, t.log_odds, t.status, t.hits, SIZED_HITS
    )  # fmt: skip
    x, y, vx, vy, std_x, std_y, cov_xy, heading, length, width, exists = columns
    return TrackEstimates(
        number=t.number[index], x_m=x, y_m=y, vx_mps=vx, vy_mps=vy, std_x_m=std_x, std_y_m=std_y,
        cov_xy_m2=cov_xy, heading_rad=heading, length_m=length, width_m=width, existence=exists,
        status=t.status[index], lane=np.zeros(len(index), dtype=np.uint8),
        motion=np.zeros(len(index), dtype=np.uint8), hits=t.hits[index],
        born_us=t.born_us[index],
    )  # fmt: skip


@kernel
def _listed(
    mean: F64, cov: F64, heading: F64, length: F64, width: F64, log_odds: F64, status: U8, hits: I64,
    sized: int,
) -> tuple[I64, F32]:  # fmt: skip
    """Return the confirmed tracks (C,) and a row of (11, C) for each float of `TrackEstimates`."""
    index, count = np.empty(len(status), np.int64), 0
    for i in range(len(status)):
        if status[i] != _TENTATIVE:
            index[count] = i
            count += 1
    out = np.empty((11, count), np.float32)
    for k in range(count):
        i = index[k]
        out[0, k], out[1, k], out[2, k], out[3, k] = mean[i, 0], mean[i, 3], mean[i, 1], mean[i, 4]
        out[4, k], out[5, k], out[6, k] = math.sqrt(cov[i, 0, 0]), math.sqrt(cov[i, 3, 3]), cov[i, 0, 3]
        out[7, k] = heading[i]
        out[8, k], out[9, k] = (length[i], width[i]) if hits[i] >= sized else (np.nan, np.nan)
        out[10, k] = 1.0 / (1.0 + math.exp(-log_odds[i]))
    return index[:count], out


# ---------------------------------------------------------------- before association


def _with_filter(state: TrackerState, bank: Filter) -> TrackerState:
    """Return the state with tracks of this filter's shape; a new filter starts from mean and covariance.

    The same filter with other options may remember other things; then it starts anew, too.
    """
    if state.filter == bank.name and state.tracks.memory.shape[1] == bank.memory_size:
        return state
    if not len(state.tracks):
        return replace(state, tracks=no_tracks(bank.memory_size), filter=bank.name)
    fresh = bank.start(state.tracks.mean, state.tracks.cov)
    tracks = replace(state.tracks, mean=fresh.mean, cov=fresh.cov, memory=fresh.memory)
    return replace(state, tracks=tracks, filter=bank.name)


def _filter_state(tracks: Tracks) -> FilterState:
    return FilterState(tracks.mean, tracks.cov, tracks.memory)


def _dt_s(state: TrackerState, time_us: int) -> float:
    return min(max(time_us - state.time_us, 0) / 1e6, MAX_STEP_S)


def _slide(state: TrackerState, points: F64, standing: Bool, time_us: int, p: TrackerParameters) -> Window:
    """Return the window of the last K frames with this frame's points at its end, not yet owned."""
    times = state.frame_times_us
    back = p.clustering.window_frames - 1
    oldest = times[-back] if 0 < back <= len(times) else (times[0] if times and back else time_us)
    old = state.window
    first = int(old.time_us.searchsorted(oldest))  # oldest first
    return Window(
        np.concatenate((old.points[first:], points)),
        np.concatenate((old.time_us[first:], np.full(len(points), time_us))),
        np.concatenate((old.owned[first:], np.zeros(len(points), dtype=np.bool_))),
        np.concatenate((old.standing[first:], standing)),
    )


def _cluster(window: Window, time_us: int, p: TrackerParameters) -> I64:
    """Return the cluster (N,) of each point of the window."""
    q = window.points
    return cluster_window(
        x_m=q[:, PX],
        y_m=q[:, PY],
        radial_velocity_mps=q[:, PV],
        age_s=(time_us - window.time_us) / 1e6,
        azimuth_std_rad=np.sqrt(q[:, PVAR_AZ]),
        weights=np.ones(len(q)),
        road_direction=None,
        parameters=p.clustering,
    )


def _track(
    state: TrackerState, bank: Filter, points: F64, label: I64, stood: Standing, time_us: int,
    p: TrackerParameters, watch: Watch,
) -> tuple[Tracks, Assignment, TrailBook]:  # fmt: skip
    """Return the tracks after prediction, association, update and recovery, the association, the trails."""
    dt_s = _dt_s(state, time_us)
    prediction = bank.predict(_filter_state(state.tracks), dt_s)
    tracks, mean = extent.turn_on(state.tracks, prediction.mean, dt_s, p.extent)
    hidden = existence.shadowed(tracks)
    noise = _widened(prediction.noise, tracks, hidden, p)
    prediction = Prediction(mean, prediction.propagated, noise, prediction.memory)
    cov = prediction.cov
    expected = bank.expected(prediction)
    watch("filter")
    boxes = box_array(tracks, prediction.mean, cov, hidden, p)
    detect = existence.detection_probability(tracks, p.existence)
    a = assign(
        tracks, boxes, expected.z_hat, expected.S_prior, detect, points, label, stood,
        state.range_seen_min_m, p,
    )  # fmt: skip
    watch("associate")
    R = holding.held_noise(tracks, prediction.mean, a.R, p.extent)
    after = bank.update(prediction, a.z, R, a.beta, a.miss)
    watch("filter")
    mean = holding.hold(tracks, prediction.mean, after.mean, p.extent)
    tracks = tracks.but(mean=mean, cov=after.cov, memory=after.memory)
    seen = Seen(points, label, boxes, dt_s, state.range_seen_min_m)
    tracks, a, trails = recover(tracks, a, seen, bank, state.trails, p)
    watch("recover")
    across_std_rad = math.hypot(0.5 * p.sensor.azimuth_std_rad, p.sensor.azimuth_floor_rad)
    one_way, along = road_map.one_way_at(state.road, tracks.x_m, tracks.y_m, p.road)
    hit = a.miss < 0.5
    tracks = holding.watch_ends(tracks, a.measured, hit, p.extent)
    tracks = creeping.watch(tracks, a.measured, hit, expected.z_hat[:, 2].copy(), dt_s, p.creeping)
    tracks = extent.learn(tracks, a.measured, hit, one_way, along, across_std_rad, dt_s, p.extent)
    watch("extent")
    return tracks, a, trails


def _widened(noise: F64, tracks: Tracks, hidden: Bool, p: TrackerParameters) -> F64:
    """Return the process noise, larger where a gate has stayed empty for longer than misses explain.

    The variances of position and velocity grow with every empty frame, so that a braking vehicle is met
    again: faster in plain sight, where nothing but such a manoeuvre takes a vehicle away from its points.
    """
    out = np.empty((len(tracks), *noise.shape[-2:]))
    out[:] = noise
    _widen(
        out, tracks.mean, tracks.empty, tracks.detect_rate, p.boxes.widen_after,
        p.boxes.widen_position_m2, p.boxes.widen_velocity_m2ps2, p.boxes.widen_shadowed_m2ps2,
        hidden,
    )  # fmt: skip
    return out


@kernel
def _widen(
    noise: F64, mean: F64, empty: I64, detect_rate: F64, after: int, position_m2: float,
    velocity_m2ps2: float, shadowed_m2ps2: float, hidden: Bool,
) -> None:  # fmt: skip
    for i in range(len(mean)):
        if empty[i] < after or empty[i] <= 2.0 / max(detect_rate[i], 0.1):
            continue
        if math.hypot(mean[i, 1], mean[i, 4]) > 2.0:
            for axis in (0, 3):
                noise[i, axis, axis] += position_m2
                noise[i, axis + 1, axis + 1] += shadowed_m2ps2 if hidden[i] else velocity_m2ps2


# ---------------------------------------------------------------- memory


def _recent_times(state: TrackerState, time_us: int, p: TrackerParameters) -> tuple[int, ...]:
    oldest = time_us - round(p.birth.standing_window_s * 1e6)
    times = state.frame_times_us
    return (*times[bisect_right(times, oldest) :], time_us)


def _put_right(
    state: TrackerState, born: birth.Births, time_us: int, p: TrackerParameters
) -> tuple[TrackerState, birth.Births, I64]:
    """Return the state with the boxes of standing rows put right, all births, and the numbers that end."""
    before = state.tracks
    if not _may_rearrange(state, time_us, p):
        return state, born, before.number[:0]
    q = state.standing_window.points
    q = q[clutter_map.occupancy_at(state.clutter, q, p.clutter) < p.clutter.ignore_occupancy]
    driven, along = driven_way(state, q, p)
    after, rows = rearrange(before, q, len(state.frame_times_us), driven, along, p.birth, p.rearranging)
    if rows:
        born = birth.gather([*birth.rows(born), *rows])
    dropped = before.number[~np.isin(before.number, after.number)]
    return (state if after is before else replace(state, tracks=after)), born, dropped


def _may_rearrange(state: TrackerState, time_us: int, p: TrackerParameters) -> bool:
    """Return whether boxes of standing rows are looked at now: now and then, when a second was seen."""
    every, times = p.rearranging.interval_frames, state.frame_times_us
    if every <= 0 or state.frames % every != every - 1 or len(times) < p.birth.standing_min_frames:
        return False
    return time_us - times[0] >= p.rearranging.window_share * p.birth.standing_window_s * 1e6


def _slide_standing(
    state: TrackerState, points: F64, which: Bool, owned: Bool, time_us: int, p: TrackerParameters
) -> Window:
    w = state.standing_window
    oldest_us = time_us - round(p.birth.standing_window_s * 1e6)
    first = int(w.time_us.searchsorted(oldest_us, side="right"))
    new = points[which]
    return Window(
        np.concatenate((w.points[first:], new)),
        np.concatenate((w.time_us[first:], np.full(len(new), time_us))),
        np.concatenate((w.owned[first:], owned[which])),
        np.ones(len(w.time_us) - first + len(new), dtype=np.bool_),
    )
