"""Notice when traffic stops fitting the lane map: the mast has moved, or the road was rebuilt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, U8
from service.traffic.curves import beside
from service.traffic.model import LaneDrift, LaneMap, Trajectory


@dataclass(frozen=True, slots=True)
class DriftParameters:
    """When a vehicle does not fit the map, and when that is an alarm."""

    vehicles: int = 40  # the latest that are judged
    vehicles_min: int = 20
    open_share: float = 0.4  # of them that do not fit
    close_share: float = 0.2
    path_m: float = 30.0  # shorter paths are not judged ...
    samples_min: int = 3  # ... nor those with fewer samples
    outside_share: float = 0.5  # of its path that a vehicle which does not fit is in no lane ...
    offset_m: float = 0.9  # ... or its mean distance from the middle of its lanes


@dataclass(frozen=True, slots=True)
class Drift:
    """The latest vehicles, oldest first: 1 where one did not fit."""

    misfit: U8  # (K,)
    opened: bool


def no_drift() -> Drift:
    """Return the state before the first vehicle."""
    return Drift(np.zeros(0, dtype=np.uint8), opened=False)


def judge(
    drift: Drift, path: Trajectory, lane_map: LaneMap, p: DriftParameters
) -> tuple[Drift, LaneDrift | None]:
    """Return the state after one more finished path, and what is to be told about it.

    Paths that began before the map, and short ones, are not judged.
    """
    samples = path.samples
    if not lane_map.lanes or len(samples.time_us) < p.samples_min or samples.time_us[0] < lane_map.time_us:
        return drift, None
    points = np.column_stack([samples.x_m, samples.y_m]).astype(np.float64)
    if float(np.hypot(*(points[-1] - points[0]))) < p.path_m:
        return drift, None
    misfit = np.append(drift.misfit, np.uint8(_misfit(points, samples.lane, lane_map, p)))[-p.vehicles :]
    share, count = float(misfit.mean()), len(misfit)
    if not drift.opened and count >= p.vehicles_min and share >= p.open_share:
        return Drift(misfit, opened=True), LaneDrift(True, share, count, lane_map.version)
    if drift.opened and share <= p.close_share:
        return Drift(misfit, opened=False), LaneDrift(False, share, count, lane_map.version)
    return Drift(misfit, drift.opened), None


def _misfit(points: F64, lane: U8, lane_map: LaneMap, p: DriftParameters) -> bool:
    if float((lane == 0).mean()) > p.outside_share:
        return True
    total = 0.0
    for index in np.unique(lane[lane > 0]).tolist():
        found = lane_map.lane(index)
        if found is not None:
            total += float(np.abs(beside(points[lane == index], found.points_m).right_m).sum())
    return total / max(int((lane > 0).sum()), 1) > p.offset_m
