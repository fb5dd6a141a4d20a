"""Hold radar points against vehicle boxes: whose point is it, and where does it put the centre of the box.

A vehicle is a box with a heading; the radar sees its near faces. `u` runs along the box and `w` across it
(positive to the right), both from the predicted centre. Angles of aspect are between the box's long axis and
the line of sight.
"""

from __future__ import annotations

import math

import numpy as np

from service.tracking.kernel import kernel
from service.tracking.model import F64, I64

# columns of the point array
PX, PY, PV, PG, PVAR_R, PVAR_AZ, PWEIGHT, PECHO = range(8)
POINT_COLUMNS = 8
# columns of the box array
BX, BY, BVX, BVY, BSIN, BCOS, BLEN, BWID, BVAR_U, BVAR_W, BVAR_V, BGROW_NEAR, BGROW_FAR, BPRIOR, BSPEED = (
    range(15)
)
BOX_COLUMNS = 15
# columns of a measurement of one box by one set of points
M_U, M_W, M_VAR_U, M_VAR_W, M_V, M_VAR_V, M_COUNT, M_U_MIN, M_U_MAX, M_ECHO, M_EDGE, M_WEIGHT = range(12)
MEASUREMENT_COLUMNS = 12

# Visible-side bias of the weighted mean across the box, in widths, by aspect angle: side faces turn towards
# the
# radar and pull the mean to their side. Measured on labelled scenes; see docs/tracker.md.
_BIAS_ANGLE_RAD = np.deg2rad(np.array([0.0, 3.0, 8.0, 15.0, 30.0, 60.0, 90.0]))
_BIAS_WIDTHS = np.array([0.0, 0.03, 0.06, 0.12, 0.25, 0.36, 0.39])

_REACH_M = 22.0  # points further than this from a centre belong to no box: half a road train and a margin


@kernel
def point_costs(points: F64, boxes: F64) -> F64:
    """Return the squared normalised distance (T, N) of every point to every box, inf where out of reach.

    points (N, POINT_COLUMNS), boxes (T, BOX_COLUMNS). Zero anywhere inside the box except for a weak pull to
    its long axis; a point without radial velocity (NaN) is judged by its position alone.
    """
    n_boxes, n_points = len(boxes), len(points)
    cost = np.full((n_boxes, n_points), np.inf)
    for i in range(n_boxes):
        b = boxes[i]
        half_length, width = 0.5 * b[BLEN], b[BWID]
        reach = _REACH_M + half_length
        los_norm = max(math.hypot(b[BX], b[BY]), 1e-6)
        to_radar = (
            -(b[BSIN] * b[BX] + b[BCOS] * b[BY]) / los_norm
        )  # cosine of the aspect, + front faces the radar
        across_los = math.sqrt(max(0.0, 1.0 - to_radar * to_radar))
        for j in range(n_points):
            p = points[j]
            dx, dy = p[PX] - b[BX], p[PY] - b[BY]
            if abs(dx) > reach or abs(dy) > reach:
                continue
            u = b[BSIN] * dx + b[BCOS] * dy
            w = b[BCOS] * dx - b[BSIN] * dy
            var_t = p[PG] * p[PG] * p[PVAR_AZ]
            var_u = to_radar * to_radar * p[PVAR_R] + across_los * across_los * var_t
            var_w = across_los * across_los * p[PVAR_R] + to_radar * to_radar * var_t
            # only in its own lane may a box reach beyond its ends: that is how a long vehicle is found to be
            # long
            beyond = 0.0
            if abs(w) < 0.5 * width + 0.6:
                beyond = b[BGROW_NEAR] if u * to_radar > 0.0 else b[BGROW_FAR]
            du = max(abs(u) - half_length - beyond, 0.0)
            dw = max(abs(w) - 0.35 * width, 0.0)
            d2 = du * du / (var_u + b[BVAR_U] + 0.09) + dw * dw / (var_w + b[BVAR_W] + 0.04)
            if d2 > 60.0:
                continue
            if p[PV] == p[PV]:
                dv = p[PV] - (b[BVX] * p[PX] + b[BVY] * p[PY]) / max(p[PG], 1e-6)
                d2 += dv * dv / (0.04 + (0.02 * b[BSPEED]) ** 2 + b[BVAR_V])
            axis = w / (0.5 * width + 0.3)
            cost[i, j] = d2 + 0.25 * axis * axis
    return cost


@kernel
def claim_points(cost: F64, prior: F64, label: I64, gate: float, cluster_gate: float) -> I64:
    """Return the owner (N,) of every point: the box with least cost plus prior inside the gate, -1 for none.

    A cluster (label >= 0) that one box alone claims goes to it as a whole, as far as `cluster_gate`; one that
    several boxes claim is divided between them point by point.
    """
    n_boxes, n_points = cost.shape
    owner = np.full(n_points, -1, dtype=np.int64)
    n_labels = 0
    for j in range(n_points):
        n_labels = max(n_labels, label[j] + 1)
        best = np.inf
        for i in range(n_boxes):
            if cost[i, j] < gate and cost[i, j] + prior[i] < best:
                best = cost[i, j] + prior[i]
                owner[j] = i
    claimant = np.full(n_labels, -1, dtype=np.int64)  # -2: several
    for j in range(n_points):
        if label[j] >= 0 and owner[j] >= 0:
            c = claimant[label[j]]
            if c == -1:
                claimant[label[j]] = owner[j]
            elif c != owner[j]:
                claimant[label[j]] = -2
    for j in range(n_points):
        if owner[j] < 0 and label[j] >= 0:
            c = claimant[label[j]]
            if c >= 0 and cost[c, j] < cluster_gate:
                owner[j] = c
    return owner


@kernel
def drop_neighbours(owner: I64, points: F64, boxes: F64) -> None:
    """Give back the farther group when a box's points show a gap sideways that one vehicle cannot have."""
    n = len(owner)
    for i in range(len(boxes)):
        b = boxes[i]
        count = 0
        for j in range(n):
            if owner[j] == i:
                count += 1
        if count < 2:
            continue
        index = np.empty(count, dtype=np.int64)
        w = np.empty(count)
        k = 0
        sigma = 0.0
        for j in range(n):
            if owner[j] == i:
                index[k] = j
                w[k] = b[BCOS] * (points[j, PX] - b[BX]) - b[BSIN] * (points[j, PY] - b[BY])
                sigma += points[j, PG] * math.sqrt(points[j, PVAR_AZ])
                k += 1
        sigma /= count
        order = np.argsort(w)
        if w[order[-1]] - w[order[0]] < b[BWID] + 0.8 + 2.5 * sigma:
            continue
        widest, cut = 0.0, -1
        for k in range(1, count):
            step = w[order[k]] - w[order[k - 1]]
            if step > widest:
                widest, cut = step, k
        if widest < 1.2 + sigma:
            continue
        left = abs(np.mean(w[order[:cut]]))
        right = abs(np.mean(w[order[cut:]]))
        for k in range(count):
            if (k >= cut) == (right > left):
                owner[index[order[k]]] = -1


@kernel
def overlap_counts(cost: F64, owner: I64, gate: float) -> I64:
    """Return (T, T): how many points of set j lie in the gate of box i."""
    n_boxes, n_points = cost.shape
    count = np.zeros((n_boxes, n_boxes), dtype=np.int64)
    for k in range(n_points):
        j = owner[k]
        if j >= 0:
            for i in range(n_boxes):
                if cost[i, k] < gate:
                    count[i, j] += 1
    return count


@kernel
def measure_boxes(
    pair_box: I64, pair_set: I64, owner: I64, points: F64, boxes: F64, range_seen_min: float
) -> F64:
    """Return (P, MEASUREMENT_COLUMNS): where the points of a set put the centre of a box, for each pair.

    Positions are (u, w) from the predicted centre; M_V is the range rate beyond the prediction (NaN without
    Doppler). End-on the near face fixes the centre along the box; at the near edge of the view, where the
    near face is cut off, the far end does; side-on the middle of both ends, or, with one end unseen, only
    that the box holds the points.
    """
    out = np.zeros((len(pair_box), MEASUREMENT_COLUMNS))
    n = len(owner)
    member = np.empty(n, dtype=np.int64)
    dv = np.empty(n)
    for q in range(len(pair_box)):
        b = boxes[pair_box[q]]
        count = 0
        for j in range(n):
            if owner[j] == pair_set[q]:
                member[count] = j
                count += 1
        out[q, M_COUNT] = count
        if count == 0:
            continue
        u_min, u_max, g_min = np.inf, -np.inf, np.inf
        sum_a = sum_aw = sum_a2 = sum_a2var = var_u = echo = 0.0
        n_v = 0
        los_norm = max(math.hypot(b[BX], b[BY]), 1e-6)
        to_radar = -(b[BSIN] * b[BX] + b[BCOS] * b[BY]) / los_norm
        side_los = -(b[BCOS] * b[BX] - b[BSIN] * b[BY]) / los_norm  # + the radar is on the right of the box
        across2 = max(0.0, 1.0 - to_radar * to_radar)
        for k in range(count):
            p = points[member[k]]
            dx, dy = p[PX] - b[BX], p[PY] - b[BY]
            u = b[BSIN] * dx + b[BCOS] * dy
            w = b[BCOS] * dx - b[BSIN] * dy
            u_min, u_max, g_min = min(u_min, u), max(u_max, u), min(g_min, p[PG])
            var_t = p[PG] * p[PG] * p[PVAR_AZ]
            a = p[PWEIGHT]
            sum_a += a
            sum_aw += a * w
            sum_a2 += a * a
            sum_a2var += a * a * (across2 * p[PVAR_R] + to_radar * to_radar * var_t)
            var_u += to_radar * to_radar * p[PVAR_R] + across2 * var_t
            echo += p[PECHO]
            if p[PV] == p[PV]:
                dv[n_v] = p[PV] - (b[BVX] * p[PX] + b[BVY] * p[PY]) / max(p[PG], 1e-6)
                n_v += 1
        effective = sum_a * sum_a / sum_a2
        half, width = 0.5 * b[BLEN], b[BWID]
        angle = math.acos(min(abs(to_radar), 1.0))
        bias = width * np.interp(angle, _BIAS_ANGLE_RAD, _BIAS_WIDTHS)
        out[q, M_W] = sum_aw / sum_a - math.copysign(bias, side_los)
        out[q, M_VAR_W] = sum_a2var / (sum_a * sum_a) + (0.22 * width) ** 2 / effective + 0.0064
        s = 1.0 if to_radar > 0.0 else -1.0
        if abs(to_radar) > 0.5:
            std = 0.12 + 0.6 / count
            if g_min < range_seen_min + 1.5 and los_norm - half < range_seen_min + 3.0:
                out[q, M_EDGE] = 1.0
                far = u_min if s > 0.0 else u_max
                out[q, M_U] = far + s * (half - 0.4)
                std += 0.3
            else:
                near = u_max if s > 0.0 else u_min
                out[q, M_U] = near + s * (0.05 - half)
            out[q, M_VAR_U] = std * std
        else:
            if u_max - u_min > 0.75 * b[BLEN]:
                out[q, M_U] = 0.5 * (u_min + u_max)
                std = 0.3 + 0.3 / count
            else:
                std = 0.5 + 0.5 / count
                if u_max > half:
                    out[q, M_U] = u_max - half
                elif u_min < -half:
                    out[q, M_U] = u_min + half
            out[q, M_VAR_U] = std * std + var_u / (count * count)
        if n_v > 0:
            out[q, M_V] = np.median(dv[:n_v])
        else:
            out[q, M_V] = np.nan
        out[q, M_VAR_V] = 1.0 / max(n_v, 1)  # times the Doppler variance of one point, by the caller
        out[q, M_U_MIN], out[q, M_U_MAX] = u_min, u_max
        out[q, M_ECHO] = echo / count
        out[q, M_WEIGHT] = sum_a
    return out
