"""Find the births of a frame and turn them into tracks."""

from __future__ import annotations

import math

import numpy as np

from service.tracking import births as birth
from service.tracking import clutter as clutter_map
from service.tracking import road_map
from service.tracking.boxes import PV, PX, PY
from service.tracking.filters.base import Filter
from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, Bool, TrackStatus
from service.tracking.parameters import TrackerParameters
from service.tracking.queue_lanes import Lately, queue_lanes
from service.tracking.state import EXTENT_MEMORY, TrackerState, Tracks

_NO_BIRTHS = birth.gather([])


def find_births(
    state: TrackerState,
    label: I64,
    free: Bool,
    points: F64,
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
        if birth.median(np.abs(window.points[member, PV])) < p.clutter.standing_mps:
            continue
        centre = points[mine].mean(axis=0)
        n, heading, agreement = road_map.driven_at(state.road, centre[[PX]], centre[[PY]], p.road)
        known = n[0] >= p.road.driven_tracks and agreement[0] > 0.8
        age_s = (time_us - window.time_us[member]) / 1e6
        trail = window.points[member]
        rows.append(birth.moving_birth(points[mine], trail, age_s, float(heading[0]) if known else None, b))
    if state.frames % b.standing_interval_frames == 0 and len(state.frame_times_us) >= b.standing_min_frames:
        rows += _standing(state, p)
    if not rows:
        return _NO_BIRTHS
    kept = birth.gather(rows)
    if len(state.tracks):
        kept = _outside(kept, rows, state.tracks, p)
    return kept


def _outside(born: birth.Births, rows: list[F64], tracks: Tracks, p: TrackerParameters) -> birth.Births:
    """Return the births that do not stand inside a box, or within the keep-out distance of one."""
    b = p.birth
    g = np.maximum(np.hypot(born.x_m, born.y_m), 1e-6)
    rate = (born.x_m * born.vx_mps + born.y_m * born.vy_mps) / g
    covered = _covered(
        born.x_m, born.y_m, rate, tracks.mean, tracks.heading_rad, tracks.length_m, tracks.width_m,
        (b.keep_out_m, b.keep_out_across_m, 2.0, b.keep_out_like_m, b.keep_out_like_mps),
    )  # fmt: skip
    return birth.gather([r for r, c in zip(rows, covered, strict=True) if not c])


@kernel
def _covered(
    x_m: F64, y_m: F64, rate: F64, mean: F64, heading: F64, length: F64, width: F64,
    margins: tuple[float, ...],
) -> Bool:  # fmt: skip
    """Return which places (N,) lie in a box wider by margins along and across, or so near its centre.

    What moves as the box does (range rate (N,), NaN: unknown) is held to be its own within a wider margin.
    """
    along, across, centre, like_across, like_mps = margins
    out = np.zeros(len(x_m), np.bool_)
    for i in range(len(heading)):
        s, c = math.sin(heading[i]), math.cos(heading[i])
        half_length, half_width = 0.5 * length[i] + along, 0.5 * width[i]
        reach = max(half_length, centre) + half_width + max(across, like_across)
        for k in range(len(x_m)):
            dx, dy = x_m[k] - mean[i, 0], y_m[k] - mean[i, 3]
            if out[k] or abs(dx) > reach or abs(dy) > reach:
                continue  # most are
            u, w = abs(s * dx + c * dy), abs(c * dx - s * dy)
            g = max(math.hypot(x_m[k], y_m[k]), 1e-6)
            like = abs((x_m[k] * mean[i, 1] + y_m[k] * mean[i, 4]) / g - rate[k]) < like_mps
            beside = half_width + (max(across, like_across) if like else across)
            if (u < half_length and w < beside) or math.hypot(u, w) < centre:
                out[k] = True
    return out


def _standing(state: TrackerState, p: TrackerParameters) -> list[F64]:
    w = state.standing_window
    q = w.points[~w.owned]
    if len(state.tracks):
        t, (x, y) = state.tracks, q[:, [PX, PY]].T.copy()
        nothing = np.full(len(x), np.nan)
        inside = _covered(
            x, y, nothing, t.mean, t.heading_rad, t.length_m, t.width_m, (0.7, 0.7, 0.0, 0.0, 0.0)
        )
        q = q[~inside]
    q = q[clutter_map.occupancy_at(state.clutter, q, p.clutter) < p.clutter.ignore_occupancy]
    driven, heading = driven_way(state, q, p)
    lately = Lately(w.points[~w.owned], state.range_seen_min_m)
    in_line, along = queue_lanes(state.tracks, q, ~driven, lately, p.queue_lanes)
    way = birth.Way(driven, np.where(in_line, along, heading), in_line)
    return birth.standing_births(q, max(len(state.frame_times_us), 1), way, p.birth)


def driven_way(state: TrackerState, points: F64, p: TrackerParameters) -> tuple[Bool, F64]:
    """Return which points (N, POINT_COLUMNS) lie where vehicles have driven, and which way (N,) [rad]."""
    n, heading, agreement = road_map.driven_at(state.road, points[:, PX], points[:, PY], p.road)
    return (n >= p.road.driven_tracks) & (agreement > 0.8), heading


def start(
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
        heading_rad=born.heading_rad, heading_var=born.heading_var, turn_rate_radps=np.zeros(n),
        drift=np.zeros(n), ahead_m=np.zeros(n), crept_m=np.zeros(n), scatter=np.ones(n),
        length_m=born.length_m,
        width_m=np.where(born.length_m > p.extent.wide_from_m, p.extent.wide_m, p.birth.width_m),
        log_odds=np.where(sure, e.confirm_log_odds + 1.0, e.birth_log_odds),
        status=np.where(sure, TrackStatus.CONFIRMED, TrackStatus.TENTATIVE).astype(np.uint8),
        hits=np.ones(n, dtype=np.int64), empty=np.zeros(n, dtype=np.int64), born_us=np.full(n, time_us),
        hit_us=np.full(n, time_us), born_x_m=born.x_m, born_y_m=born.y_m, standing=born.standing,
        detect_rate=np.full(n, 0.7), points_per_hit=born.points.astype(np.float64),
        echo_db=np.full(n, state.echo_reference_db), extent_m=rings, map_cell=np.full(n, -1, dtype=np.int64),
        way_m=np.full((n, 4), np.nan),
    )  # fmt: skip
    return state.tracks.join(new)
