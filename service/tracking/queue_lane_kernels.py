"""The inner loops that tell which points are in line with a queue."""

from __future__ import annotations

import math

import numpy as np

from service.tracking.boxes import PECHO, PG, PVAR_AZ, PX, PY
from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, U8, Bool, TrackStatus

_TENTATIVE = int(TrackStatus.TENTATIVE)


@kernel
def in_line(
    mean: F64, heading: F64, length: F64, status: U8, hits: I64, points_per_hit: F64, born_x: F64,
    born_y: F64, points: F64, which: Bool, before: F64, who: tuple[float, ...], lane: tuple[float, ...],
    echoes: tuple[float, ...], way: F64,
) -> Bool:  # fmt: skip
    """Return which points (N, POINT_COLUMNS) are in line with two tracks, and fade.

    which (N,): the points that are asked about; before (M, POINT_COLUMNS): what stood in the last
    second, of no track;
    who, lane, echoes: limits of `QueueLaneParameters`; way (N,): written, the direction of their lanes [rad].
    """
    still, least_hits, least_points, come_m, end_on = who
    reach, half_width, most_apart, askew, beside, least_range = lane
    place_m, stds, fewest, fades = echoes
    told, nearest = np.zeros(len(points), np.bool_), np.full(len(points), np.inf)
    anchors, count = np.empty(len(mean), np.int64), 0
    for i in range(len(mean)):
        x, y = mean[i, 0], mean[i, 3]
        if status[i] == _TENTATIVE or hits[i] < least_hits or math.hypot(mean[i, 1], mean[i, 4]) >= still:
            continue
        seen = points_per_hit[i] >= least_points or math.hypot(x - born_x[i], y - born_y[i]) > come_m
        if seen and abs(math.cos(heading[i] - math.atan2(x, y))) > end_on:
            anchors[count] = i
            count += 1
    for i in anchors[:count]:
        for j in anchors[:count]:
            dx, dy = mean[i, 0] - mean[j, 0], mean[i, 3] - mean[j, 3]
            apart = math.hypot(dx, dy)
            if i == j or apart > most_apart or apart < 0.5 * (length[i] + length[j]):
                continue
            s, c = dx / apart, dy / apart  # from j to i, and on
            turn = math.atan2(s, c)
            if math.cos(turn - heading[i]) < 0.0:
                turn += math.pi
            off = max(abs(math.sin(turn - heading[i])), abs(math.sin(turn - heading[j])))
            if off > askew or off * apart > beside or math.cos(turn - heading[j]) < 0.0:
                continue
            for k in range(len(points)):
                if not which[k] or points[k, PG] < least_range:
                    continue
                x, y = points[k, PX] - mean[i, 0], points[k, PY] - mean[i, 3]
                u = s * x + c * y
                inside = -apart < u < 0.5 * length[i] + reach and abs(c * x - s * y) < half_width
                if inside and abs(u) + apart < nearest[k]:  # the nearest two tell
                    told[k], way[k], nearest[k] = True, turn, abs(u) + apart
    for k in range(len(points)):
        if not told[k]:
            continue
        g = points[k, PG]
        sine, cosine, wide = points[k, PX] / g, points[k, PY] / g, stds * g * math.sqrt(points[k, PVAR_AZ])
        n = sum_e = sum_ee = 0.0
        for m in range(len(before)):
            if abs(before[m, PG] - g) < place_m and abs(cosine * before[m, PX] - sine * before[m, PY]) < wide:
                e = before[m, PECHO] - points[k, PECHO]
                n, sum_e, sum_ee = n + 1.0, sum_e + e, sum_ee + e * e
        # not a number, where nobody knows how strong they are: no
        told[k] = n >= fewest and sum_ee / n - (sum_e / n) ** 2 >= fades
    return told
