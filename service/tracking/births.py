"""Start tracks: moving vehicles from clusters that no track claims, standing ones from points that stay."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from service.tracking.boxes import PG, PV, PVAR_AZ, PVAR_R, PWEIGHT, PX, PY
from service.tracking.end_on_rows import lanes_end_on
from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, Bool
from service.tracking.row_direction import direction_across
from service.tracking.row_kernels import best_box, chains
from service.tracking.standing_rows import RowParameters, Stood, mostly, stand, thin

VEHICLE_POINT_STD_M = 0.8  # of the places of a vehicle's echoes about their mean, across the line of sight
ROW = 14  # columns of a row of Births ...
ROW_X, ROW_Y = 0, 1  # ... those of the centre
ROW_POINTS = 9  # ... the one of the points in this frame, or a frame
# velocity of what stands, and standard deviations of place [m] and velocity [m/s] along and across the view
_AT_REST = (0.0, 0.0, 0.6, 0.6, 0.3, 0.5)
MAX_STANDING_BOXES = 12  # a bound on the work of one frame, in counts


@dataclass(frozen=True, slots=True)
class BirthParameters:
    """What it takes to start a track."""

    min_points: int = 3  # unclaimed points of one cluster in the window
    min_frames: int = 2  # from so many different frames
    keep_out_m: float = 1.0  # nothing starts within this of a box, ahead of it or behind ...
    keep_out_across_m: float = 0.3  # ... or beside it; ...
    keep_out_like_m: float = 1.1  # ... the same, of what has the range rate of the box: its other side
    keep_out_like_mps: float = 0.5
    tangential_std_mps: float = 2.5  # speed across the line of sight that a new track may have
    radial_std_mps: float = 0.4
    length_m: float = 4.4  # a car until more is known
    width_m: float = 1.9
    road_heading_std_rad: float = 0.15  # of a vehicle about the direction in which others have driven there
    row_heading_std_rad: float = 0.3  # of a vehicle about the row that it stands in, either way round
    guess_heading_std_rad: float = 0.8  # of one whose direction is a guess
    slant_std_rad: float = 0.2  # of an unknown road to the line of sight
    crossing_std_mps: float = 8.0  # across the line of sight, of a vehicle that does not move along it ...
    crossing_below_mps: float = 10.0  # ... and less the faster it does, down to none here
    standing_interval_frames: int = 5
    standing_window_s: float = 1.0
    standing_min_frames: int = 10  # half the window at 20 Hz
    standing_points_per_frame: float = 3.1  # a post gives one, and a box is long enough for three
    row_points_per_frame: float = 2.6  # of a vehicle in a row across the line of sight, which tells the row
    standing_spread_m: float = 1.5
    driven_points_per_frame: float = 0.8  # where vehicles have driven, or queue, less will do
    line_deep_m: float = 0.35  # deviation of their ranges, in line with a queue: one post has less
    standing_cluster_points: int = 6
    rows: RowParameters = field(default_factory=RowParameters)
    standing_along_m: float = 1.3  # gap that a standing vehicle's side may show


@dataclass(frozen=True, slots=True)
class Births:
    """B new tracks: centre, heading, velocity; standard deviations along and across the line of sight."""

    x_m: F64
    y_m: F64
    heading_rad: F64
    vx_mps: F64
    vy_mps: F64
    std_radial_m: F64
    std_tangential_m: F64
    std_radial_mps: F64
    std_tangential_mps: F64
    points: F64  # points in this frame
    extent_m: F64
    length_m: F64
    standing: Bool
    heading_var: F64  # rad^2

    def __len__(self) -> int:
        return len(self.x_m)


class Way(NamedTuple):
    """What is known of the road at N points."""

    driven: Bool  # (N,) vehicles have driven there ...
    heading_rad: F64  # (N,) ... in that direction, or queue in it
    in_line: Bool  # (N,) nobody has, but it is in line with a queue

    def at(self, which: I64 | Bool) -> Way:
        """Return the same at some of the points."""
        return Way(self.driven[which], self.heading_rad[which], self.in_line[which])


@kernel
def birth_clusters(label: I64, free: Bool, frame: I64, current: int, min_points: int, min_frames: int) -> I64:
    """Return the labels with enough free points, from enough frames, one of them the current one."""
    n_labels = 0
    for k in range(len(label)):
        n_labels = max(n_labels, label[k] + 1)
    points, frames = np.zeros(n_labels, dtype=np.int64), np.zeros(n_labels, dtype=np.int64)
    newest, good = np.empty(n_labels, dtype=np.int64), np.empty(n_labels, dtype=np.int64)
    for c in range(n_labels):
        newest[c] = -1
    for k in range(len(label)):  # oldest frame first: a change of frame is a new frame
        c = label[k]
        if c >= 0 and free[k]:
            points[c] += 1
            if frame[k] != newest[c]:
                frames[c] += 1
                newest[c] = frame[k]
    found = 0
    for c in range(n_labels):
        if points[c] >= min_points and frames[c] >= min_frames and newest[c] == current:
            good[found] = c
            found += 1
    return good[:found]


def moving_birth(
    points: F64, trail: F64, age_s: F64, road_heading_rad: float | None, p: BirthParameters
) -> F64:
    """Return one row of Births' floats for the current points of a moving cluster.

    points (n, POINT_COLUMNS) of this frame; trail (m, POINT_COLUMNS), age_s (m,): all points of the cluster.
    The velocity is the Doppler along the line of sight, or along the road's direction where the road map
    knows it. Where it does not, the way that the cluster has come across the line of sight tells what little
    a few frames can.
    """
    v = median(points[:, PV])
    weight = points[:, PWEIGHT]
    x, y = _average(points[:, PX], weight), _average(points[:, PY], weight)
    g = math.hypot(x, y)
    los = math.atan2(x, y)
    speed = 0.0 if math.isnan(v) else v
    heading = los if speed >= 0.0 else los + math.pi
    vx, vy = speed * math.sin(los), speed * math.cos(los)
    std_tangential, heading_var = p.tangential_std_mps, p.guess_heading_std_rad**2
    known = False
    if road_heading_rad is not None:
        along = math.cos(road_heading_rad - los)
        if abs(along) > 0.5 and (speed * along > 0.0 or abs(speed) < 1.0):
            heading = road_heading_rad
            vx, vy = speed / along * math.sin(heading), speed / along * math.cos(heading)
            std_tangential, heading_var, known = min(std_tangential, 1.5), p.road_heading_std_rad**2, True
    if not known:
        # a vehicle that hardly moves along the line of sight may well move across it
        slow = p.crossing_std_mps * math.sqrt(max(1.0 - (speed / p.crossing_below_mps) ** 2, 0.0))
        prior = max(p.tangential_std_mps, p.slant_std_rad * abs(speed), slow)
        sideways, std_tangential = _sideways_speed(trail, age_s, los, prior)
        vx, vy = vx + sideways * math.cos(los), vy - sideways * math.sin(los)
        heading = math.atan2(vx, vy) if abs(sideways) > std_tangential else heading
        heading_var = min(heading_var, (std_tangential / max(math.hypot(vx, vy), 1.0)) ** 2)
    near = float(points[:, PG].min())
    centre = near + 0.05 + 0.5 * p.length_m * abs(math.cos(heading - los))
    n = len(points)
    std_t = math.sqrt(_average(points[:, PVAR_AZ], weight) * g * g / n + 0.16)
    return np.array([
        x * centre / g, y * centre / g, heading, vx, vy,
        math.sqrt(float(points[:, PVAR_R].mean()) + 0.16), std_t,
        10.0 if math.isnan(v) else p.radial_std_mps, 10.0 if math.isnan(v) else std_tangential, n,
        float(points[:, PG].max()) - near, p.length_m, 0.0, heading_var,
    ])  # fmt: skip


def median(values: F64) -> float:
    """Return the median of the known values, NaN for none; numpy's own takes ten times as long."""
    known = np.sort(values[np.isfinite(values)])
    return 0.5 * float(known[(len(known) - 1) // 2] + known[len(known) // 2]) if len(known) else math.nan


def _average(values: F64, weights: F64) -> float:
    """Return the weighted mean; numpy's own takes five times as long."""
    return float((values * weights).sum() / weights.sum())


def _sideways_speed(trail: F64, age_s: F64, los: float, prior_mps: float) -> tuple[float, float]:
    """Return mean and std [m/s] of the speed across the line of sight, to the right, of a cluster's points.

    Least squares of the points' places across over time; a point may lie anywhere on a vehicle, which is
    noise to its speed. The prior has mean zero.
    """
    across = math.cos(los) * trail[:, PX] - math.sin(los) * trail[:, PY]
    variance = trail[:, PVAR_AZ] * trail[:, PG] ** 2 + VEHICLE_POINT_STD_M**2
    w = 1.0 / variance
    t = -age_s
    t = t - _average(t, w)
    information = float((w * t * t).sum()) + 1.0 / prior_mps**2
    return float((w * t * across).sum()) / information, 1.0 / math.sqrt(information)


def gather(rows: list[F64]) -> Births:
    """Return the rows of `moving_birth` and `standing_births` as columns."""
    table = np.array(rows).reshape(-1, ROW)
    x, y, heading, vx, vy, std_r, std_t, std_vr, std_vt, points, extent, length, standing, heading_var = (
        table.T.copy()  # a kernel compiles anew for strided columns
    )
    return Births(
        x, y, heading, vx, vy, std_r, std_t, std_vr, std_vt, points, extent, length, standing > 0.5,
        heading_var,
    )  # fmt: skip


def rows(born: Births) -> list[F64]:
    """Return a row for each new track, as `gather` takes them."""
    table = np.column_stack([
        born.x_m, born.y_m, born.heading_rad, born.vx_mps, born.vy_mps, born.std_radial_m,
        born.std_tangential_m, born.std_radial_mps, born.std_tangential_mps, born.points, born.extent_m,
        born.length_m, born.standing, born.heading_var,
    ])  # fmt: skip
    return list(table)


def standing_births(points: F64, frames: int, way: Way, p: BirthParameters) -> list[F64]:
    """Return rows of Births' floats for the standing vehicles in the points of the last second.

    points (N, POINT_COLUMNS) of `frames` frames, standing, in no box and in no clutter cell; way: of the road
    at these. A box is taken when its points are too many for posts, or fewer on a driven place or in line
    with a queue; it is stretched along a side while the gaps stay small (buses), then its points are taken
    away.
    """
    rows: list[F64] = []
    if len(points) < p.standing_cluster_points:
        return rows
    x, y, times, first = thin(points)
    here = way.at(first)
    group = chains(x, y, p.standing_along_m)
    left = np.bincount(group, times)[group] >= p.standing_cluster_points
    in_rows, inside = _in_rows(x, y, times, frames, here, p)
    rows += in_rows
    left &= ~inside
    for _ in range(MAX_STANDING_BOXES - len(in_rows)):
        if left.sum() < 2:
            break
        seed = int(np.argmax(np.where(left, times, 0)))
        near = left & (group == group[seed])
        known = bool(here.driven[seed] or here.in_line[seed])
        row = _standing_box(x, y, times, near, frames, known, float(here.heading_rad[seed]), p)
        if row is not None and here.in_line[seed]:
            found, mine = row
            wide = max(np.ptp(x[mine]), np.ptp(y[mine])) > p.standing_spread_m
            without_it = wide and found[ROW_POINTS] >= p.standing_points_per_frame
            row = (
                row if without_it or _in_line(x[mine], y[mine], times[mine], here.in_line[mine], p) else None
            )
        if row is None:
            left[seed] = False
            continue
        found, inside = row
        left &= ~inside
        rows.append(found)
    return rows


def _in_rows(x: F64, y: F64, times: F64, frames: int, way: Way, p: BirthParameters) -> tuple[list[F64], Bool]:
    """Return rows of Births' floats for vehicles in rows, side-on or end-on, and their places (N,)."""
    rows: list[F64] = []
    inside = np.zeros(len(x), np.bool_)
    block = chains(x, y, p.rows.reach_m)
    fewest = frames * min(p.driven_points_per_frame, p.row_points_per_frame)
    for b in np.flatnonzero(np.bincount(block, times) >= fewest):  # few: most are posts
        mine = np.flatnonzero(block == b)
        u, v, n, known = x[mine], y[mine], times[mine], way.at(mine)
        driven, queued = mostly(known.driven), known.in_line.any()
        least = p.driven_points_per_frame if driven else p.row_points_per_frame
        enough = n.sum() >= least * frames
        if not (enough or queued):
            continue
        heading = direction_across(u, v, n, frames, known.driven, known.heading_rad, p.rows)
        if heading is not None and not enough:  # a queue tells of its lane only
            continue
        if heading is None:
            least = p.driven_points_per_frame if driven else p.standing_points_per_frame
            lanes = lanes_end_on(u, v, n, frames, known.driven, known.heading_rad, p.length_m, p.rows)
            found, of_vehicle = [], np.zeros(len(u), np.bool_)
            for f, places in lanes:
                in_line = queued and _in_line(u[places], v[places], n[places], known.in_line[places], p)
                # what gives too few points may be a part of another box
                if f.rate >= (p.driven_points_per_frame if in_line else least):
                    found.append(_as_queued(f, known.heading_rad[places]) if in_line else f)
                    of_vehicle |= places
        else:
            found, of_vehicle = stand(u, v, n, frames, heading, p.length_m, p.rows)
            found = [f for f in found if f.rate >= least]
        inside[mine[of_vehicle]] = True
        told = driven or heading is None  # lanes seen end-on have a direction that range tells
        rows += [standing_row(f, told, p) for f in found]
    rows.sort(key=lambda row: -row[ROW_POINTS])  # the best seen
    return rows[:MAX_STANDING_BOXES], inside


def _in_line(x: F64, y: F64, times: F64, in_line: Bool, p: BirthParameters) -> bool:
    """Return whether places are in line with a queue, most of them, and deeper than those of a post."""
    if not mostly(in_line):
        return False
    range_m, total = np.hypot(x, y), times.sum()
    mean = (range_m * times).sum() / total
    return bool(((range_m - mean) ** 2 * times).sum() > p.line_deep_m**2 * total)


def _as_queued(f: Stood, queue_heading_rad: F64) -> Stood:
    """Return the vehicle, facing as the queue at most of its places (M,) does."""
    same = np.cos(queue_heading_rad - f.heading_rad).sum() >= 0.0
    return f if same else replace(f, heading_rad=f.heading_rad + math.pi)


def standing_row(f: Stood, told: bool, p: BirthParameters) -> F64:
    """Return the row of Births' floats of a vehicle that stands in a row; told: so is the row's direction."""
    heading_std_rad = p.road_heading_std_rad if told else p.row_heading_std_rad
    return np.array([
        f.x_m, f.y_m, f.heading_rad, *_AT_REST, f.rate, f.extent_m, f.length_m, 1.0, heading_std_rad**2,
    ])  # fmt: skip


def _standing_box(
    x: F64,
    y: F64,
    times: F64,
    near: Bool,
    frames: int,
    on_road: bool,
    road_heading: float,
    p: BirthParameters,
) -> tuple[F64, Bool] | None:
    index = np.flatnonzero(near)[:60]  # a bound on the work, in counts
    los = math.atan2(float(x[index].mean()), float(y[index].mean()))
    headings = [los, los + math.pi / 2, 0.0, math.pi / 2]
    if on_road:
        headings = [road_heading]
    elif len(index) >= 4:
        _, vectors = np.linalg.eigh(np.cov(np.stack([x[index], y[index]])))
        headings.append(math.atan2(vectors[0, 1], vectors[1, 1]))
    h, u0, w0, _ = best_box(x[index], y[index], np.array(headings), 5.0, 2.3)
    s, c = math.sin(headings[h]), math.cos(headings[h])
    u, w = s * x + c * y, c * x - s * y
    side = near & (w >= w0) & (w <= w0 + 2.3)
    ordered = np.sort(u[side & (u >= u0)])
    steps = np.diff(ordered)
    gap = np.flatnonzero((steps > p.standing_along_m) & (ordered[1:] > u0 + 5.0))
    end = float(ordered[gap[0]] if len(gap) else ordered[-1])
    end = min(end, u0 + 18.0)
    inside = side & (u >= u0) & (u <= end)
    count, spread = int(times[inside].sum()), float(max(np.ptp(u[inside]), np.ptp(w[inside])))
    rate = count / frames
    enough = rate >= p.standing_points_per_frame and spread > p.standing_spread_m
    enough |= on_road and rate >= p.driven_points_per_frame and count >= p.standing_cluster_points
    if not enough:
        return None
    heading = headings[h]
    if math.cos(heading - los) > 0.0 and not on_road:
        heading += math.pi  # an unknown direction: facing the radar
    length = max(p.length_m, end - u0 + 0.4)
    # the nearest end is seen, the far one may not be
    centre_u = 0.5 * (u0 + end)
    to_radar = -(s * math.sin(los) + c * math.cos(los))
    if abs(to_radar) > 0.5:
        centre_u = end - length / 2 + 0.05 if to_radar > 0 else u0 + length / 2 - 0.05
    centre_w = float(np.average(w[inside], weights=times[inside]))
    return (
        np.array([
            s * centre_u + c * centre_w, c * centre_u - s * centre_w, heading, *_AT_REST,
            rate, end - u0, length, 1.0,
            (p.road_heading_std_rad if on_road else p.guess_heading_std_rad) ** 2,
        ]),
        inside,
    )  # fmt: skip
