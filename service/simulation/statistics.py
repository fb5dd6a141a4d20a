"""How richly a radar sees vehicles by range: points for each vehicle and frame, runs without any."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, I64, U8, Bool

RANGE_EDGES_M = np.array([20.0, 40.0, 70.0, 100.0, 130.0, 150.0])
RUN_LONGER_THAN = (1, 3, 10)  # frames


@dataclass(frozen=True, slots=True)
class Sightings:
    """N rows, one for each vehicle and frame, in any order."""

    frame: I64
    vehicle_id: I64
    kind: U8  # VehicleKind
    range_m: F64  # on the ground, of the centre
    azimuth_rad: F64
    points: I64  # detections of the vehicle in this frame

    def __len__(self) -> int:
        return len(self.frame)

    def take(self, index: I64 | Bool) -> Sightings:
        """Return the rows that an index or a mask picks."""
        return Sightings(
            self.frame[index],
            self.vehicle_id[index],
            self.kind[index],
            self.range_m[index],
            self.azimuth_rad[index],
            self.points[index],
        )


@dataclass(frozen=True, slots=True)
class RangeStatistics:
    """Statistics for each of the B range bins; NaN where there is nothing to count."""

    rows: I64  # (B,) vehicle-frames
    vehicles: I64  # (B,) different vehicles
    mean_points: F64  # (B,)
    seen_share: F64  # (B,) of vehicle-frames with a point at least
    runs: I64  # (B,) runs of frames without a point
    mean_run: F64  # (B,) frames
    longer: F64  # (B, 3) share of the runs longer than RUN_LONGER_THAN


def in_view(rows: Sightings, azimuth_max_rad: float) -> Sightings:
    """Return the rows inside the range bins and the azimuth limit."""
    ranged = (rows.range_m >= RANGE_EDGES_M[0]) & (rows.range_m < RANGE_EDGES_M[-1])
    return rows.take(ranged & (np.abs(rows.azimuth_rad) <= azimuth_max_rad))


def range_statistics(rows: Sightings) -> RangeStatistics:
    """Return the statistics of vehicles in view; a run belongs to the bin of its middle."""
    bins = len(RANGE_EDGES_M) - 1
    place = np.digitize(rows.range_m, RANGE_EDGES_M) - 1
    count = np.bincount(place, minlength=bins)
    vehicles = np.array([len(np.unique(rows.vehicle_id[place == b])) for b in range(bins)])
    length, middle_m = miss_runs(rows)
    run_bin = np.digitize(middle_m, RANGE_EDGES_M) - 1
    runs = np.bincount(run_bin, minlength=bins)
    with np.errstate(invalid="ignore", divide="ignore"):  # an empty bin has no mean
        longer = np.stack(
            [np.bincount(run_bin, length > n, bins) / runs for n in RUN_LONGER_THAN],
            axis=1,
        )
        return RangeStatistics(
            count,
            vehicles,
            np.bincount(place, rows.points, bins) / count,
            np.bincount(place, rows.points > 0, bins) / count,
            runs,
            np.bincount(run_bin, length, bins) / runs,
            longer,
        )


def miss_runs(rows: Sightings) -> tuple[I64, F64]:
    """Return the length [frames] and the mean range of every run of consecutive frames without a point."""
    order = np.lexsort((rows.frame, rows.vehicle_id))
    r = rows.take(order)
    missed = r.points == 0
    opens = missed.copy()
    opens[1:] &= ~(missed[:-1] & (r.vehicle_id[1:] == r.vehicle_id[:-1]) & (r.frame[1:] - r.frame[:-1] == 1))
    run = np.cumsum(opens)[missed] - 1
    if not len(run):
        return np.zeros(0, np.int64), np.zeros(0)
    length = np.bincount(run)
    return length, np.bincount(run, r.range_m[missed]) / length
