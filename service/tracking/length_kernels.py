"""Learn how long boxes are from the extents of their points, and hold the face that the radar sees."""

from __future__ import annotations

import math

import numpy as np

from service.tracking.boxes import M_COUNT, M_EDGE, M_U_MAX, M_U_MIN
from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, Bool


@kernel
def learn_length(
    mean: F64, heading: F64, length: F64, width: F64, ring: F64, measured: F64, hit: Bool, hits: I64,
    points_per_hit: F64, across_std_rad: float, lengths: tuple[float, ...],
    ends: tuple[float, ...], widths: tuple[float, ...],
) -> None:  # fmt: skip
    """Update lengths and widths in place, holding the near face (at the near edge of view, the far one)."""
    percentile, growth, edge_growth, shrink, frozen_below, frozen_after = lengths[:6]
    shortest, longest, car, narrow_extent, narrow_points, narrow_hits, assumed_hits = lengths[6:]
    least_margin, margin_share, told, told_per_m, told_cosine = ends
    wide_from, wide, car_width, narrow_below, narrow_width = widths
    ordered = np.empty(ring.shape[1])
    for i in range(len(length)):
        if not hit[i] or measured[i, M_COUNT] < 2.0:
            continue
        x, y = mean[i, 0], mean[i, 3]
        speed = math.hypot(mean[i, 1], mean[i, 4])
        aspect = heading[i] - math.atan2(x, y)
        across = across_std_rad * math.hypot(x, y)
        extent = measured[i, M_U_MAX] - measured[i, M_U_MIN] - 2.0 * abs(math.sin(aspect)) * across
        ring[i, hits[i] % ring.shape[1]] = max(extent, 0.0)
        if speed < frozen_below and hits[i] > frozen_after:
            continue
        count = 0
        for past in ring[i]:
            if math.isnan(past):  # not yet seen
                continue
            at = count
            while at > 0 and ordered[at - 1] > past:
                ordered[at] = ordered[at - 1]
                at -= 1
            ordered[at] = past
            count += 1
        rank = min(max(math.ceil(percentile / 100.0 * count) - 1, 0), count - 1)
        margin = max(least_margin, margin_share / (1.0 - margin_share) * ordered[rank])
        seen, most_shrink = ordered[rank] + margin, shrink
        end_on = abs(math.cos(aspect)) > told_cosine
        if end_on and points_per_hit[i] >= max(told, told_per_m * length[i]):
            target = seen
        elif narrow_below <= length[i] <= car:  # what few points do not show may be there all the same
            target = max(seen, length[i])
        else:
            target = max(seen, car)
        if count >= narrow_hits and seen < narrow_extent and points_per_hit[i] < narrow_points:
            target, most_shrink = shortest, (growth if end_on and hits[i] < assumed_hits else shrink)
        edge = measured[i, M_EDGE] > 0.5
        if edge and math.cos(aspect) > 0.0:  # it comes into view: what is seen of it only grows
            target = max(target, min(extent, ordered[count - 1]) + margin)
        change = min(max(target - length[i], -most_shrink), edge_growth if edge else growth)
        new = min(max(length[i] + change, shortest), longest)
        facing = math.cos(aspect)
        if abs(facing) > 0.5:
            shift = 0.5 * (new - length[i]) * (1.0 if (facing > 0.0) != edge else -1.0)
            mean[i, 0] += shift * math.sin(heading[i])
            mean[i, 3] += shift * math.cos(heading[i])
        length[i] = new
        width[i] = wide if new > wide_from else (narrow_width if new < narrow_below else car_width)
