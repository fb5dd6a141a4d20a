"""Give the points of a frame to the tracks: claims by boxes, then joint probabilities over what is contested."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.association import marginals
from service.tracking.boxes import (
    BCOS, BGROW_FAR, BGROW_NEAR, BLEN, BOX_COLUMNS, BPRIOR, BSIN, BSPEED, BVAR_U, BVAR_V, BVAR_W, BVX, BVY, BWID,
    BX, BY, M_COUNT, M_U, M_V, M_VAR_U, M_VAR_V, M_VAR_W, M_W, PV, claim_points, drop_neighbours, measure_boxes,
    overlap_counts, point_costs,
)  # fmt: skip
from service.tracking.model import F64, I64
from service.tracking.parameters import TrackerParameters
from service.tracking.state import Tracks


@dataclass(frozen=True, slots=True)
class Assignment:
    """What the frame says of T tracks: padded measurements with their probabilities, and the owner of each point."""

    z: F64  # (T, J, 3) ground range, azimuth, range rate of the box centre
    R: F64  # (T, J, 3, 3)
    beta: F64  # (T, J)
    miss: F64  # (T,)
    measured: F64  # (T, MEASUREMENT_COLUMNS) of each track's own points
    owner: I64  # (N,) index of the claiming track, -1 none
    components: int
    approximated: int


def box_array(tracks: Tracks, mean: F64, cov: F64, p: TrackerParameters) -> F64:
    """Return the predicted boxes (T, BOX_COLUMNS)."""
    n = len(tracks)
    out = np.zeros((n, BOX_COLUMNS))
    sine, cosine = np.sin(tracks.heading_rad), np.cos(tracks.heading_rad)
    out[:, BX], out[:, BY], out[:, BVX], out[:, BVY] = mean[:, 0], mean[:, 3], mean[:, 1], mean[:, 4]
    out[:, BSIN], out[:, BCOS] = sine, cosine
    out[:, BLEN], out[:, BWID] = tracks.length_m, tracks.width_m
    xx, xy, yy = cov[:, 0, 0], cov[:, 0, 3], cov[:, 3, 3]
    out[:, BVAR_U] = sine**2 * xx + 2 * sine * cosine * xy + cosine**2 * yy
    out[:, BVAR_W] = cosine**2 * xx - 2 * sine * cosine * xy + sine**2 * yy
    g = np.maximum(np.hypot(mean[:, 0], mean[:, 3]), 1e-6)
    lx, ly = mean[:, 0] / g, mean[:, 3] / g
    out[:, BVAR_V] = lx**2 * cov[:, 1, 1] + 2 * lx * ly * cov[:, 1, 4] + ly**2 * cov[:, 4, 4]
    speed = np.hypot(mean[:, 1], mean[:, 4])
    out[:, BSPEED] = speed
    end_on = np.abs(lx * sine + ly * cosine) > 0.5
    reach = np.where(end_on & (speed > 1.0), np.minimum(p.boxes.growth_reach_m, 0.5 * speed), 0.0)
    out[:, BGROW_FAR] = reach
    out[:, BGROW_NEAR] = reach * np.where(tracks.hits < p.boxes.young_hits, 0.5, 0.2)
    out[:, BPRIOR] = 2.0 * np.log(np.maximum(tracks.length_m, 4.0) * tracks.width_m)
    out[:, BPRIOR] += np.where(tracks.confirmed, 0.0, p.boxes.tentative_handicap)
    return out


def assign(
    tracks: Tracks, boxes: F64, z_hat: F64, S_prior: F64, detect: F64, points: F64, label: I64, range_seen_min_m: float,
    p: TrackerParameters,
) -> Assignment:  # fmt: skip
    """Return the association of a frame's points (N, POINT_COLUMNS) with T tracks.

    z_hat (T, 3) and S_prior (T, 3, 3): expected measurement of the centre and its covariance without noise; detect
    (T,): detection probability; label (N,): cluster of each point, -1 none.

    Each box claims points; the points of one box are one measurement of it. A set that lies in another box's gate as
    well is contested, and the exact marginals of joint probabilistic data association divide it (Fortmann, Bar-Shalom
    and Scheffe 1983), with a measurement of its own for each pair of box and set, because the near face that a point
    stands for depends on the box.
    """
    n = len(tracks)
    cost = point_costs(points, boxes)
    owner = claim_points(cost, boxes[:, BPRIOR], label, p.boxes.gate, p.boxes.cluster_gate)
    drop_neighbours(owner, points, boxes)
    overlap = overlap_counts(cost, owner, p.boxes.gate)
    own = np.diagonal(overlap)
    size = np.bincount(owner[owner >= 0], minlength=n)
    contested = (overlap >= np.maximum(1.0, 0.5 * size)[None, :]) & (size > 0)[None, :]
    np.fill_diagonal(contested, size > 0)
    box, group = np.nonzero(contested)
    measured = measure_boxes(box, group, owner, points, boxes, range_seen_min_m)
    z, R = _polar(measured, boxes[box], z_hat[box], p)
    innovation = z - z_hat[box]
    innovation[:, 1] = (innovation[:, 1] + math.pi) % (2.0 * math.pi) - math.pi
    S = S_prior[box] + R
    no_doppler = np.isnan(innovation[:, 2])
    innovation[no_doppler, 2] = 0.0
    S[no_doppler, 2, :], S[no_doppler, :, 2] = 0.0, 0.0
    S[no_doppler, 2, 2] = 1.0
    solved = np.linalg.solve(S, innovation[:, :, None])[:, :, 0]
    d2 = np.einsum("pi,pi->p", innovation, solved)
    log_density = -0.5 * (d2 + np.linalg.slogdet(2.0 * math.pi * S)[1])
    # clutter is uniform in the plane: an element of azimuth is wider far away
    ground = np.maximum(z[:, 0], 1.0)
    log_clutter = np.log(p.boxes.clutter_per_m2_mps * ground)
    log_clutter = np.where(no_doppler, math.log(p.boxes.clutter_per_m2) + np.log(ground), log_clutter)
    log_weight = np.full((n, n), -np.inf)
    inside = (d2 < p.boxes.ellipse_gate) | (box == group)
    exists = 1.0 / (1.0 + np.exp(-tracks.log_odds))
    pd = exists * detect
    log_weight[box[inside], group[inside]] = (np.log(pd[box]) + np.maximum(log_density - log_clutter, -20.0))[
        inside
    ]
    # a set must be worth more to its own box than nothing at all, or a bounded outlier would starve the track
    joint = marginals(log_weight, np.log1p(-pd), temper=p.boxes.temper)
    return _pad(
        box, group, z, R, measured, joint.beta, joint.miss, owner, own, joint.components, joint.approximated
    )


def _polar(measured: F64, b: F64, z_hat: F64, p: TrackerParameters) -> tuple[F64, F64]:
    """Return the measured centre as (range, azimuth, range rate) (P, 3) and its covariance (P, 3, 3)."""
    u, w = measured[:, M_U], measured[:, M_W]
    x = b[:, BX] + b[:, BSIN] * u + b[:, BCOS] * w
    y = b[:, BY] + b[:, BCOS] * u - b[:, BSIN] * w
    g = np.maximum(np.hypot(x, y), 1e-3)
    z = np.stack([g, np.arctan2(x, y), z_hat[:, 2] + measured[:, M_V]], axis=1)
    lx, ly = x / g, y / g
    cu, su = (
        b[:, BSIN] * lx + b[:, BCOS] * ly,
        b[:, BSIN] * ly - b[:, BCOS] * lx,
    )  # along the line of sight, across it
    cw, sw = b[:, BCOS] * lx - b[:, BSIN] * ly, b[:, BCOS] * ly + b[:, BSIN] * lx
    var_u, var_w = measured[:, M_VAR_U], measured[:, M_VAR_W]
    R = np.zeros((len(g), 3, 3))
    R[:, 0, 0] = cu**2 * var_u + cw**2 * var_w
    R[:, 1, 1] = (su**2 * var_u + sw**2 * var_w) / g**2
    R[:, 0, 1] = R[:, 1, 0] = (cu * su * var_u + cw * sw * var_w) / g
    std = p.boxes.doppler_noise_factor * p.sensor.velocity_std_mps
    R[:, 2, 2] = std**2 * measured[:, M_VAR_V] + p.boxes.doppler_floor_mps**2
    return z, R


def _pad(
    box: I64, group: I64, z: F64, R: F64, measured: F64, beta: F64, miss: F64, owner: I64, own: I64, components: int,
    approximated: int,
) -> Assignment:  # fmt: skip
    """Return the pairs as padded arrays, a row a track."""
    n = len(own)
    slot = np.zeros(len(box), dtype=np.int64)
    per_track = np.bincount(box, minlength=n)
    start = np.concatenate([[0], np.cumsum(per_track)[:-1]])
    slot = np.arange(len(box)) - start[box]  # pairs come ordered by box
    width = max(int(per_track.max(initial=0)), 1)
    zs, Rs = np.zeros((n, width, 3)), np.tile(np.eye(3), (n, width, 1, 1))
    b = np.zeros((n, width))
    zs[box, slot], Rs[box, slot], b[box, slot] = z, R, beta[box, group]
    mine = box == group
    table = np.zeros((n, measured.shape[1]))
    table[box[mine]] = measured[mine]
    return Assignment(zs, Rs, b, miss, table, owner, components, approximated)


__all__ = ["M_COUNT", "PV", "Assignment", "assign", "box_array"]
