"""The compiled kernels of the clustering: features, weighted DBSCAN with radius 1, and the lateral split."""

from __future__ import annotations

import math

import numpy as np

from service.tracking.kernel import kernel, part
from service.tracking.model import F64, I64

NOISE = -1
_LEAST = 2.2250738585072014e-308  # smallest normal number: a point at the radar has no direction
CELL = 1.0 + 1e-6  # side of a grid cell: the radius, and some for rounding
MOST_CELLS_PER_POINT = 4  # larger cells when a few points lie far out
ROUNDING = 1e-9  # relative; a sum of weights that should just reach the limit counts as reaching it


@kernel
def move_on(x: F64, y: F64, speed: F64, age: F64, road: F64, min_cosine: float, moved: F64) -> None:
    """Write x and y (2, N) of points at age 0; `clustering.compensate`. road: (1, 2) or (N, 2), NaN: none."""
    for k in range(len(x)):
        r = max(math.hypot(x[k], y[k]), _LEAST)
        direction_x, direction_y = x[k] / r, y[k] / r
        path = speed[k] * age[k] if math.isfinite(speed[k]) else 0.0
        along_x, along_y = road[k % len(road), 0], road[k % len(road), 1]
        if not math.isnan(along_x):
            cosine = direction_x * along_x + direction_y * along_y
            path /= math.copysign(max(abs(cosine), min_cosine), cosine)
            direction_x, direction_y = along_x, along_y
        moved[0, k], moved[1, k] = x[k] + path * direction_x, y[k] + path * direction_y


@part
def middle_of(values: F64, count: int) -> float:
    """Return the median of the first values, one or more, whose order is lost: select it (Hoare 1961).

    Values change places without a branch, because a processor cannot foresee which are less.
    """
    half, low, high = count // 2, 0, count
    while high - low > 1:
        a, b, c = values[low], values[(low + high) // 2], values[high - 1]
        pivot = max(min(a, b), min(max(a, b), c))
        less = low
        for k in range(low, high):
            value = values[k]
            values[k], values[less] = values[less], value
            less += value < pivot
        if half < less:
            high = less
            continue
        low = equal = less
        for k in range(low, high):
            value = values[k]
            values[k], values[equal] = values[equal], value
            equal += value == pivot
        if half < equal or equal == low:  # the latter where there is no order: not a number
            break
        low = equal
    upper = values[half]
    if count % 2 == 1:
        return float(upper)
    lower = values[0]  # what is before the upper one is no greater
    for k in range(1, half):
        lower = max(lower, values[k])
    return 0.5 * float(lower + upper)


@kernel
def scale(
    along: F64, across: F64, range_m: F64, doppler: F64, age: F64, azimuth_std: F64, radii: tuple[float, ...],
    scaled: F64,
) -> int:  # fmt: skip
    """Write (N, 4) the columns in units of their radii; unknown Doppler as 0. See `clustering.features`.

    Returns how many points have a Doppler.
    """
    offset, slope, eps_least, eps_most, growth, eps_across, noise, eps_doppler, eps_age = radii
    spare, known = np.empty(len(along)), 0
    for k in range(len(along)):
        spare[known] = abs(doppler[k])
        known += math.isfinite(doppler[k])
    eps_along = 0.5 * (eps_least + eps_most)
    if known > 0:
        eps_along = min(max(offset + slope * middle_of(spare, known), eps_least), eps_most)
    for k in range(len(along)):
        spare[k] = azimuth_std[k]
    noise_rad = noise * middle_of(spare, len(along)) if len(along) > 0 else 0.0
    for k in range(len(along)):
        scaled[k, 0] = along[k] / (eps_along * (1.0 + growth * range_m[k]))
        scaled[k, 1] = across[k] / math.hypot(eps_across, noise_rad * range_m[k])
        scaled[k, 2] = (doppler[k] if math.isfinite(doppler[k]) else 0.0) / eps_doppler
        scaled[k, 3] = age[k] / eps_age
    return known


@part
def renumber(labels: I64) -> int:
    """Number the clusters by their first point, in place; return how many there are."""
    largest = 0
    for i in range(len(labels)):
        largest = max(largest, labels[i])
    number = np.full(largest + 1, -1, np.int64)
    clusters = 0
    for i in range(len(labels)):
        if labels[i] < 0:
            continue
        if number[labels[i]] < 0:
            number[labels[i]] = clusters
            clusters += 1
        labels[i] = number[labels[i]]
    return clusters


@part
def sort_by_cell(features: F64, order: I64, cell: I64) -> tuple[I64, int]:
    """Sort points (N >= 1, 4) by the cell of a grid over their first two features, row by row.

    Fills `order` (N,) and `cell` (N,), of the sorted points. Returns where each cell begins and the row's
    length; rows have an empty cell at either end, and an empty row follows.
    """
    points = len(features)
    low0, high0, low1, high1 = features[0, 0], features[0, 0], features[0, 1], features[0, 1]
    for i in range(points):
        low0, high0 = min(low0, features[i, 0]), max(high0, features[i, 0])
        low1, high1 = min(low1, features[i, 1]), max(high1, features[i, 1])
    side = CELL
    while (np.floor((high0 - low0) / side) + 2.0) * (np.floor((high1 - low1) / side) + 3.0) > (
        MOST_CELLS_PER_POINT * points + 6
    ):
        side *= 2.0
    length = int((high1 - low1) / side) + 3
    begin = np.zeros((int((high0 - low0) / side) + 2) * length + 2, np.int64)
    of_point = np.empty(points, np.int64)
    for i in range(points):
        of_point[i] = int((features[i, 0] - low0) / side) * length + int((features[i, 1] - low1) / side) + 1
        begin[of_point[i] + 2] += 1
    for c in range(2, len(begin)):
        begin[c] += begin[c - 1]
    for i in range(points):
        at = begin[of_point[i] + 1]
        begin[of_point[i] + 1] += 1
        order[at], cell[at] = i, of_point[i]
    return begin, length


@part
def close_pairs(u: F64, cell: I64, begin: I64, length: int) -> tuple[I64, I64]:
    """Return (K,) and (K,) all pairs of points within distance 1, from the sorted features u (N, 4).

    Without a branch: one in five is close, in no order that a processor could foresee.
    """
    first, second = np.empty(8 * len(u), np.int64), np.empty(8 * len(u), np.int64)
    found = 0
    for a in range(len(u)):
        u0, u1, u2, u3 = u[a, 0], u[a, 1], u[a, 2], u[a, 3]
        for row in range(2):  # the rest of the own cell and the next one; three cells of the next row
            start, end = a + 1, begin[cell[a] + 2]
            if row == 1:
                start, end = begin[cell[a] + length - 1], begin[cell[a] + length + 2]
            room = found + end - start
            if room > len(first):
                more_first, more_second = np.empty(2 * room, np.int64), np.empty(2 * room, np.int64)
                for p in range(found):
                    more_first[p], more_second[p] = first[p], second[p]
                first, second = more_first, more_second
            for b in range(start, end):
                d0, d1, d2, d3 = u0 - u[b, 0], u1 - u[b, 1], u2 - u[b, 2], u3 - u[b, 3]
                first[found], second[found] = a, b
                found += d0 * d0 + d1 * d1 + d2 * d2 + d3 * d3 <= 1.0
    return first[:found], second[:found]


@part
def nearer(u: F64, point: int, core: int, other: int) -> bool:
    """Return whether `core` is nearer to the point than `other`; of two as near, that of lesser features."""
    to_core = to_other = 0.0
    for f in range(4):
        to_core += (u[core, f] - u[point, f]) ** 2
        to_other += (u[other, f] - u[point, f]) ** 2
    if to_core != to_other:
        return to_core < to_other
    for f in range(4):
        if u[core, f] != u[other, f]:
            return bool(u[core, f] < u[other, f])
    return False


@kernel
def density_clusters(features: F64, weights: F64, min_weight: float, labels: I64) -> int:
    """Fill labels (N,) for features (N, 4), NOISE or numbered by first point; return the number of clusters.

    A point is core when the weights within distance 1, its own included, reach min_weight; core points within
    distance 1 share a cluster; others within distance 1 of a core point join the nearest one's.
    Source: Ester, Kriegel, Sander, Xu 1996, KDD-96.
    """
    points = len(features)
    if points == 0:
        return 0
    order, cell = np.empty(points, np.int64), np.empty(points, np.int64)
    begin, length = sort_by_cell(features, order, cell)
    u, weight, near, root = (
        np.empty((points, 4)),
        np.empty(points),
        np.empty(points),
        np.empty(points, np.int64),
    )
    for a in range(points):
        weight[a] = near[a] = weights[order[a]]
        root[a] = a
        for f in range(4):
            u[a, f] = features[order[a], f]
    first, second = close_pairs(u, cell, begin, length)
    for p in range(len(first)):
        near[first[p]] += weight[second[p]]
        near[second[p]] += weight[first[p]]
    enough = min_weight * (1.0 - ROUNDING)
    nearest = np.full(points, -1, np.int64)  # core point of a border point
    for p in range(len(first)):
        a, b = first[p], second[p]
        if near[a] >= enough and near[b] >= enough:
            if root[a] == root[b]:  # most pairs: already of one cluster
                continue
            while root[a] != a:
                root[a] = root[root[a]]
                a = root[a]
            while root[b] != b:
                root[b] = root[root[b]]
                b = root[b]
            root[max(a, b)] = min(a, b)
        elif near[a] >= enough:
            if nearest[b] < 0 or nearer(u, b, a, nearest[b]):
                nearest[b] = a
        elif near[b] >= enough and (nearest[a] < 0 or nearer(u, a, b, nearest[a])):
            nearest[a] = b
    for a in range(points):
        core = a if near[a] >= enough else nearest[a]
        while core >= 0 and root[core] != core:
            core = root[core]
        labels[order[a]] = core
    return renumber(labels)


@part
def list_clusters(labels: I64, order: I64) -> I64:
    """Fill order (N,) with the points cluster by cluster, noise first; return where each of them ends."""
    clusters = 0
    for n in range(len(labels)):
        clusters = max(clusters, labels[n] + 1)
    end = np.zeros(clusters + 2, np.int64)
    for n in range(len(labels)):
        end[labels[n] + 2] += 1
    for c in range(1, len(end)):
        end[c] += end[c - 1]
    for n in range(len(labels)):
        order[end[labels[n] + 1]] = n
        end[labels[n] + 1] += 1
    return end[:-1]


@part
def sort_across(order: I64, across: F64, spare: I64) -> None:
    """Sort points (M,) by their place across, in place, by merging ever longer runs; spare is for work."""
    width = 1
    while width < len(order):
        for low in range(0, len(order), 2 * width):
            a, b, out = low, min(low + width, len(order)), low
            middle, high = b, min(low + 2 * width, len(order))
            while out < high:
                if a < middle and (b >= high or across[order[a]] <= across[order[b]]):
                    spare[out] = order[a]
                    a += 1
                else:
                    spare[out] = order[b]
                    b += 1
                out += 1
        for n in range(len(order)):
            order[n] = spare[n]
        width *= 2


@part
def is_wide(order: I64, across: F64, spread2: F64, limits: tuple[float, ...]) -> tuple[bool, float, float]:
    """Return whether points (M,) spread wider than one vehicle's, their middle and the variance of one's."""
    count = len(order)
    middle = noise2 = square = 0.0
    for n in range(count):
        middle += across[order[n]] / count
        noise2 += spread2[order[n]] / count
    for n in range(count):
        square += (across[order[n]] - middle) ** 2
    return square / count >= limits[0] * noise2 + limits[1], middle, noise2


@part
def best_cut(order: I64, across: F64, middle: float) -> tuple[int, float, float]:
    """Return after which sorted point to cut (-1: none), the variance explained, the centres' distance."""
    count = len(order)
    left, best, cut, apart = 0.0, 0.0, -1, 0.0
    for n in range(count - 1):
        left += across[order[n]] - middle
        share = (n + 1.0) / count
        between = left * left / (count * share * (1.0 - share))
        if between > best and across[order[n]] < across[order[n + 1]]:
            best, cut = between, n
            apart = -left / (count * share * (1.0 - share))
    return cut, best, apart


@kernel
def split_clusters(
    labels: I64, across: F64, range_m: F64, azimuth_std: F64, width_var: float, limits: tuple[float, ...],
    fewest: int, rounds: int,
) -> int:  # fmt: skip
    """Split clusters of points side by side in place; return the number of clusters.

    labels: (N,) changed in place.  across, range_m: (N,) metres.  azimuth_std: (N,) rad.  width_var: variance
    across of points spread over a vehicle.  limits: skip ratio, skip margin, separation, gain and gain per
    point.  fewest: points that are tested.  rounds: most cuts one after another.
    """
    points = len(labels)
    order, spare, spread2 = np.empty(points, np.int64), np.empty(points, np.int64), np.empty(points)
    for n in range(points):  # variance across of the points of one vehicle there
        spread2[n] = (range_m[n] * azimuth_std[n]) ** 2 + width_var
    bounds = list_clusters(labels, order)
    ends, wide = np.zeros(points, np.bool_), np.zeros(points, np.bool_)  # at the last point of a piece
    for c in range(1, len(bounds)):  # only what is cut needs sorting, and little is
        begin, end = bounds[c - 1], bounds[c]
        if end > begin:
            ends[end - 1] = True
        if end - begin >= max(fewest, 2):
            wide[end - 1] = is_wide(order[begin:end], across, spread2, limits)[0]
            if wide[end - 1]:
                sort_across(order[begin:end], across, spare)
    for _ in range(rounds):
        start, cuts = bounds[0], 0
        for last in range(bounds[0], points):
            if not ends[last]:
                continue
            begin, start = start, last + 1
            if not wide[last]:
                continue
            piece = order[begin:start]
            wide[last], middle, noise2 = is_wide(piece, across, spread2, limits)
            if not wide[last] or len(piece) < fewest:
                continue
            cut, best, apart = best_cut(piece, across, middle)
            if cut >= 0 and apart > limits[2] and best > noise2 * (limits[3] + limits[4] * len(piece)):
                ends[begin + cut] = wide[begin + cut] = True
                cuts += 1
        if cuts == 0:
            break
    piece_number = points  # above every label, for the new ones
    for n in range(bounds[0], points):
        labels[order[n]] = piece_number
        piece_number += ends[n]
    return renumber(labels)
