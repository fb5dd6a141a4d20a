"""Give the points of a frame to the tracks: boxes claim, joint probabilities settle what is contested."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.association_methods import associate
from service.tracking.boxes import (
    BCOS,
    BGROW_FAR,
    BGROW_NEAR,
    BHIDDEN,
    BLEN,
    BOX_COLUMNS,
    BPRIOR,
    BSIN,
    BSPEED,
    BVAR_U,
    BVAR_V,
    BVAR_W,
    BVX,
    BVY,
    BWID,
    BX,
    BY,
    M_COUNT,
    M_U,
    M_V,
    M_VAR_U,
    M_VAR_V,
    M_VAR_W,
    M_W,
    claim_points,
    contested_pairs,
    drop_neighbours,
    measure_boxes,
    point_costs,
)  # fmt: skip
from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, Bool
from service.tracking.parameters import TrackerParameters
from service.tracking.shading import shade
from service.tracking.state import Tracks
from service.tracking.stood import Standing, forbid

OUTLIER_POINTS = 4  # fewer may well be of something else


@dataclass(frozen=True, slots=True)
class Assignment:
    """What the frame says of T tracks: padded measurements, their probabilities, the owner of each point."""

    z: F64  # (T, J, 3) ground range, azimuth, range rate of the box centre
    R: F64  # (T, J, 3, 3)
    beta: F64  # (T, J)
    miss: F64  # (T,)
    measured: F64  # (T, MEASUREMENT_COLUMNS) of each track's own points
    owner: I64  # (N,) index of the claiming track, -1 none
    components: int
    approximated: int


def box_array(tracks: Tracks, mean: F64, cov: F64, hidden: Bool, p: TrackerParameters) -> F64:
    """Return the predicted boxes (T, BOX_COLUMNS); hidden (T,): a nearer vehicle may shadow them."""
    boxes = _box_array(
        mean, cov, tracks.heading_rad, tracks.length_m, tracks.width_m, tracks.hits, tracks.confirmed, hidden,
        tracks.born_x_m, tracks.born_y_m, p.boxes.hidden_travel_m, p.boxes.growth_reach_m,
        p.boxes.young_hits, p.boxes.tentative_handicap, p.boxes.doppler_margin_mps**2,
    )  # fmt: skip
    shade(boxes, tracks, p.sensor, p.shading)
    return boxes


@kernel
def _box_array(
    mean: F64, cov: F64, heading: F64, length: F64, width: F64, hits: I64, confirmed: Bool, hidden: Bool,
    born_x: F64, born_y: F64, hidden_travel: float, growth_reach: float,
    young_hits: int, handicap: float, doppler_margin: float,
) -> F64:  # fmt: skip
    n = len(heading)
    out = np.zeros((n, BOX_COLUMNS))
    for i in range(n):
        s, c = math.sin(heading[i]), math.cos(heading[i])
        x, y, vx, vy = mean[i, 0], mean[i, 3], mean[i, 1], mean[i, 4]
        g = max(math.hypot(x, y), 1e-6)
        lx, ly, speed = x / g, y / g, math.hypot(vx, vy)
        out[i, BX], out[i, BY], out[i, BVX], out[i, BVY], out[i, BSIN], out[i, BCOS] = x, y, vx, vy, s, c
        out[i, BLEN], out[i, BWID], out[i, BSPEED] = length[i], width[i], speed
        xx, xy, yy = cov[i, 0, 0], cov[i, 0, 3], cov[i, 3, 3]
        out[i, BVAR_U] = s * s * xx + 2 * s * c * xy + c * c * yy
        out[i, BVAR_W] = c * c * xx - 2 * s * c * xy + s * s * yy
        out[i, BVAR_V] = lx * lx * cov[i, 1, 1] + 2 * lx * ly * cov[i, 1, 4] + ly * ly * cov[i, 4, 4]
        out[i, BVAR_V] += doppler_margin
        # only end-on and moving may a box reach beyond its ends, mostly the far one
        if speed > 1.0 and abs(lx * s + ly * c) > 0.5:
            reach = min(growth_reach, 0.5 * speed)
            out[i, BGROW_FAR] = reach
            out[i, BGROW_NEAR] = reach * (0.5 if hits[i] < young_hits else 0.2)
        if hidden[i] and math.hypot(x - born_x[i], y - born_y[i]) >= hidden_travel:
            out[i, BHIDDEN] = 1.0
        out[i, BPRIOR] = 2.0 * math.log(max(length[i], 4.0) * width[i]) + (0.0 if confirmed[i] else handicap)
    return out


def assign(
    tracks: Tracks, boxes: F64, z_hat: F64, S_prior: F64, detect: F64, points: F64, label: I64,
    stood: Standing, range_seen_min_m: float, p: TrackerParameters,
) -> Assignment:  # fmt: skip
    """Return the association of a frame's points (N, POINT_COLUMNS) with T tracks.

    z_hat (T, 3) and S_prior (T, 3, 3): expected measurement of the centre and its covariance without noise;
    detect (T,): detection probability; label (N,): cluster of each point, -1 none;
    stood: which of the points stand, and what stood before.

    Each box claims points; the points of one box are one measurement of it. A set that lies in another box's
    gate as well is contested, and the exact marginals of joint probabilistic data association divide it
    (Fortmann, Bar-Shalom and Scheffe 1983), with a measurement of its own for each pair of box and set,
    because the near face that a point stands for depends on the box.
    """
    cost = point_costs(points, boxes)
    forbid(cost, boxes, points, stood, max(p.boxes.gate, p.boxes.cluster_gate), p.stood)
    owner = claim_points(cost, boxes[:, BPRIOR].copy(), label, p.boxes.gate, p.boxes.cluster_gate)
    drop_neighbours(owner, points, boxes)
    box, group = contested_pairs(cost, owner, p.boxes.gate)
    measured = measure_boxes(box, group, owner, points, boxes, range_seen_min_m)
    exists = 1.0 / (1.0 + np.exp(-tracks.log_odds))
    pd = exists * detect
    b = p.boxes
    z, R, log_weight = _weigh_pairs(
        box, group, measured, boxes, z_hat, S_prior, pd,
        (*doppler_noise(p), b.doppler_floor_mps**2, b.clutter_per_m2_mps, b.clutter_per_m2, b.ellipse_gate,
         b.outlier_d2),
    )  # fmt: skip
    joint = associate(b.association, log_weight, np.log1p(-pd), temper=b.temper)
    zs, Rs, beta, own = _padded(box, group, z, R, measured, joint.beta, len(tracks))
    return Assignment(zs, Rs, beta, joint.miss, own, owner, joint.components, joint.approximated)


def doppler_noise(p: TrackerParameters) -> tuple[float, float]:
    """Return two parts of the variance of a point's range rate.

    What wheels and turning bodies spread [m^2/s^2], the same for every point, and the radar's own noise for
    each m^2 of its range variance [1/s^2]: both worsen alike as the echo weakens.
    """
    s = p.sensor
    spread = max(p.boxes.doppler_noise_factor**2 - 1.0, 0.0) * s.velocity_std_mps**2
    return spread, (s.velocity_std_mps / s.range_std_m) ** 2


@kernel
def _weigh_pairs(
    box: I64, group: I64, measured: F64, boxes: F64, z_hat: F64, S_prior: F64, pd: F64, q: tuple[float, ...]
) -> tuple[F64, F64, F64]:
    """Return each pair's measured centre (P, 3), its covariance (P, 3, 3), and log weights (T, T).

    The weight of a pair is P_D N(innovation; 0, S) over the density of clutter; a pair of another box's set
    outside the elliptical gate weighs nothing. Clutter is uniform in the plane: an element of azimuth is
    wider far away.
    """
    spread_var, doppler_share, doppler_floor, density3, density2, gate, outlier = q
    n_pairs, n = len(box), len(boxes)
    z, R = np.empty((n_pairs, 3)), np.zeros((n_pairs, 3, 3))
    log_weight = np.full((n, n), -np.inf)
    S, L, e = np.empty((3, 3)), np.zeros((3, 3)), np.empty(3)
    for k in range(n_pairs):
        i, m = box[k], measured[k]
        b = boxes[i]
        x = b[BX] + b[BSIN] * m[M_U] + b[BCOS] * m[M_W]
        y = b[BY] + b[BCOS] * m[M_U] - b[BSIN] * m[M_W]
        g = max(math.hypot(x, y), 1e-3)
        lx, ly = x / g, y / g
        cu, su = (
            b[BSIN] * lx + b[BCOS] * ly,
            b[BSIN] * ly - b[BCOS] * lx,
        )  # along the line of sight, across it
        cw, sw = b[BCOS] * lx - b[BSIN] * ly, b[BCOS] * ly + b[BSIN] * lx
        var_u, var_w = m[M_VAR_U], m[M_VAR_W]
        z[k, 0], z[k, 1], z[k, 2] = g, math.atan2(x, y), z_hat[i, 2] + m[M_V]
        R[k, 0, 0] = cu * cu * var_u + cw * cw * var_w
        R[k, 1, 1] = (su * su * var_u + sw * sw * var_w) / (g * g)
        R[k, 0, 1] = R[k, 1, 0] = (cu * su * var_u + cw * sw * var_w) / g
        R[k, 2, 2] = spread_var / max(m[M_COUNT], 1.0) + doppler_share * m[M_VAR_V] + doppler_floor
        size = 3 if m[M_V] == m[M_V] else 2
        e[0], e[1], e[2] = g - z_hat[i, 0], z[k, 1] - z_hat[i, 1], m[M_V]
        e[1] = (e[1] + math.pi) % (2.0 * math.pi) - math.pi
        for r in range(3):
            for c in range(3):
                S[r, c] = S_prior[i, r, c] + R[k, r, c]
        # Cholesky of the measured channels, with the innovation solved along
        d2 = log_det = 0.0
        for r in range(size):
            for c in range(r + 1):
                value = S[r, c]
                for t in range(c):
                    value -= L[r, t] * L[c, t]
                L[r, c] = math.sqrt(max(value, 1e-18)) if r == c else value / L[c, c]
            for t in range(r):
                e[r] -= L[r, t] * e[t]
            e[r] /= L[r, r]
            d2 += e[r] * e[r]
            log_det += 2.0 * math.log(L[r, r])
        if d2 >= gate and i != group[k]:
            continue
        if d2 > outlier and i == group[k] and m[M_COUNT] >= OUTLIER_POINTS:
            # many points in its gate are its own; where the ends of the box, as they are known, contradict
            # them, the measurement is worth so much less that it is believable
            stretch = d2 / outlier
            for r in range(3):
                for c in range(3):
                    R[k, r, c] += (stretch - 1.0) * (S_prior[i, r, c] + R[k, r, c])
            log_det += size * math.log(stretch)
            d2 = outlier
        log_density = -0.5 * (d2 + log_det + size * math.log(2.0 * math.pi))
        log_clutter = math.log((density3 if size == 3 else density2) * max(g, 1.0))
        # bounded: an outlier among its own points must not leave a track with nothing at all
        log_weight[i, group[k]] = math.log(pd[i]) + max(log_density - log_clutter, -20.0)
    return z, R, log_weight


@kernel
def _padded(
    box: I64, group: I64, z: F64, R: F64, measured: F64, beta: F64, n: int
) -> tuple[F64, F64, F64, F64]:
    """Return z, R and beta of the pairs padded, a row a track, and what each track's own points measure."""
    filled = np.zeros(n, dtype=np.int64)
    width = 1
    for i in box:
        filled[i] += 1
        width = max(width, filled[i])
    zs, Rs, b = np.zeros((n, width, 3)), np.zeros((n, width, 3, 3)), np.zeros((n, width))
    own = np.zeros((n, measured.shape[1]))
    for i in range(n):
        for slot in range(filled[i], width):
            Rs[i, slot, 0, 0] = Rs[i, slot, 1, 1] = Rs[i, slot, 2, 2] = 1.0
        filled[i] = 0
    for k in range(len(box)):
        i = box[k]
        slot = filled[i]
        filled[i] += 1
        b[i, slot] = beta[i, group[k]]
        for c in range(3):
            zs[i, slot, c] = z[k, c]
            for d in range(3):
                Rs[i, slot, c, d] = R[k, c, d]
        if i == group[k]:
            for c in range(measured.shape[1]):
                own[i, c] = measured[k, c]
    return zs, Rs, b, own
