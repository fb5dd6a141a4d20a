"""One step of the tracker: the points of a frame turn the tracks before it into the tracks after it.

points -> clutter map -> multi-frame DBSCAN -> claims by boxes -> JPDA -> filter -> extent -> existence ->
births. Everything is a function of the state and the frame: no clock, no randomness, and budgets are counts.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from service.tracking import clutter as clutter_map
from service.tracking import existence, extent, lifecycle, road_map
from service.tracking.assigning import Assignment, assign, box_array
from service.tracking.boxes import PG, PV, PVAR_AZ, PX, PY
from service.tracking.clustering import cluster_window
from service.tracking.filters.base import Filter, FilterState
from service.tracking.filters.registry import make_filter
from service.tracking.merging import merge
from service.tracking.model import F64, I64, Bool, Frame, StepReport, TrackEstimates, TrackStatus
from service.tracking.parameters import TrackerParameters
from service.tracking.points import point_array
from service.tracking.starting import find_births, start
from service.tracking.state import TrackerState, Tracks, Window, empty_window, no_tracks

__all__ = ["TrackerState", "coast", "initial_state", "step"]

MAX_STEP_S = 2.0  # a longer gap is predicted as if it were this long: every track has ended by then


def initial_state(parameters: TrackerParameters | None = None) -> TrackerState:
    """Return the state of a tracker that has seen nothing."""
    p = parameters or TrackerParameters()
    return TrackerState(
        tracks=no_tracks(0), window=empty_window(), standing_window=empty_window(), frame_times_us=(),
        clutter=clutter_map.empty_map(p.clutter), road=road_map.empty_road_map(p.road), filter="",
        next_number=1, frames=0, time_us=0,
        range_seen_min_m=p.sensor.range_min_m, echo_reference_db=0.0,
    )  # fmt: skip


def step(
    state: TrackerState, frame: Frame, parameters: TrackerParameters
) -> tuple[TrackerState, TrackEstimates, StepReport]:
    """Fold one frame, later than all before it; return the state, the confirmed tracks and the counts."""
    p = parameters
    bank = make_filter(p.filter, p.filters)
    state = _with_filter(state, bank)
    points = point_array(frame, p.sensor)
    usable, standing, no_birth = _sort_points(state, points, p)
    points, standing, no_birth = points[usable], standing[usable], no_birth[usable]
    window = _slide(state, points, standing, frame.time_us, p)
    label = _cluster(window, frame.time_us, p)
    new = len(window.time_us) - len(points)

    tracks, assignment = _track(state, bank, points, label[new:], frame.time_us, p)
    owned = assignment.owner >= 0
    sure = owned & np.append(tracks.confirmed, False)[assignment.owner]
    window = replace(window, owned=np.concatenate([window.owned[:new], owned]))
    free = ~window.owned & np.concatenate([np.ones(new, dtype=np.bool_), ~no_birth])
    state = replace(state, window=window, tracks=tracks)
    state, ended = lifecycle.live(state, assignment, frame.time_us, p)
    tracks, drop = merge(state.tracks, p.merging)
    state = replace(state, tracks=tracks.take(~drop) if drop.any() else tracks)
    born = find_births(state, label, free, points, frame.time_us, p)
    tracks = start(state, bank, born, frame.time_us, p)
    seen_min = min(state.range_seen_min_m, float(points[:, PG].min(initial=1e9)))
    state = replace(
        state,
        tracks=tracks,
        next_number=state.next_number + len(born),
        frames=state.frames + 1,
        time_us=frame.time_us,
        range_seen_min_m=seen_min,
        clutter=clutter_map.learn(state.clutter, points, ~sure, p.clutter),
        standing_window=_slide_standing(state, points, standing & ~owned & ~no_birth, frame.time_us, p),
        frame_times_us=_recent_times(state, frame.time_us, p),
    )
    state = _teach_road(state, p)
    report = StepReport(
        points=len(frame),
        points_static=int((~usable).sum()),
        clusters=int(label[new:].max(initial=-1)) + 1,
        tentative=int((tracks.status == TrackStatus.TENTATIVE).sum()),
        components=assignment.components,
        approximated=assignment.approximated,
        born=len(born),
        deleted=ended + int(drop.sum()),
    )
    return state, estimates(state.tracks), report


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
        state, tracks=tracks, time_us=time_us, window=empty_window(), standing_window=empty_window()
    )
    return replace(state, frame_times_us=()), estimates(tracks), StepReport(deleted=ended)


def estimates(tracks: Tracks) -> TrackEstimates:
    """Return the confirmed and coasting tracks as they are reported."""
    t = tracks.take(tracks.confirmed)
    f = np.float32
    known = t.hits >= 8
    return TrackEstimates(
        number=t.number, x_m=t.x_m.astype(f), y_m=t.y_m.astype(f), vx_mps=t.mean[:, 1].astype(f),
        vy_mps=t.mean[:, 4].astype(f), std_x_m=np.sqrt(t.cov[:, 0, 0]).astype(f),
        std_y_m=np.sqrt(t.cov[:, 3, 3]).astype(f), cov_xy_m2=t.cov[:, 0, 3].astype(f),
        heading_rad=t.heading_rad.astype(f), length_m=np.where(known, t.length_m, np.nan).astype(f),
        width_m=np.where(known, t.width_m, np.nan).astype(f),
        existence=existence.probability(t.log_odds).astype(f), status=t.status,
        lane=np.zeros(len(t), dtype=np.uint8), motion=np.zeros(len(t), dtype=np.uint8),
        hits=t.hits, born_us=t.born_us,
    )  # fmt: skip


# ---------------------------------------------------------------- before association


def _with_filter(state: TrackerState, bank: Filter) -> TrackerState:
    """Return the state with tracks of this filter's shape; a new filter starts from mean and covariance."""
    if state.filter == bank.name:
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


def _sort_points(state: TrackerState, points: F64, p: TrackerParameters) -> tuple[Bool, Bool, Bool]:
    """Return which points (N,) are usable, which stand, and which may start nothing."""
    speed = np.abs(np.nan_to_num(points[:, PV], nan=np.inf))
    occupancy = clutter_map.occupancy_at(state.clutter, points, p.clutter)
    standing = speed < p.clutter.standing_mps
    usable = ~(standing & (occupancy > p.clutter.ignore_occupancy))
    no_birth = (speed < p.clutter.slow_mps) & (occupancy > p.clutter.no_birth_occupancy)
    return usable, standing, no_birth


def _slide(state: TrackerState, points: F64, standing: Bool, time_us: int, p: TrackerParameters) -> Window:
    """Return the window of the last K frames with this frame's points at its end, not yet owned."""
    times = state.frame_times_us
    back = p.clustering.window_frames - 1
    oldest = times[-back] if 0 < back <= len(times) else (times[0] if times and back else time_us)
    keep = state.window.time_us >= oldest
    old = state.window
    return Window(
        np.concatenate([old.points[keep], points]),
        np.concatenate([old.time_us[keep], np.full(len(points), time_us)]),
        np.concatenate([old.owned[keep], np.zeros(len(points), dtype=np.bool_)]),
        np.concatenate([old.standing[keep], standing]),
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
    state: TrackerState, bank: Filter, points: F64, label: I64, time_us: int, p: TrackerParameters
) -> tuple[Tracks, Assignment]:
    """Return the tracks after prediction, association and update, with the association."""
    tracks = state.tracks
    prediction = bank.predict(_filter_state(tracks), _dt_s(state, time_us))
    prediction = replace(prediction, noise=_widened(prediction.noise, tracks, p))
    cov = prediction.cov
    boxes = box_array(tracks, prediction.mean, cov, p)
    expected = bank.expected(prediction)
    detect = existence.detection_probability(tracks, p.existence)
    a = assign(
        tracks, boxes, expected.z_hat, expected.S_prior, detect, points, label, state.range_seen_min_m, p
    )
    after = bank.update(prediction, a.z, a.R, a.beta, a.miss)
    tracks = replace(tracks, mean=after.mean, cov=after.cov, memory=after.memory)
    across_std_rad = math.hypot(0.5 * p.sensor.azimuth_std_rad, p.sensor.azimuth_floor_rad)
    return extent.learn(tracks, a.measured, a.miss < 0.5, across_std_rad, p.extent), a


def _widened(noise: F64, tracks: Tracks, p: TrackerParameters) -> F64:
    """Return the process noise, larger where a gate has stayed empty for longer than misses explain.

    The variances of position and velocity grow with every empty frame, so that a braking vehicle is met
    again.
    """
    late = (tracks.empty >= p.boxes.widen_after) & (tracks.speed_mps > 2.0)
    late &= tracks.empty > 2.0 / np.maximum(tracks.detect_rate, 0.1)
    if not late.any():
        return noise
    out = np.broadcast_to(noise, (len(tracks), 6, 6)).copy()
    for axis in (0, 3):
        out[late, axis, axis] += p.boxes.widen_position_m2
        out[late, axis + 1, axis + 1] += p.boxes.widen_velocity_m2ps2
    return out


# ---------------------------------------------------------------- memory


def _recent_times(state: TrackerState, time_us: int, p: TrackerParameters) -> tuple[int, ...]:
    oldest = time_us - round(p.birth.standing_window_s * 1e6)
    return (*(t for t in state.frame_times_us if t > oldest), time_us)


def _slide_standing(
    state: TrackerState, points: F64, which: Bool, time_us: int, p: TrackerParameters
) -> Window:
    w = state.standing_window
    keep = w.time_us > time_us - round(p.birth.standing_window_s * 1e6)
    n = int(which.sum())
    flags = np.zeros(int(keep.sum()) + n, dtype=np.bool_)
    return Window(
        np.concatenate([w.points[keep], points[which]]),
        np.concatenate([w.time_us[keep], np.full(n, time_us)]),
        flags,
        flags,
    )


def _teach_road(state: TrackerState, p: TrackerParameters) -> TrackerState:
    """Return the state with its road map taught by the established moving tracks that entered a new cell."""
    if state.frames % p.road.learn_interval_frames:
        return state
    t = state.tracks
    i, j, inside = road_map.cell_of(t.x_m, t.y_m, p.road)
    cell = np.where(inside, i * 100_000 + j, -1)
    teach = (
        (t.status == TrackStatus.CONFIRMED)
        & (t.hits >= p.road.learn_hits)
        & (t.speed_mps > p.road.learn_speed_mps)
    )
    teach &= (cell != t.map_cell) & inside
    if not teach.any():
        return state
    first = int((teach & (t.map_cell < 0)).sum())
    road = road_map.teach(state.road, t.x_m[teach], t.y_m[teach], t.heading_rad[teach], first, p.road)
    return replace(state, road=road, tracks=replace(t, map_cell=np.where(teach, cell, t.map_cell)))
