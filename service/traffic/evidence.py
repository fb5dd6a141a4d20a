"""Keep the paths of vehicles that lanes are learned from: the latest of each lane, a bounded number.

Each path is smoothed and set out in equal steps, so that a slow vehicle weighs as much as a fast one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.model import F32, F64, I64, U8
from service.traffic.curves import along, headings, resample
from service.traffic.model import Trajectory


@dataclass(frozen=True, slots=True)
class EvidenceParameters:
    """Which paths tell of lanes, and how many are kept."""

    paths: int = 400  # kept; the oldest of the lane with most goes first
    forget_after: int = 1200  # paths later also that of a lane which nobody uses any more
    shortest_m: float = 20.0  # shorter paths tell nothing
    shortest_s: float = 1.0
    samples_min: int = 3
    step_m: float = 2.0  # between the points of a path
    smooth_m: float = 6.0  # over which a path is averaged
    longest_m: float = 400.0  # of one path; the rest is cut off


@dataclass(frozen=True, slots=True)
class Evidence:
    """N points of paths, path after path in order of age, and K paths."""

    path: I64  # (N,) counter of the path
    x_m: F32
    y_m: F32
    heading_rad: F32
    paths: I64  # (K,) counters, rising
    lane: U8  # (K,) in which most of the path lay
    next_path: int


def no_evidence() -> Evidence:
    """Return the state before the first path."""
    i, f = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.float32)
    return Evidence(i, f, f, f, i, np.zeros(0, dtype=np.uint8), 1)


def add(evidence: Evidence, path: Trajectory, p: EvidenceParameters) -> Evidence:
    """Return the evidence with one more path, without its oldest where it was full."""
    points = smooth_path(path, p)
    if points is None:
        return evidence
    if len(evidence.paths) >= p.paths:
        evidence = _without(evidence, _oldest_of_most(evidence))
    if len(evidence.paths) and evidence.next_path - evidence.paths[0] > p.forget_after:
        evidence = _without(evidence, 0)
    lanes = path.samples.lane[path.samples.lane > 0]
    lane = np.bincount(lanes).argmax() if len(lanes) else 0
    number = evidence.next_path
    f = np.float32
    return Evidence(
        path=np.concatenate([evidence.path, np.full(len(points), number, dtype=np.int64)]),
        x_m=np.concatenate([evidence.x_m, points[:, 0].astype(f)]),
        y_m=np.concatenate([evidence.y_m, points[:, 1].astype(f)]),
        heading_rad=np.concatenate([evidence.heading_rad, headings(points).astype(f)]),
        paths=np.append(evidence.paths, number),
        lane=np.append(evidence.lane, np.uint8(lane)),
        next_path=number + 1,
    )


def smooth_path(path: Trajectory, p: EvidenceParameters) -> F64 | None:
    """Return points (P, 2) in equal steps along a path, or None where it is too short to tell of lanes."""
    samples = path.samples
    if (
        len(samples.time_us) < p.samples_min
        or (samples.time_us[-1] - samples.time_us[0]) / 1e6 < p.shortest_s
    ):
        return None
    points = np.column_stack([samples.x_m, samples.y_m]).astype(np.float64)
    length = along(points)
    fine = np.arange(0.0, min(length[-1], p.longest_m), 0.5 * p.step_m)
    if not len(fine) or fine[-1] < p.shortest_m:
        return None
    dense = np.column_stack([np.interp(fine, length, points[:, k]) for k in (0, 1)])
    reach = max(round(p.smooth_m / p.step_m), 1)
    return resample(_averaged(dense, reach), p.step_m)


def _averaged(points: F64, reach: int) -> F64:
    """Return the mean over `reach` points on either side, fewer (but as many on both) near the ends."""
    count = len(points)
    total = np.concatenate([np.zeros((1, 2)), np.cumsum(points, axis=0)])
    index = np.arange(count)
    here = np.minimum(np.minimum(index, count - 1 - index), reach)
    return np.asarray((total[index + here + 1] - total[index - here]) / (2 * here + 1)[:, None])


def _oldest_of_most(evidence: Evidence) -> int:
    """Return the place of the oldest path of the lane that has most."""
    crowded = int(np.bincount(evidence.lane).argmax())
    return int((evidence.lane == crowded).argmax())


def _without(evidence: Evidence, at: int) -> Evidence:
    """Return the evidence without the path at a place; its points are one piece of the table."""
    e, number = evidence, evidence.paths[at]
    first, end = np.searchsorted(e.path, number), np.searchsorted(e.path, number, side="right")
    return Evidence(
        path=np.concatenate((e.path[:first], e.path[end:])),
        x_m=np.concatenate((e.x_m[:first], e.x_m[end:])),
        y_m=np.concatenate((e.y_m[:first], e.y_m[end:])),
        heading_rad=np.concatenate((e.heading_rad[:first], e.heading_rad[end:])),
        paths=np.delete(e.paths, at),
        lane=np.delete(e.lane, at),
        next_path=e.next_path,
    )


def latest(evidence: Evidence, count: int) -> Evidence:
    """Return only the latest paths: the older ones tell of a road that is no more."""
    paths, lane = evidence.paths[-count:], evidence.lane[-count:]
    keep = np.isin(evidence.path, paths)
    return Evidence(
        evidence.path[keep], evidence.x_m[keep], evidence.y_m[keep], evidence.heading_rad[keep], paths, lane,
        evidence.next_path,
    )  # fmt: skip
