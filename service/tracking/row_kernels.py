"""The inner loops that find vehicles among standing points: chains, boxes, rows, and the parting of a row."""

from __future__ import annotations

import math

import numpy as np

from service.tracking.kernel import kernel, part
from service.tracking.model import F64, I64, Bool

# natural logarithms of the density [1/m] of the length of a vehicle in a queue, by the length up to which
# they hold: shorter than a motorcycle, motorcycles (6 %), cars (80 %), trucks and buses (12 %)
_UP_TO_M = (1.6, 3.4, 5.6, 20.0)
_LOG_DENSITY = (-6.0, math.log(0.06 / 1.8), math.log(0.8 / 2.2), math.log(0.12 / 14.4))
_SHORTEST_M, _LONGEST_M = 1.5, 19.0
_LEVELS = 5  # how well a vehicle is seen: from an eighth to twice the mean number of points of a bin
_FEWEST = 0.02  # points of a bin that no vehicle covers, at least
_SHARP_M, _FACE_STEP_M = 0.4, 0.1


def chains(x: F64, y: F64, reach_m: float) -> I64:
    """Return the group (N,) of each place: those that chain with steps under `reach_m` are one.

    A group has the number of its first place.
    """
    order = np.argsort(x, kind="stable")
    return _chains(x[order], y[order], order, reach_m)


@kernel
def _chains(x: F64, y: F64, order: I64, reach_m: float) -> I64:
    """Return what `chains` does for places in order of x: neighbours are looked for to either side."""
    n = len(x)
    out, group, first = np.empty(n, np.int64), np.full(n, -1, np.int64), np.full(n, n, np.int64)
    todo = np.empty(n, dtype=np.int64)
    for seed in range(n):
        if group[seed] >= 0:
            continue
        group[seed] = seed
        todo[0], open_ = seed, 1
        while open_ > 0:
            open_ -= 1
            k = todo[open_]
            for step in (-1, 1):
                m = k + step
                while 0 <= m < n and abs(x[m] - x[k]) < reach_m:
                    if group[m] < 0 and math.hypot(x[m] - x[k], y[m] - y[k]) < reach_m:
                        group[m] = seed
                        todo[open_] = m
                        open_ += 1
                    m += step
    for k in range(n):
        first[group[k]] = min(first[group[k]], order[k])
    for k in range(n):
        out[order[k]] = first[group[k]]
    return out


@kernel
def best_box(x: F64, y: F64, headings: F64, length_m: float, width_m: float) -> tuple[int, float, float, int]:
    """Return the heading's index and the corner (u, w) of the box that holds most places, and how many.

    For each heading and each place as the box's low end, the places of that length are swept in order of w
    with a window of the width. The first of equals wins.
    """
    n = len(x)
    best = (0, 0.0, 0.0, 0)
    inside, u, w = np.empty(n), np.empty(n), np.empty(n)
    for h in range(len(headings)):
        s, c = math.sin(headings[h]), math.cos(headings[h])
        for k in range(n):  # by insertion: a sort of numpy compiles for seconds
            along, across, at = s * x[k] + c * y[k], c * x[k] - s * y[k], k
            while at > 0 and w[at - 1] > across:
                u[at], w[at] = u[at - 1], w[at - 1]
                at -= 1
            u[at], w[at] = along, across
        for a in range(n):
            begin, count = s * x[a] + c * y[a], 0
            for k in range(n):
                if begin <= u[k] <= begin + length_m:
                    inside[count] = w[k]
                    count += 1
            high = 0
            for low in range(count):
                while high < count and inside[high] <= inside[low] + width_m:
                    high += 1
                if high - low > best[3]:
                    best = (h, begin, inside[low], high - low)
    return best


@kernel
def sharpest(x: F64, y: F64, times: F64, headings: F64) -> int:
    """Return the index of the heading along which the places (N,) form the sharpest rows.

    That is the largest sum of squares of the points in slices across; times (N,): points of each place.
    """
    best, which = -1.0, 0
    for h in range(len(headings)):
        s, c = math.sin(headings[h]), math.cos(headings[h])
        low, high = np.inf, -np.inf
        for k in range(len(x)):
            w = c * x[k] - s * y[k]
            low, high = min(low, w), max(high, w)
        counts = np.zeros(int((high - low) / _SHARP_M) + 2)
        for k in range(len(x)):
            counts[int((c * x[k] - s * y[k] - low) / _SHARP_M)] += times[k]
        sharp = 0.0
        for k in range(len(counts) - 1):
            sharp += (counts[k] + counts[k + 1]) ** 2
        if sharp > best:
            best, which = sharp, h
    return which


@kernel
def nearest_face(depth: F64, times: F64, left: Bool, face_m: float) -> float:
    """Return where begins the slice of that depth that holds most points; the nearest of equals.

    depth (N,) away from the radar, times (N,) points of each place; left (N,): the places that count.
    """
    low, high = np.inf, -np.inf
    for k in range(len(depth)):
        if left[k]:
            low, high = min(low, depth[k]), max(high, depth[k])
    low -= 2.0 * _FACE_STEP_M
    wide, n = round(face_m / _FACE_STEP_M), int((high - low) / _FACE_STEP_M) + 1
    before = np.zeros(n + wide + 1)  # points before each step
    for k in range(len(depth)):
        if left[k]:
            before[int((depth[k] - low) / _FACE_STEP_M) + 1] += times[k]
    for k in range(n + wide):
        before[k + 1] += before[k]
    best = 0
    for k in range(n):
        if before[k + wide] - before[k] > before[best + wide] - before[best]:
            best = k
    return low + best * _FACE_STEP_M


def log_length_density(length_m: float) -> float:
    """Return the natural logarithm of the density [1/m] of the length of a vehicle in a queue."""
    for c in range(3):
        if length_m < _UP_TO_M[c]:
            return _LOG_DENSITY[c]
    return _LOG_DENSITY[3]


_length_density = part(log_length_density)


@kernel
def part_row(u: F64, times: F64, limits: tuple[float, ...]) -> F64:
    """Return the vehicles (K, 3) of a row: begin and end [m] along it, and the points of each.

    u (N,) along the row, times (N,) points of each place; limits: bin [m], least gap [m], share of points in
    a gap, fewest points of a vehicle, nats that one more costs, weight of a bin, shape of the negative
    binomial. Optimal partitioning (Jackson et al. 2005), by dynamic programming: best[e] is the
    log-likelihood of the best way to part all bins before e into vehicles and gaps. Some scatterers answer
    better than others, so the points of a bin are negative binomial, more uneven than Poisson's; what all
    ways have in common is left out.
    """
    width, gap_m, leak, fewest, cost, told, shape = limits
    low = u.min() - 0.5
    n = int((u.max() + 0.5 - low) / width) + 1
    before = np.zeros(n + 1)  # points before each bin
    for k in range(len(u)):
        before[int((u[k] - low) / width) + 1] += times[k]
    covered = 0
    for k in range(n):
        covered += before[k + 1] > 0.0
    mean = before.sum() / max(covered, 1)
    score = np.zeros((_LEVELS + 1, n + 1))  # log-likelihood of all bins before one; the last: nobody there
    for level in range(_LEVELS + 1):
        rate = mean * 2.0 ** (level - 3) if level < _LEVELS else max(leak * mean, _FEWEST)
        miss, hit = -shape * math.log(1.0 + rate / shape), math.log(rate / (shape + rate))
        for k in range(n):
            score[level, k + 1] = score[level, k] + told * (miss + before[k + 1] * hit)
    for k in range(n):
        before[k + 1] += before[k]
    nobody = score[_LEVELS]
    tail, shortest, longest = round(gap_m / width), int(_SHORTEST_M / width), int(_LONGEST_M / width)
    best, begin, end = np.zeros(n + 1), np.zeros(n + 1, np.int64), np.zeros(n + 1, np.int64)
    for e in range(1, n + 1):
        best[e], begin[e], end[e] = best[e - 1] + nobody[e] - nobody[e - 1], -1, e - 1
        for b in (e, e - tail):  # a vehicle is followed by a gap, but for the last one
            if b == e and e < n:
                continue
            for a in range(max(0, b - longest), b - shortest + 1):
                if before[b] - before[a] < fewest:
                    continue
                likeliest = -np.inf
                for level in range(_LEVELS):
                    likeliest = max(likeliest, score[level, b] - score[level, a])
                value = best[a] + likeliest + nobody[e] - nobody[b] - cost
                value += _length_density((b - a) * width)
                if value > best[e]:
                    best[e], begin[e], end[e] = value, a, b
    out, found, e = np.empty((n, 3)), 0, n
    while e > 0:
        if begin[e] < 0:
            e = end[e]
            continue
        a, b = begin[e], end[e]
        out[found, 0], out[found, 1], out[found, 2] = low + a * width, low + b * width, before[b] - before[a]
        found += 1
        e = a
    return out[:found][::-1].copy()
