"""Find lane lines along one course of road: where paths lie beside it, window by window, joined into lines.

Along the course stand windows; in each, every path gives one lateral offset, from a straight fit of its
points around. Lanes are the peaks of the density of the offsets. Peaks of one window are joined to those of
the next by the least sum of distances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded
from scipy.optimize import linear_sum_assignment

from service.tracking.model import F64, I64, Bool
from service.traffic.steps import Steps

_PEAKS_WORK, _CHAIN_WORK = 150_000, 20_000  # of a window: a third of a millisecond, and a tenth of that
_TREND = 3  # windows whose offsets tell where a line goes on; and the fewest that have a second difference


@dataclass(frozen=True, slots=True)
class LineParameters:
    """How paths become lane lines."""

    window_m: float = 10.0
    fit_reach_m: float = 15.0  # of the points on either side that a path's offset in a window is fitted to
    fit_points: int = 6
    fit_span_m: float = 12.0
    slope_max: float = 0.13  # a path that goes aslant more than this is changing lanes
    bin_m: float = 0.1
    reach_m: float = 30.0  # offsets farther from the course are of another road
    sigma_min_m: float = 0.33  # of the density's kernel
    sigma_max_m: float = 0.60
    neighbour_weight: float = 0.5  # of the windows beside a window
    peak_share: float = 0.08  # of the highest peak
    apart_m: float = 2.3  # of two peaks
    valley: float = 0.75  # between two peaks, as a share of the lower one
    core_m: float = 1.2  # a peak's place is the mean of the offsets this near
    link_m: float = 1.2  # from a peak to one of the next window
    windows_skipped: int = 2  # that a line may miss in a row
    windows_min: int = 3
    paths_min: int = 3
    paths_share: float = 0.03  # of all paths along the course
    stiffness: float = 2.0  # of the smoothing along a line
    offset_std_m: float = 0.5  # of a path about its lane


@dataclass(frozen=True, slots=True)
class Line:
    """A lane line: offsets to the right of the course at places along it."""

    along_m: F64  # (W,) middles of windows, or nearer the ends of what was seen
    right_m: F64  # (W,)
    paths: int  # that lay on it
    spread_m: float  # standard deviation of the paths about it
    windows: int


def offsets(path: I64, along_m: F64, right_m: F64, middles: F64, p: LineParameters) -> F64:
    """Return the offset (K, W) of each of K paths in each window, NaN where it was not seen going straight.

    path (N,) 0..K-1 of each point; middles (W,) of the windows, in equal steps.
    """
    paths = int(path.max(initial=-1)) + 1
    fine = p.window_m / 5.0
    start = middles[0] - 0.5 * p.window_m - p.fit_reach_m
    bins = int(np.ceil((middles[-1] - middles[0] + p.window_m + 2.0 * p.fit_reach_m) / fine))
    place = np.floor((along_m - start) / fine).astype(np.int64)
    inside = (place >= 0) & (place < bins)
    cell = path[inside] * bins + place[inside]
    s, d = along_m[inside], right_m[inside]

    def sums(values: F64) -> F64:
        table = np.bincount(cell, weights=values, minlength=paths * bins).reshape(paths, bins)
        total = np.concatenate([np.zeros((paths, 1)), np.cumsum(table, axis=1)], axis=1)
        return np.asarray(total[:, high] - total[:, low])

    middle_bin = np.rint((middles - start) / fine).astype(np.int64)
    reach = round(p.fit_reach_m / fine)
    low, high = np.maximum(middle_bin - reach, 0), np.minimum(middle_bin + reach, bins)
    n = sums(np.ones(len(s)))
    sx, sy, sxx, sxy = sums(s), sums(d), sums(s * s), sums(s * d)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sx / n
        spread = sxx / n - mean**2
        slope = (sxy / n - mean * sy / n) / spread
        offset = sy / n + slope * (middles - mean)
    straight = (n >= p.fit_points) & (spread >= p.fit_span_m**2 / 12.0) & (np.abs(slope) <= p.slope_max)
    # a fit that ends before the window tells of its middle only from a little way off
    straight &= np.abs(middles - mean) <= 0.6 * p.fit_reach_m
    return np.where(straight & (np.abs(offset) < p.reach_m), offset, np.nan)


def lane_lines(offset: F64, middles: F64, p: LineParameters) -> Steps[list[Line]]:
    """Return the lane lines that offsets (K, W) in windows at `middles` (W,) tell of, from left to right."""
    peaks = []
    for w in range(len(middles)):
        peaks.append(_peaks(offset, w, p))
        yield _PEAKS_WORK
    chains = _chains(peaks, p)
    yield len(middles) * _CHAIN_WORK
    least = max(p.paths_min, p.paths_share * float(np.isfinite(offset).any(axis=1).sum()))
    lines = [_line(chain, offset, middles, p) for chain in chains if len(chain) >= p.windows_min]
    kept = [line for line in lines if line is not None and line.paths >= least]
    return sorted(kept, key=lambda line: float(np.mean(line.right_m)))


def _peaks(offset: F64, w: int, p: LineParameters) -> F64:
    """Return the offsets of the lanes in one window."""
    parts, weights = [offset[:, w]], [1.0]
    for beside in (w - 1, w + 1):
        if 0 <= beside < offset.shape[1]:
            parts.append(offset[:, beside])
            weights.append(p.neighbour_weight)
    values = np.concatenate(parts)
    weight = np.repeat(weights, len(offset))
    known = np.isfinite(values)
    values, weight = values[known], weight[known]
    if not len(values):
        return np.zeros(0)
    found = _density_peaks(values, weight, p)
    for _ in range(2):
        found = np.array([_core_mean(values, weight, place, p) for place in found])
    return found


def _core_mean(values: F64, weight: F64, place: float, p: LineParameters) -> float:
    near = np.abs(values - place) < p.core_m
    return float(np.average(values[near], weights=weight[near])) if near.any() else place


def _density_peaks(values: F64, weight: F64, p: LineParameters) -> F64:
    low, high = values.min() - 2.0, values.max() + 2.0
    bins = max(int(np.ceil((high - low) / p.bin_m)), 3)
    histogram = np.histogram(values, bins=bins, range=(low, high), weights=weight)[0]
    sigma = float(np.clip(weight.sum() ** -0.2, p.sigma_min_m, p.sigma_max_m)) / p.bin_m
    x = np.arange(-np.ceil(4 * sigma), np.ceil(4 * sigma) + 1)
    density = np.convolve(histogram, np.exp(-0.5 * (x / sigma) ** 2), mode="same")
    top = np.flatnonzero((density[1:-1] >= density[:-2]) & (density[1:-1] > density[2:])) + 1
    chosen: list[int] = []
    for peak in top[np.argsort(-density[top], kind="stable")].tolist():
        if density[peak] < p.peak_share * density[top].max():
            break
        if all(_apart(density, peak, other, p) for other in chosen):
            chosen.append(peak)
    width = (high - low) / bins
    return np.array([low + (peak + 0.5) * width for peak in sorted(chosen)])


def _apart(density: F64, peak: int, other: int, p: LineParameters) -> bool:
    between = density[min(peak, other) : max(peak, other) + 1].min()
    return abs(peak - other) * p.bin_m > p.apart_m and between < p.valley * density[peak]


def _chains(peaks: list[F64], p: LineParameters) -> list[list[tuple[int, float]]]:
    """Return lines as lists of (window, offset), joined from window to window."""
    chains: list[list[tuple[int, float]]] = []
    for w, found in enumerate(peaks):
        live = [chain for chain in chains if w - chain[-1][0] <= p.windows_skipped + 1]
        taken = np.zeros(len(found), dtype=np.bool_)
        if live and len(found):
            cost = np.abs(np.array([_expected(chain, w) for chain in live])[:, None] - found)
            rows, columns = linear_sum_assignment(np.minimum(cost, 2.0 * p.link_m))
            for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
                if cost[row, column] < p.link_m:
                    live[row].append((w, float(found[column])))
                    taken[column] = True
        chains += [[(w, float(place))] for place in found[~taken]]
    return chains


def _expected(chain: list[tuple[int, float]], w: int) -> float:
    """Return where a line is expected in a window: on along its last three, damped."""
    recent = chain[-_TREND:]
    if len(recent) < _TREND:
        return recent[-1][1]
    slope = (recent[-1][1] - recent[0][1]) / (recent[-1][0] - recent[0][0])
    return recent[-1][1] + 0.5 * slope * (w - recent[-1][0])


def _line(chain: list[tuple[int, float]], offset: F64, middles: F64, p: LineParameters) -> Line | None:
    first, last = chain[0][0], chain[-1][0]
    windows = np.arange(first, last + 1)
    place = np.interp(windows, [w for w, _ in chain], [d for _, d in chain])
    near = np.abs(offset[:, first : last + 1] - place) < p.core_m
    count = near.sum(axis=0)
    mean = np.where(near, offset[:, first : last + 1], 0.0).sum(axis=0) / np.maximum(count, 1)
    raw = np.where(count > 0, mean, place)
    smooth = smoothed(raw, np.minimum(count, 30) + 0.1, p.stiffness)
    deviation = np.where(near, offset[:, first : last + 1] - smooth, np.nan)
    paths = int((near.sum(axis=1) >= min(2, len(windows))).sum())
    if not near.any():
        return None
    return Line(middles[windows], smooth, paths, float(np.sqrt(np.nanmean(deviation**2))), len(chain))


def smoothed(values: F64, weights: F64, stiffness: float) -> F64:
    """Return values (K,) smoothed by their second differences (Whittaker 1923), against the weights (K,)."""
    count = len(values)
    if count < _TREND:
        return values
    second = np.zeros((3, count))
    main, beside, next_but_one = second
    main[:-2] += 1.0
    main[1:-1] += 4.0
    main[2:] += 1.0
    beside[1:-1] -= 2.0
    beside[2:] -= 2.0
    next_but_one[2:] = 1.0
    bands = stiffness * second[::-1]
    bands[2] += weights
    return np.asarray(solveh_banded(bands, weights * values))


def on_line(offset: F64, middles: F64, line: Line, reach_m: float) -> Bool:
    """Return which offsets (K, W) lie on a line."""
    place = np.interp(middles, line.along_m, line.right_m, left=np.nan, right=np.nan)
    return np.asarray(np.abs(offset - place) < reach_m)
