"""How richly a radar sees vehicles by range: points of a vehicle in a frame, runs of frames without any."""

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

    def in_view(self, azimuth_max_rad: float) -> Sightings:
        """Return the rows inside the range bins and the azimuth limit."""
        ranged = (self.range_m >= RANGE_EDGES_M[0]) & (self.range_m < RANGE_EDGES_M[-1])
        return self.take(ranged & (np.abs(self.azimuth_rad) <= azimuth_max_rad))


@dataclass(frozen=True, slots=True)
class Share:
    """A mean in each of the B range bins, NaN where nothing was counted, with its standard error.

    Rows of one vehicle are not independent, so the error is that of a ratio of sums over vehicles (Cochran
    1977, "Sampling Techniques", chapter 6): variance = sum_v (total_v - mean count_v)^2 / count^2.
    """

    value: F64  # (B,)
    std_error: F64  # (B,)
    count: I64  # (B,) of what the mean is taken over


@dataclass(frozen=True, slots=True)
class RangeStatistics:
    """What is compared between two radars that look at the same vehicles."""

    points: Share  # of a vehicle in a frame
    seen: Share  # frames with a point at least
    run: Share  # length [frames] of a run without a point; a run belongs to the bin of its middle
    run_longer: tuple[Share, ...]  # share of the runs longer than RUN_LONGER_THAN


def range_statistics(rows: Sightings) -> RangeStatistics:
    """Return the statistics of vehicles in view."""
    place = np.digitize(rows.range_m, RANGE_EDGES_M) - 1
    vehicle, length, middle_m = miss_runs(rows)
    run_place = np.digitize(middle_m, RANGE_EDGES_M) - 1
    return RangeStatistics(
        points=_share(rows.points, rows.vehicle_id, place),
        seen=_share(rows.points > 0, rows.vehicle_id, place),
        run=_share(length, vehicle, run_place),
        run_longer=tuple(_share(length > n, vehicle, run_place) for n in RUN_LONGER_THAN),
    )


def _share(value: I64 | Bool, vehicle_id: I64, place: I64) -> Share:
    bins = len(RANGE_EDGES_M) - 1
    ids, vehicle = np.unique(vehicle_id, return_inverse=True)
    cell = vehicle * bins + place
    total = np.bincount(cell, value, len(ids) * bins).reshape(len(ids), bins)
    count = np.bincount(cell, minlength=len(ids) * bins).reshape(len(ids), bins)
    with np.errstate(invalid="ignore", divide="ignore"):  # an empty bin has no mean
        mean = total.sum(axis=0) / count.sum(axis=0)
        error = np.sqrt(((total - mean * count) ** 2).sum(axis=0)) / count.sum(axis=0)
    return Share(mean, error, count.sum(axis=0))


def miss_runs(rows: Sightings) -> tuple[I64, I64, F64]:
    """Return vehicle, length [frames] and mean range of every run of consecutive frames without a point."""
    r = rows.take(np.lexsort((rows.frame, rows.vehicle_id)))
    missed = r.points == 0
    opens = missed.copy()
    goes_on = (r.vehicle_id[1:] == r.vehicle_id[:-1]) & (r.frame[1:] - r.frame[:-1] == 1)
    opens[1:] &= ~(missed[:-1] & goes_on)
    run = np.cumsum(opens)[missed] - 1
    length = np.bincount(run, minlength=int(opens.sum()))
    middle_m = np.bincount(run, r.range_m[missed], len(length)) / np.maximum(length, 1)
    return r.vehicle_id[opens], length, middle_m
