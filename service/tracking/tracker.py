"""One step of the tracker: the points of a frame turn the tracks before it into the tracks after it.

points -> clutter map -> multi-frame DBSCAN -> claims by boxes -> JPDA -> filter -> extent -> existence -> births.
Everything is a function of the state and the frame: no clock, no randomness, and budgets are counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from service.tracking import births as birth
from service.tracking import clutter as clutter_map
from service.tracking import existence, extent, road_map
from service.tracking.assigning import Assignment, assign, box_array
from service.tracking.boxes import BLEN, BWID, M_COUNT, M_ECHO, PG, PV, PVAR_AZ, PX, PY
from service.tracking.clustering import cluster_window
from service.tracking.filters.base import Filter, FilterState
from service.tracking.filters.registry import make_filter
from service.tracking.merging import merge
from service.tracking.model import F64, I64, Bool, Frame, StepReport, TrackEstimates, TrackStatus
from service.tracking.parameters import TrackerParameters
from service.tracking.points import point_array
from service.tracking.state import EXTENT_MEMORY, TrackerState, Tracks, Window, empty_window, no_tracks

__all__ = ["TrackerState", "coast", "initial_state", "step"]

MAX_STEP_S = 2.0  # a longer gap is predicted as if it were this long: every track has ended by then


def initial_state(parameters: TrackerParameters | None = None) -> TrackerState:
    """Return the state of a tracker that has seen nothing."""
    p = parameters or TrackerParameters()
    return TrackerState(
        tracks=no_tracks(0), window=empty_window(), standing_window=empty_window(), frame_times_us=(),
        clutter=clutter_map.empty_map(p.clutter), road=road_map.empty_road_map(p.road), filter="", next_number=1, frames=0, time_us=0,
        range_seen_min_m=p.sensor.range_min_m, echo_reference_db=0.0,
    )  # fmt: skip


def step(
    state: TrackerState, frame: Frame, parameters: TrackerParameters
) -> tuple[TrackerState, TrackEstimates, StepReport]:
    """Fold one frame, later than all before it, into the state; return it with the confirmed tracks and the counts."""
    p = parameters
    bank = make_filter(p.filter, p.filters)
    state = _with_filter(state, bank)
    points = point_array(frame, p.sensor)
    usable, standing, no_birth = _sort_points(state, points, p)
    points, standing, no_birth = points[usable], standing[usable], no_birth[usable]
    window = _slide(state, points, standing, frame.time_us, p)
    label = _cluster(window, frame.time_us, p)
    new = len(window.time_us) - len(points)

    tracks, assignment, boxes = _track(state, bank, points, label[new:], frame.time_us, p)
    owned = assignment.owner >= 0
    sure = owned & np.append(tracks.confirmed, False)[assignment.owner]  # noqa: FBT003 - index -1: no owner
    window = replace(window, owned=np.concatenate([window.owned[:new], owned]))
    free = ~window.owned & np.concatenate([np.ones(new, dtype=np.bool_), ~no_birth])
    state = replace(state, window=window, tracks=tracks)
    state, tracks = _life(state, assignment, frame.time_us, p)
    deleted = len(state.tracks) - len(tracks)
    tracks, drop = merge(tracks, p.merging)
    tracks = tracks.take(~drop)
    state = replace(state, tracks=tracks)
    born = _births(state, label, free, points, standing & ~owned, frame.time_us, p)
    tracks = _start(state, bank, born, frame.time_us, p)
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
        deleted=deleted + int(drop.sum()),
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
    tracks = replace(
        tracks,
        status=np.where(tracks.confirmed, TrackStatus.COASTING, TrackStatus.TENTATIVE).astype(np.uint8),
    )
    hidden = existence.shadowed(tracks)
    over = existence.ended(tracks, time_us, hidden, np.ones(len(tracks), dtype=np.bool_), p.existence)
    tracks = tracks.take(~over)
    state = replace(
        state, tracks=tracks, time_us=time_us, window=empty_window(), standing_window=empty_window()
    )
    return replace(state, frame_times_us=()), estimates(tracks), StepReport(deleted=int(over.sum()))


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
        lane=np.zeros(len(t), dtype=np.uint8), hits=t.hits, born_us=t.born_us,
    )  # fmt: skip


# ---------------------------------------------------------------- before association


def _with_filter(state: TrackerState, bank: Filter) -> TrackerState:
    """Return the state with its tracks in the shape of this filter; another filter starts from mean and covariance."""
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
) -> tuple[Tracks, Assignment, F64]:
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
    after = bank.update(prediction, a.z, a.R, a.beta, a.miss) if len(tracks) else _filter_state(tracks)
    tracks = replace(tracks, mean=after.mean, cov=after.cov, memory=after.memory)
    hit = a.miss < 0.5
    tracks = extent.learn_length(tracks, a.measured, hit, _across_m(tracks, p), p.extent)
    tracks = extent.turn(tracks, p.extent)
    return extent.along_only(tracks, p.extent), a, boxes


def _widened(noise: F64, tracks: Tracks, p: TrackerParameters) -> F64:
    """Return the process noise, larger for tracks whose gate has stayed empty for longer than their echoes explain.

    After the recovery rule of the hybrid particle/FIR filter's notes: the variance of position grows with T^2 q and
    that of velocity with q while the gate is empty, so that a braking vehicle is met again.
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


def _across_m(tracks: Tracks, p: TrackerParameters) -> F64:
    return np.hypot(tracks.x_m, tracks.y_m) * math.hypot(
        p.sensor.azimuth_std_rad * 0.5, p.sensor.azimuth_floor_rad
    )


# ---------------------------------------------------------------- life


def _life(
    state: TrackerState, a: Assignment, time_us: int, p: TrackerParameters
) -> tuple[TrackerState, Tracks]:
    """Return the state with its tracks weighed, and those of them that live on."""
    t, e = state.tracks, p.existence
    hidden = existence.shadowed(t)
    count = a.measured[:, M_COUNT]
    hit = (1.0 - a.miss) * (count > 0)
    was_hit = hit > 0.5
    t = replace(
        t,
        log_odds=existence.weigh(t, hit, count, hidden, e),
        hits=t.hits + was_hit,
        empty=np.where(was_hit, 0, t.empty + 1),
        hit_us=np.where(was_hit, time_us, t.hit_us),
        detect_rate=np.where(hidden & ~was_hit, t.detect_rate, t.detect_rate + (was_hit - t.detect_rate) / e.detect_memory_frames),
        points_per_hit=np.where(was_hit, t.points_per_hit + (count - t.points_per_hit) / np.minimum(t.hits + 2, 20), t.points_per_hit),
        echo_db=np.where(was_hit, t.echo_db + (a.measured[:, M_ECHO] - t.echo_db) / np.minimum(t.hits + 1, 20), t.echo_db),
    )  # fmt: skip
    n_driven, _, _ = road_map.driven_at(state.road, t.x_m, t.y_m, p.road)
    driven = n_driven >= p.road.driven_tracks
    mature = state.road.teachers >= p.road.mature_tracks
    off_road = ~driven & mature & (np.hypot(t.x_m, t.y_m) < p.boxes.off_road_range_m)
    waiting = existence.wait(t, off_road, _behind_rail(state, t, p), time_us, state.echo_reference_db, e)
    t = replace(t, status=existence.next_status(t, waiting, was_hit, driven, e))
    over = existence.ended(t, time_us, hidden, driven | (not mature), e)
    sure = (t.status == TrackStatus.CONFIRMED) & (t.hits > 20) & (t.speed_mps > 3.0)
    reference = state.echo_reference_db
    if sure.any():
        mean = float(t.echo_db[sure].mean())
        reference = mean if reference == 0.0 else reference + 0.01 * (mean - reference)
    state = replace(state, tracks=t, echo_reference_db=reference)
    return state, t.take(~over)


def _behind_rail(state: TrackerState, tracks: Tracks, p: TrackerParameters) -> Bool:
    """Return which tentative tracks (T,) stand behind a row of clutter from a stronger vehicle like them."""
    out = np.zeros(len(tracks), dtype=np.bool_)
    g, azimuth = np.hypot(tracks.x_m, tracks.y_m), np.arctan2(tracks.x_m, tracks.y_m)
    for i, j in zip(*np.nonzero(existence.mirror_partners(tracks)), strict=True):  # tentative ones only: few
        out[i] |= clutter_map.stands_between(state.clutter, g[i], azimuth[i], azimuth[j], p.clutter)
    return out


def _births(
    state: TrackerState,
    label: I64,
    free: Bool,
    points: F64,
    standing: Bool,
    time_us: int,
    p: TrackerParameters,
) -> birth.Births:
    """Return the new tracks of a frame: from free clusters, and now and then from standing points."""
    window, b = state.window, p.birth
    new = len(window.time_us) - len(points)
    rows: list[F64] = []
    found = birth.birth_clusters(label, free, window.time_us, time_us, b.min_points, b.min_frames)
    for c in found:  # a handful at most: clusters that no track claims
        member = free & (label == c)
        mine = member[new:]
        doppler = np.abs(window.points[member, PV])
        if np.isfinite(doppler).any() and np.nanmedian(doppler) < p.clutter.standing_mps:
            continue
        centre = points[mine].mean(axis=0)
        n, heading, agreement = road_map.driven_at(state.road, centre[[PX]], centre[[PY]], p.road)
        known = n[0] >= p.road.driven_tracks and agreement[0] > 0.8
        row = birth.moving_birth(points[mine], float(heading[0]) if known else None, b)
        if row is not None:
            rows.append(row)
    if state.frames % b.standing_interval_frames == 0 and len(state.frame_times_us) >= b.standing_min_frames:
        rows += _standing(state, p)
    kept = birth.gather(rows)
    if len(kept) and len(state.tracks):
        kept = _outside(kept, rows, state.tracks, p)
    return kept


def _outside(born: birth.Births, rows: list[F64], tracks: Tracks, p: TrackerParameters) -> birth.Births:
    """Return the births that do not stand inside a box, or within the keep-out distance of one."""
    u, w = _box_frame(born.x_m, born.y_m, tracks)
    margin = p.birth.keep_out_m
    inside = (np.abs(u) < 0.5 * tracks.length_m + margin) & (np.abs(w) < 0.5 * tracks.width_m + 0.3)
    near = np.hypot(u, w) < 2.0
    ok = ~(inside | near).any(axis=1)
    return birth.gather([r for r, k in zip(rows, ok, strict=True) if k])


def _box_frame(x_m: F64, y_m: F64, tracks: Tracks) -> tuple[F64, F64]:
    """Return (N, T): places along and across each track's box."""
    dx, dy = x_m[:, None] - tracks.x_m, y_m[:, None] - tracks.y_m
    s, c = np.sin(tracks.heading_rad), np.cos(tracks.heading_rad)
    return s * dx + c * dy, c * dx - s * dy


def _standing(state: TrackerState, p: TrackerParameters) -> list[F64]:
    w = state.standing_window
    q = w.points
    if len(state.tracks):
        u, v = _box_frame(q[:, PX], q[:, PY], state.tracks)
        t = state.tracks
        clear = ~((np.abs(u) < 0.5 * t.length_m + 0.7) & (np.abs(v) < 0.5 * t.width_m + 0.7)).any(axis=1)
        q = q[clear]
    q = q[clutter_map.occupancy_at(state.clutter, q, p.clutter) < p.clutter.ignore_occupancy]
    n, heading, agreement = road_map.driven_at(state.road, q[:, PX], q[:, PY], p.road)
    driven = (n >= p.road.driven_tracks) & (agreement > 0.8)
    return birth.standing_births(q, max(len(state.frame_times_us), 1), driven, heading, p.birth)


def _start(
    state: TrackerState, bank: Filter, born: birth.Births, time_us: int, p: TrackerParameters
) -> Tracks:
    """Return the tracks with the new ones behind them."""
    if not len(born):
        return state.tracks
    n = len(born)
    mean = np.zeros((n, 6))
    mean[:, 0], mean[:, 3], mean[:, 1], mean[:, 4] = born.x_m, born.y_m, born.vx_mps, born.vy_mps
    g = np.maximum(np.hypot(born.x_m, born.y_m), 1e-6)
    lx, ly = born.x_m / g, born.y_m / g
    cov = np.zeros((n, 6, 6))
    for i, (r, t) in enumerate(
        ((born.std_radial_m, born.std_tangential_m), (born.std_radial_mps, born.std_tangential_mps))
    ):
        a, b = i, 3 + i
        cov[:, a, a] = lx**2 * r**2 + ly**2 * t**2
        cov[:, b, b] = ly**2 * r**2 + lx**2 * t**2
        cov[:, a, b] = cov[:, b, a] = lx * ly * (r**2 - t**2)
    cov[:, 2, 2] = cov[:, 5, 5] = p.boxes.birth_accel_std_mps2**2
    fresh = bank.start(mean, cov)
    e = p.existence
    sure = born.standing
    rings = np.full((n, EXTENT_MEMORY), np.nan)
    rings[:, 0] = np.where(born.points >= 2, born.extent_m, np.nan)
    new = Tracks(
        number=state.next_number + np.arange(n), mean=fresh.mean, cov=fresh.cov, memory=fresh.memory,
        heading_rad=born.heading_rad, length_m=born.length_m,
        width_m=np.where(born.length_m > p.extent.wide_from_m, p.extent.wide_m, p.birth.width_m),
        log_odds=np.where(sure, e.confirm_log_odds + 1.0, e.birth_log_odds),
        status=np.where(sure, TrackStatus.CONFIRMED, TrackStatus.TENTATIVE).astype(np.uint8),
        hits=np.ones(n, dtype=np.int64), empty=np.zeros(n, dtype=np.int64), born_us=np.full(n, time_us),
        hit_us=np.full(n, time_us), born_x_m=born.x_m, born_y_m=born.y_m, standing=born.standing,
        detect_rate=np.full(n, 0.7), points_per_hit=born.points.astype(np.float64),
        echo_db=np.full(n, state.echo_reference_db), extent_m=rings, map_cell=np.full(n, -1, dtype=np.int64),
    )  # fmt: skip
    return state.tracks.join(new)


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
