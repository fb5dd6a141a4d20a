"""Set tracks of the live tracker anew by the guarded FIR reset, from the clusters that no box claims.

The trail of a track holds where its box's centre was measured: by its own points, or, in a frame without
any, by the nearest cluster that no confirmed track claims, seen from its box. A tentative track may be the
lost vehicle: its cluster counts as free, and when its place is taken it is merged away.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.tracking.assigning import Assignment, doppler_noise
from service.tracking.boxes import (
    BCOS,
    BSHIFT,
    BSIN,
    BVAR_SHIFT,
    BVX,
    BVY,
    BX,
    BY,
    M_COUNT,
    M_U,
    M_V,
    M_VAR_U,
    M_VAR_V,
    M_VAR_W,
    M_W,
    measure_boxes,
)  # fmt: skip
from service.tracking.filters.base import Filter, Prediction
from service.tracking.filters.converted import Returns
from service.tracking.model import F64, I64, Bool
from service.tracking.motion import ACCELERATION, POSITION, VELOCITY
from service.tracking.parameters import TrackerParameters
from service.tracking.recovery import (
    RecoveryParameters,
    Reset,
    Scan,
    Trail,
    TrailBook,
    find_resets,
    nearest,
    no_book,
)
from service.tracking.start import ACCELERATION_STD_MPS2
from service.tracking.state import Tracks

PLANAR = (*POSITION, *VELOCITY)  # [x y vx vy] in the six states of a track
_STEADY = 0.3  # relative change of the frame period up to which the window is one of equal steps
_HIT = 0.5  # probability of no measurement below which a frame counts as a hit


@dataclass(frozen=True, slots=True)
class Seen:
    """What the tracker has seen in a frame once its tracks are updated."""

    points: F64  # (N, POINT_COLUMNS)
    label: I64  # (N,) cluster, -1 none
    boxes: F64  # (T, BOX_COLUMNS) predicted
    dt_s: float
    range_seen_min_m: float


def recover(  # noqa: PLR0913, PLR0917 - what was, what was seen, and how to judge it
    tracks: Tracks, a: Assignment, seen: Seen, bank: Filter, book: TrailBook, p: TrackerParameters
) -> tuple[Tracks, Assignment, TrailBook]:
    """Return the tracks, some set anew, the association with their clusters, and the trails after this."""
    r = p.recovery
    if not r.enabled or not len(tracks):
        return tracks, a, no_book()
    if abs(seen.dt_s * p.sensor.rate_hz - 1.0) > _STEADY:
        book = no_book()
    hit = (a.miss < _HIT) & (a.measured[:, M_COUNT] > 0)
    empty = np.where(hit, 0, tracks.empty + 1)
    a = replace(a, owner=a.owner.copy())
    firm = tracks.confirmed
    claimed = np.append(firm, False)[
        a.owner
    ]  # what a tentative track has is free: it may be the lost vehicle
    owner, clusters = _free_clusters(claimed, seen.label, len(tracks))
    boxes = np.concatenate([seen.boxes, np.zeros((clusters, seen.boxes.shape[1]))])
    boxes[:, [BSHIFT, BVAR_SHIFT]] = 0.0  # shadows are other ones where a cluster is
    pairs = np.indices((len(tracks), clusters)).reshape(2, -1)
    measured = measure_boxes(
        pairs[0], len(tracks) + pairs[1], owner, seen.points, boxes, seen.range_seen_min_m
    )
    returns = _centres(measured.reshape(len(tracks), clusters, measured.shape[1]), seen.boxes[:, None])
    mean, cov = _planar(tracks)
    trail = book.of(tracks.number, r.horizon)
    free = np.ones(clusters, np.bool_)
    scan = Scan(mean, cov, empty, firm, trail, returns, free, seen.dt_s)
    for reset in find_resets(scan, r):
        row = measured[reset.track * clusters + reset.by]
        tracks, a = _set_anew(tracks, a, reset, row, seen=seen, bank=bank, p=p)
        a.owner[owner == len(tracks) + reset.by] = reset.track
        hit[reset.track], free[reset.by] = True, False
    own = _centres(a.measured, seen.boxes)
    return tracks, a, TrailBook(tracks.number, _push(scan, tracks, hit, own, r))


def _free_clusters(claimed: Bool, label: I64, tracks: int) -> tuple[I64, int]:
    """Return the points of each unclaimed cluster c as owned by tracks + c, else -1, and their number."""
    free = ~claimed & (label >= 0)
    names, place = np.unique(label[free], return_inverse=True)
    out = np.full(len(label), -1, dtype=np.int64)
    out[free] = tracks + place
    return out, len(names)


def _planar(tracks: Tracks) -> tuple[F64, F64]:
    """Return [x y vx vy] (T, 4) and its covariance (T, 4, 4)."""
    which = list(PLANAR)
    return tracks.mean[:, which], tracks.cov[:, which][:, :, which]


def _centres(measured: F64, box: F64) -> Returns:
    """Return where measurements (..., MEASUREMENT_COLUMNS) put the centres of their boxes in the plan."""
    s, c, u, w = box[..., BSIN], box[..., BCOS], measured[..., M_U], measured[..., M_W]
    z = np.stack([box[..., BX] + s * u + c * w, box[..., BY] + c * u - s * w], axis=-1)
    turn = np.stack([np.stack([s, c], axis=-1), np.stack([c, -s], axis=-1)], axis=-2)
    spread = np.stack([measured[..., M_VAR_U], measured[..., M_VAR_W]], axis=-1)
    R = np.asarray(turn @ (np.maximum(spread, 1e-4)[..., None] * turn))
    return Returns(z, R)


def _set_anew(  # noqa: PLR0913 - what the frame is to the track
    tracks: Tracks, a: Assignment, reset: Reset, row: F64, *, seen: Seen, bank: Filter, p: TrackerParameters
) -> tuple[Tracks, Assignment]:
    """Return the tracks with one set anew and updated by its cluster, which counts as its hit."""
    i, which = reset.track, list(PLANAR)
    mean, cov = np.zeros((1, 6)), np.zeros((1, 6, 6))
    mean[0, which] = reset.mean
    cov[0][np.ix_(which, which)] = reset.cov
    cov[0, list(ACCELERATION), list(ACCELERATION)] = ACCELERATION_STD_MPS2**2
    fresh = bank.start(mean, cov)
    z, R = _polar(row, seen.boxes[i], p)
    prediction = Prediction(fresh.mean, fresh.cov, np.zeros((6, 6)), fresh.memory)
    after = bank.update(prediction, z[None, None], R[None, None], np.ones((1, 1)), np.zeros(1))
    means, covs, memory = tracks.mean.copy(), tracks.cov.copy(), tracks.memory.copy()
    means[i], covs[i], memory[i] = after.mean[0], after.cov[0], after.memory[0]
    measured, miss = a.measured.copy(), a.miss.copy()
    measured[i], miss[i] = row, 0.0
    return replace(tracks, mean=means, cov=covs, memory=memory), replace(a, measured=measured, miss=miss)


def _polar(row: F64, box: F64, p: TrackerParameters) -> tuple[F64, F64]:
    """Return z (3,) and R (3, 3) of one measurement of a box: range, azimuth and range rate of its centre."""
    view = _centres(row, box)
    x, y = view.z
    g = max(float(np.hypot(x, y)), 1e-3)
    J = np.array([[x / g, y / g], [y / g**2, -x / g**2]])
    R = np.zeros((3, 3))
    R[:2, :2] = J @ view.R @ J.T
    spread_var, doppler_share = doppler_noise(p)
    R[2, 2] = spread_var / max(row[M_COUNT], 1.0) + doppler_share * row[M_VAR_V]
    R[2, 2] += p.boxes.doppler_floor_mps**2
    rate = (box[BVX] * x + box[BVY] * y) / g + row[M_V]
    return np.array([g, np.arctan2(x, y), rate]), R


def _push(s: Scan, tracks: Tracks, hit: Bool, own: Returns, p: RecoveryParameters) -> Trail:
    """Return the trails with this frame: a track's own measurement, or the nearest free cluster's."""
    mean, cov = _planar(tracks)
    z, R, there = own.z, own.R, hit
    if s.returns.z.shape[1]:
        which, near = nearest(mean, cov, s.returns, s.free[None, :], p)
        row = np.arange(len(mean))
        z = np.where(hit[:, None], z, s.returns.z[row, which])
        R = np.where(hit[:, None, None], R, s.returns.R[row, which])
        there = hit | near
    return s.trail.push(z, R, there, ~hit)
