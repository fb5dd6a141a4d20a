"""Hold radar points against vehicle boxes: whose point is it, and where does it put the centre of the box.

A vehicle is a box with a heading; the radar sees its near faces. `u` runs along the box and `w` across it
(positive to the right), both from the predicted centre. Angles of aspect are between the box's long axis and
the line of sight.
"""

from __future__ import annotations

import math

import numpy as np

from service.tracking.kernel import kernel, part
from service.tracking.model import F64, I64

# columns of the point array
PX, PY, PV, PG, PVAR_R, PVAR_AZ, PWEIGHT, PECHO = range(8)
POINT_COLUMNS = 8
# columns of the box array
BX, BY, BVX, BVY, BSIN, BCOS, BLEN, BWID, BVAR_U, BVAR_W, BVAR_V, BGROW_NEAR, BGROW_FAR, BPRIOR, BSPEED = (
    range(15)
)
BHIDDEN = 15  # 1: a nearer vehicle may hide its near face
BSHIFT, BVAR_SHIFT = 16, 17  # to the right, m, of its echoes, since others hide part of it; its variance
BOX_COLUMNS = 18
# columns of a measurement of one box by one set of points
M_U, M_W, M_VAR_U, M_VAR_W, M_V, M_VAR_V, M_COUNT, M_U_MIN, M_U_MAX, M_ECHO, M_EDGE, M_WEIGHT = range(12)
M_TURN, M_VAR_TURN, M_U_MEAN, M_W_MEAN = range(12, 16)  # angle from the heading to the row of points
M_SCATTER = 16  # mean square of the points' places across, in variances of one vehicle's points
MEASUREMENT_COLUMNS = 17

# Visible-side bias of the weighted mean across the box, in widths, by aspect angle: side faces turn towards
# the radar and pull the mean to their side. Measured on labelled scenes; see docs/tracker.md.
_BIAS_ANGLE_RAD = np.deg2rad(np.array([0.0, 3.0, 8.0, 15.0, 30.0, 60.0, 90.0]))
_BIAS_WIDTHS = np.array([0.0, 0.03, 0.06, 0.12, 0.25, 0.36, 0.39])

_FAR = 60.0  # squared distance from which a point has nothing to do with a box: beyond every gate
_SLACK = 1.0 + 1e-9  # rounding must not end a pair that the full sum would keep
ROW_POINTS = 3  # fewer tell no direction
ROW_SPREAD_M2 = 0.2  # variance of a vehicle's echoes about the line along its side, measured likewise
ROW_CORNER = 0.45  # two faces at once pull that line to the diagonal, by this share of width / length
# points in a moving box say only that it holds them: the noise of its centre is so many times an end's
HOLDS_ABOVE_MPS, HOLDS_TIMES = 1.0, 3.0
# of a vehicle in a shadow so few points, which would put it so far back, are not of its near face: they lie
# anywhere in it, with this share of its length as deviation
HIDDEN_POINTS, HIDDEN_BACK_M, HIDDEN_SHARE = 2, 0.8, 0.25
ALONE_M = 1.5  # gap along the box that sets a single point apart ...
ALONE_BEYOND_M = 1.0  # ... if it lies this far beyond the end
EDGE_POINTS_M = 1.5  # points this near the nearest range ever seen ...
EDGE_BOX_M = 3.0  # ... of a box whose near face is predicted this near: the near face is cut off
EDGE_ENTERING_M = 4.0  # of a vehicle that comes in one of the two is enough, with points nearer than this
EDGE_SPEED_MPS = 1.0
NARROW_M = 1.2  # a narrower box is a motorcycle's, with echoes at its front, its middle and its rear ...
NARROW_ECHOES = 3
NARROW_MARGIN_M = 0.4  # ... the outer ones this much inside the box, both together
_REACH_M = 22.0  # points further than this from a centre belong to no box: half a road train and a margin


@kernel
def point_costs(points: F64, boxes: F64) -> F64:
    """Return the squared normalised distance (T, N) of every point to every box, inf where out of reach.

    points (N, POINT_COLUMNS), boxes (T, BOX_COLUMNS). Zero anywhere inside the box except for a weak pull to
    its long axis; a point without radial velocity (NaN) is judged by its position alone.
    """
    n_boxes, n_points = len(boxes), len(points)
    cost = np.empty((n_boxes, n_points))
    x, y, near = np.empty(n_points), np.empty(n_points), np.empty(n_points, np.bool_)
    variance = np.empty(n_points)  # the larger one of a point's, which bounds it in any direction
    widest = 0.0
    for j in range(n_points):
        x[j], y[j] = points[j, PX], points[j, PY]
        variance[j] = max(points[j, PVAR_R], points[j, PG] * points[j, PG] * points[j, PVAR_AZ])
        widest = max(widest, variance[j])
    for i in range(n_boxes):
        b = boxes[i]
        half_length, width = 0.5 * b[BLEN], b[BWID]
        los_norm = max(math.hypot(b[BX], b[BY]), 1e-6)
        # cosine of the aspect, + front faces the radar
        to_radar = -(b[BSIN] * b[BX] + b[BCOS] * b[BY]) / los_norm
        across_los = math.sqrt(max(0.0, 1.0 - to_radar * to_radar))
        # how far from the centre a point may lie at all: nearly every pair ends at one of these comparisons
        own_variance = max(b[BVAR_U], b[BVAR_W]) + 0.09
        far = math.sqrt(_FAR * _SLACK * (widest + own_variance))
        along = half_length + max(b[BGROW_NEAR], b[BGROW_FAR]) + far
        across = 0.35 * width + far
        reach, center_x, center_y = _REACH_M + half_length, b[BX], b[BY]
        reach_x = min(reach, abs(b[BSIN]) * along + abs(b[BCOS]) * across)
        reach_y = min(reach, abs(b[BCOS]) * along + abs(b[BSIN]) * across)
        for j in range(n_points):  # without a branch, so that several points are compared at once
            cost[i, j] = np.inf
            near[j] = (abs(x[j] - center_x) <= reach_x) & (abs(y[j] - center_y) <= reach_y)
        for j in range(n_points):
            if not near[j]:
                continue
            dx, dy, p = x[j] - center_x, y[j] - center_y, points[j]
            u = b[BSIN] * dx + b[BCOS] * dy
            w = b[BCOS] * dx - b[BSIN] * dy
            dw = max(abs(w) - 0.35 * width, 0.0)
            if dw * dw > _FAR * _SLACK * (variance[j] + own_variance):
                continue
            var_t = p[PG] * p[PG] * p[PVAR_AZ]
            var_u = to_radar * to_radar * p[PVAR_R] + across_los * across_los * var_t
            var_w = across_los * across_los * p[PVAR_R] + to_radar * to_radar * var_t
            # only in its own lane may a box reach beyond its ends: so a long vehicle is found to be long
            beyond = 0.0
            if abs(w) < 0.5 * width + 0.6:
                beyond = b[BGROW_NEAR] if u * to_radar > 0.0 else b[BGROW_FAR]
            du = max(abs(u) - half_length - beyond, 0.0)
            d2 = du * du / (var_u + b[BVAR_U] + 0.09) + dw * dw / (var_w + b[BVAR_W] + 0.04)
            if d2 > _FAR:
                continue
            if p[PV] == p[PV]:
                dv = p[PV] - (b[BVX] * p[PX] + b[BVY] * p[PY]) / max(p[PG], 1e-6)
                d2 += dv * dv / ((0.02 * b[BSPEED]) ** 2 + b[BVAR_V])
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
    owner, best = np.empty(n_points, dtype=np.int64), np.empty(n_points)
    n_labels = 0
    for j in range(n_points):
        owner[j], best[j] = -1, np.inf
        n_labels = max(n_labels, label[j] + 1)
    for i in range(n_boxes):
        for j in range(n_points):
            if cost[i, j] < gate and cost[i, j] + prior[i] < best[j]:
                best[j] = cost[i, j] + prior[i]
                owner[j] = i
    claimant = np.empty(n_labels, dtype=np.int64)  # -1: nobody, -2: several
    for c in range(n_labels):
        claimant[c] = -1
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


@part
def insert_sort(value: F64, order: I64, count: int) -> None:
    """Sort the first values and their numbers, in place; equal ones keep their order. For few values."""
    for k in range(1, count):
        v, o, at = value[k], order[k], k
        while at > 0 and value[at - 1] > v:
            value[at], order[at] = value[at - 1], order[at - 1]
            at -= 1
        value[at], order[at] = v, o


@kernel
def drop_neighbours(owner: I64, points: F64, boxes: F64) -> None:
    """Give back the farther group when a box's points show a gap sideways that one vehicle cannot have."""
    n = len(owner)
    begin, member = np.zeros(len(boxes) + 1, dtype=np.int64), np.empty(n, dtype=np.int64)
    list_members(owner, begin, member)
    w = np.empty(n)
    for i in range(len(boxes)):
        b = boxes[i]
        count = begin[i + 1] - begin[i]
        if count < 2:
            continue
        mine = member[begin[i] :]
        sigma, low, high = 0.0, np.inf, -np.inf
        for k in range(count):
            j = mine[k]
            w[k] = b[BCOS] * (points[j, PX] - b[BX]) - b[BSIN] * (points[j, PY] - b[BY])
            sigma += points[j, PG] * math.sqrt(points[j, PVAR_AZ])
            low, high = min(low, w[k]), max(high, w[k])
        sigma /= count
        if high - low < b[BWID] + 0.8 + 2.5 * sigma:
            continue
        insert_sort(w, mine, count)
        widest, cut = 0.0, -1
        for k in range(1, count):
            if w[k] - w[k - 1] > widest:
                widest, cut = w[k] - w[k - 1], k
        if widest < 1.2 + sigma:
            continue
        left = right = 0.0
        for k in range(count):
            if k < cut:
                left += w[k]
            else:
                right += w[k]
        farther_right = abs(right / (count - cut)) > abs(left / cut)
        for k in range(count):
            if (k >= cut) == farther_right:
                owner[mine[k]] = -1


@part
def list_members(owner: I64, begin: I64, member: I64) -> None:
    """List the points of each box: those of box i are member[begin[i] : begin[i + 1]], in their order.

    begin (T + 1,) is zero before; member (N,).
    """
    for j in range(len(owner)):
        if owner[j] >= 0:
            begin[owner[j] + 1] += 1
    for i in range(1, len(begin)):
        begin[i] += begin[i - 1]
    for j in range(len(owner)):
        if owner[j] >= 0:
            member[begin[owner[j]]] = j
            begin[owner[j]] += 1
    for i in range(len(begin) - 1, 0, -1):
        begin[i] = begin[i - 1]
    begin[0] = 0


@kernel
def contested_pairs(cost: F64, owner: I64, gate: float) -> tuple[I64, I64]:
    """Return the boxes (P,) and sets (P,) that may belong together, box by box.

    A box that owns points pairs with their set, and with every other box's set of which half, and one point
    at the least, lies in its gate.
    """
    n_boxes, n_points = cost.shape
    size = np.zeros(n_boxes, dtype=np.int64)
    inside = np.zeros((n_boxes, n_boxes), dtype=np.int64)
    for k in range(n_points):
        if owner[k] >= 0:
            size[owner[k]] += 1
    pairs = 0
    for i in range(n_boxes):
        for k in range(n_points):
            if cost[i, k] < gate and owner[k] >= 0:
                inside[i, owner[k]] += 1
        for j in range(n_boxes):
            if i == j:
                inside[i, j] = size[i] > 0
            else:
                inside[i, j] = inside[i, j] > 0 and 2 * inside[i, j] >= size[j]
            pairs += inside[i, j]
    box, group = np.empty(pairs, dtype=np.int64), np.empty(pairs, dtype=np.int64)
    pairs = 0
    for i in range(n_boxes):
        for j in range(n_boxes):
            if inside[i, j]:
                box[pairs], group[pairs] = i, j
                pairs += 1
    return box, group


@part
def visible_bias(angle_rad: float) -> float:
    """Return the bias of the weighted mean across the box, in widths, at an aspect between the nodes."""
    last = len(_BIAS_ANGLE_RAD) - 1
    if angle_rad >= _BIAS_ANGLE_RAD[last]:
        return float(_BIAS_WIDTHS[last])
    k = 0
    while angle_rad >= _BIAS_ANGLE_RAD[k + 1]:
        k += 1
    slope = (_BIAS_WIDTHS[k + 1] - _BIAS_WIDTHS[k]) / (_BIAS_ANGLE_RAD[k + 1] - _BIAS_ANGLE_RAD[k])
    return float(slope * (angle_rad - _BIAS_ANGLE_RAD[k]) + _BIAS_WIDTHS[k])


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
    begin, members = np.zeros(len(boxes) + 1, dtype=np.int64), np.empty(n, dtype=np.int64)
    list_members(owner, begin, members)
    dv, order = np.empty(n), np.empty(n, dtype=np.int64)
    for q in range(len(pair_box)):
        b = boxes[pair_box[q]]
        member = members[begin[pair_set[q]] :]
        count = begin[pair_set[q] + 1] - begin[pair_set[q]]
        out[q, M_COUNT] = count
        if count == 0:
            continue
        u_min, u_max, g_min = np.inf, -np.inf, np.inf
        u_low, u_high = np.inf, -np.inf  # the outermost but one
        sum_a = sum_aw = sum_a2 = sum_a2var = var_u = echo = var_r = scatter = 0.0
        sum_u = sum_w = sum_uu = sum_uw = var_w = 0.0
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
            u_low, u_high = min(u_low, max(u, u_min)), max(u_high, min(u, u_max))
            u_min, u_max, g_min = min(u_min, u), max(u_max, u), min(g_min, p[PG])
            var_t = p[PG] * p[PG] * p[PVAR_AZ]
            a = p[PWEIGHT]
            sum_a += a
            sum_aw += a * w
            sum_a2 += a * a
            sum_a2var += a * a * (across2 * p[PVAR_R] + to_radar * to_radar * var_t)
            var_u += to_radar * to_radar * p[PVAR_R] + across2 * var_t
            sum_u, sum_w, sum_uu, sum_uw = sum_u + u, sum_w + w, sum_uu + u * u, sum_uw + u * w
            var_w += across2 * p[PVAR_R] + to_radar * to_radar * var_t
            echo += p[PECHO]
            own_w = across2 * p[PVAR_R] + to_radar * to_radar * var_t + (0.25 * b[BWID]) ** 2
            scatter += w * w / (own_w + b[BVAR_W])
            if p[PV] == p[PV]:
                dv[n_v] = p[PV] - (b[BVX] * p[PX] + b[BVY] * p[PY]) / max(p[PG], 1e-6)
                n_v += 1
                var_r += p[PVAR_R]
        if count > 2:  # a point alone beyond an end is of another vehicle, or of nothing
            alone_low = u_low - u_min > ALONE_M and u_min < -0.5 * b[BLEN] - ALONE_BEYOND_M
            alone_high = u_max - u_high > ALONE_M and u_max > 0.5 * b[BLEN] + ALONE_BEYOND_M
        else:
            alone_low = alone_high = False
        effective = sum_a * sum_a / sum_a2
        half, width = 0.5 * b[BLEN], b[BWID]
        angle = math.acos(min(abs(to_radar), 1.0))
        bias = width * visible_bias(angle)
        out[q, M_W] = sum_aw / sum_a - math.copysign(bias, side_los) - b[BSHIFT]
        own_w = sum_a2var / (sum_a * sum_a) + (0.22 * width) ** 2 / effective
        out[q, M_VAR_W] = own_w + b[BVAR_SHIFT] + 0.0064
        s = 1.0 if to_radar > 0.0 else -1.0
        if abs(to_radar) > 0.5:
            std = 0.12 + 0.6 / count
            edge = g_min < range_seen_min + EDGE_POINTS_M and los_norm - half < range_seen_min + EDGE_BOX_M
            if s < 0.0 and b[BSPEED] > EDGE_SPEED_MPS and g_min < range_seen_min + EDGE_ENTERING_M:
                # what comes in is seen too short at first, and how near the view begins depends on the echo
                edge |= min(g_min - EDGE_POINTS_M, los_norm - half - EDGE_BOX_M) < range_seen_min
            if edge:
                out[q, M_EDGE] = 1.0
                u_min, u_max = (u_low if alone_low else u_min), (u_high if alone_high else u_max)
                far = u_min if s > 0.0 else u_max
                out[q, M_U] = far + s * (half - 0.4)
                std += 0.3
            else:
                first, last = (u_low if alone_low else u_min), (u_high if alone_high else u_max)
                near = last if s > 0.0 else first
                if width < NARROW_M and count < NARROW_ECHOES:
                    # which of a motorcycle's echoes answer is chance: the nearest of all is so much nearer
                    near += s * (b[BLEN] - NARROW_MARGIN_M) * (NARROW_ECHOES - count) / (NARROW_ECHOES + 1)
                out[q, M_U] = near + s * (0.05 - half)
                far_end = count <= HIDDEN_POINTS and s * out[q, M_U] < -HIDDEN_BACK_M
                if b[BHIDDEN] > 0.0 and far_end and n_v > 0:  # else only the places tell that it brakes
                    out[q, M_U] = s * min(s * near + half, 0.0)  # none as long as the box holds them
                    std += HIDDEN_SHARE * b[BLEN]
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
                elif b[BSPEED] > HOLDS_ABOVE_MPS:
                    std *= HOLDS_TIMES
            out[q, M_VAR_U] = std * std + var_u / (count * count)
        if n_v > 0:
            insert_sort(dv, order, n_v)
            out[q, M_V] = (dv[(n_v - 1) // 2] + dv[n_v // 2]) / 2.0
        else:
            out[q, M_V] = np.nan
        out[q, M_U_MEAN], out[q, M_W_MEAN] = sum_u / count, sum_w / count
        spread = sum_uu - sum_u * sum_u / count
        out[q, M_VAR_TURN] = np.inf
        if count >= ROW_POINTS and spread > 1e-3:
            corner = ROW_CORNER * width / b[BLEN] * 2.0 * to_radar * side_los
            out[q, M_TURN] = math.atan((sum_uw - sum_u * sum_w / count) / spread) + corner
            out[q, M_VAR_TURN] = (ROW_SPREAD_M2 + var_w / count) / spread
        # of range, m^2: Doppler worsens with a weak echo as range does, so the caller scales it
        out[q, M_VAR_V] = var_r / max(n_v, 1) ** 2
        out[q, M_U_MIN], out[q, M_U_MAX] = u_min, u_max
        out[q, M_ECHO] = echo / count
        out[q, M_WEIGHT] = sum_a
        out[q, M_SCATTER] = scatter / count
    return out
