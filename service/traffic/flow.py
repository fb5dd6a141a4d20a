"""Turn crossings into traffic measures by interval, line, lane, direction and length class.

Definitions: FHWA Traffic Data Computation Method Pocket Guide, FHWA-PL-18-027. With N vehicles in an interval
of T seconds, spot speeds v_i and lengths l_i, and a virtual detector of length d:

    flow rate q = 3600 N / T        time-mean speed = sum v_i / N      space-mean speed = N / sum(1 / v_i)
    density k = q / space-mean      occupancy = 100 / T sum((l_i + d) / v_i)
    headway: front bumper to front bumper     gap: rear bumper of the leader to front bumper
    p85: the 85th percentile of one speed per vehicle, by linear interpolation
    peak-hour factor = hourly volume / (4 x its largest 15-minute volume)

Space-mean speed is never above time-mean speed. `null` (NaN here) is "not observed", 0 "observed none".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.formats.length_class import LENGTH_CLASSES
from service.tracking.model import F64, I64, Bool
from service.traffic.count_intervals import Confidence, Counted, volume_bounds
from service.traffic.records import DECIMALS, MINUTE_US

Text = NDArray[np.str_]

DEFINITIONS = "wayside-flow-1"  # the set of definitions above, named in every row
VIRTUAL_LENGTH_M = 2.0  # of the detector whose occupancy is told: a common loop
SPEED_BIN_MPS = 2.5  # 9 km/h
SPEED_BINS = 24  # the last one open
LOW_SAMPLE = 20  # vehicles, below which an 85th percentile is flagged
ASSUMED_LENGTH_M = 4.5
_S_PER_HOUR = 3600.0
_P85 = 0.85
_WHOLE = ("number", "lane", "direction", "track", "vehicle", "frame", "map_version")
_REAL = ("x_m", "y_m", "speed_mps", "length_m", "headway_s", "gap_s", "probability")


@dataclass(frozen=True, slots=True)
class CrossingTable:
    """Crossings as columns (N,), by time."""

    time_us: I64
    epoch: I64
    number: I64
    line_id: Text
    lane: I64
    direction: I64
    track: I64
    vehicle: I64
    frame: I64
    map_version: I64
    x_m: F64
    y_m: F64
    speed_mps: F64
    length_m: F64
    length_class: I64  # an index of LENGTH_CLASSES, -1 where the length is not known
    headway_s: F64
    gap_s: F64
    probability: F64

    def __len__(self) -> int:
        return len(self.time_us)

    def take(self, index: I64 | Bool | list[int]) -> CrossingTable:
        """Return the crossings at `index` (integers or a mask)."""
        return CrossingTable(*(getattr(self, item.name)[index] for item in fields(self)))

    def between(self, start_us: int, end_us: int) -> CrossingTable:
        """Return the crossings in [start_us, end_us)."""
        return self.take((self.time_us >= start_us) & (self.time_us < end_us))


def crossing_table(
    records: NDArray[np.void], minute: I64, epoch: I64, line_id: Text, length_bounds_m: Sequence[float]
) -> CrossingTable:
    """Return records of CROSSING with their minute, epoch and line (N,) as a table by time."""
    columns: dict[str, Any] = {name: records[name].astype(np.int64) for name in _WHOLE}
    columns |= {name: np.round(records[name].astype(np.float64), DECIMALS) for name in _REAL}
    time_us = minute * MINUTE_US + records["time_us"]
    longer = np.searchsorted(np.array(length_bounds_m), columns["length_m"], side="right")
    columns["length_class"] = np.where(np.isnan(columns["length_m"]), -1, longer)
    table = CrossingTable(time_us=time_us, epoch=epoch, line_id=line_id, **columns)
    return table.take(np.lexsort((table.number, epoch, time_us)))


@dataclass(frozen=True, slots=True)
class Received:
    """The minutes (M,) of which anything came, ascending, and how much."""

    minute: I64
    frames: I64
    expected: I64
    observed_us: I64


@dataclass(frozen=True, slots=True)
class Group:
    """One line with lane and direction, and length class where classes are told apart."""

    line_id: str
    lane: int | None  # None: all lanes; 0: no lane
    direction: int | None  # None: both
    length_class: str | None  # None: all

    def holds(self, crossings: CrossingTable) -> Bool:
        """Return which crossings (N,) belong to the group."""
        mine = crossings.line_id == self.line_id
        if self.lane is not None:
            mine &= crossings.lane == self.lane
        if self.direction is not None:
            mine &= crossings.direction == self.direction
        if self.length_class is not None:
            mine &= crossings.length_class == LENGTH_CLASSES.index(self.length_class)
        return np.asarray(mine)


@dataclass(frozen=True, slots=True)
class FlowTable:
    """Measures of G groups in B intervals, (B x G,) each, by interval and then by group."""

    start_us: I64
    end_us: I64
    group: I64  # index into `groups`
    groups: tuple[Group, ...]
    coverage: F64  # frames received of those expected
    observed: F64  # share of the time in which frames came
    n: I64
    volume_low: I64
    volume_high: I64
    flow_vph: F64
    time_mean_speed_mps: F64
    space_mean_speed_mps: F64
    p85_speed_mps: F64
    occupancy_percent: F64
    density_per_km: F64
    mean_length_m: F64
    mean_headway_s: F64
    mean_gap_s: F64
    peak_hour_factor: F64
    histogram: I64  # (B x G, SPEED_BINS)
    lengths_known: I64  # vehicles whose length is known


def flow_table(
    crossings: CrossingTable,
    received: Received,
    edges_us: I64,
    groups: Sequence[Group],
    confidence: Confidence | None = None,
) -> FlowTable:
    """Return the measures of each group in each interval between two edges in which anything was received.

    edges_us: (B + 1,) whole minutes, ascending.
    """
    coverage, observed = covered(received, edges_us)
    bins = np.flatnonzero(coverage > 0)
    row = np.full(len(edges_us) - 1, -1)
    row[bins] = np.arange(len(bins))
    place = np.searchsorted(edges_us, crossings.time_us, side="right") - 1
    inside = (place >= 0) & (place < len(row))
    inside[inside] &= row[place[inside]] >= 0
    parts = [np.flatnonzero(group.holds(crossings) & inside) for group in groups]
    index = np.concatenate([*parts, np.zeros(0, np.int64)]).astype(np.int64)
    of_group = np.repeat(np.arange(len(groups)), [len(part) for part in parts])
    cell = row[place[index]] * len(groups) + of_group
    order = np.argsort(cell, kind="stable")
    chosen, cell = crossings.take(index[order]), cell[order]
    starts, ends = edges_us[:-1][bins], edges_us[1:][bins]
    spread = np.stack([starts, ends, coverage[bins], observed[bins]]).repeat(len(groups), axis=1)
    return _measured(chosen, cell, spread, tuple(groups), confidence or Confidence())


def covered(received: Received, edges_us: I64) -> tuple[F64, F64]:
    """Return for each interval (B,) the share of frames received and of time observed, 0 to 1."""
    place = np.searchsorted(edges_us, received.minute * MINUTE_US, side="right") - 1
    inside = (place >= 0) & (place < len(edges_us) - 1)
    minutes = np.diff(edges_us) / MINUTE_US
    count = len(minutes)
    frames = np.bincount(place[inside], received.frames[inside], minlength=count)
    expected = np.bincount(place[inside], received.expected[inside], minlength=count)
    known = np.bincount(place[inside], minlength=count)
    observed_us = np.bincount(place[inside], received.observed_us[inside], minlength=count)
    rate = expected / np.maximum(known, 1)  # frames a minute; minutes without input lack all of theirs
    coverage = np.divide(frames, rate * minutes, out=np.zeros(count), where=rate > 0)
    return np.minimum(coverage, 1.0), np.minimum(observed_us / (minutes * MINUTE_US), 1.0)


def _measured(
    c: CrossingTable, cell: I64, spread: F64, groups: tuple[Group, ...], confidence: Confidence
) -> FlowTable:
    start_us, end_us, coverage, observed = spread
    count = len(start_us)
    n = np.bincount(cell, minlength=count)
    seconds = (end_us - start_us) / 1e6
    flow_vph = _S_PER_HOUR * n / seconds
    space_mean = _ratio(n, _sum(cell, 1.0 / c.speed_mps, count))
    length_m = np.where(np.isnan(c.length_m), ASSUMED_LENGTH_M, c.length_m)
    known = np.bincount(cell, ~np.isnan(c.length_m), minlength=count)
    doubt = _sum(cell, 1.0 - c.probability, count)
    density = np.where(n > 0, flow_vph / (3.6 * np.where(n > 0, space_mean, 1.0)), 0.0)
    range_m = np.nan_to_num(_ratio(_sum(cell, np.hypot(c.x_m, c.y_m), count), n))
    lanes = _lanes(c, cell, count)
    headways, spread = _headway_spread(c, cell, count)
    counted = Counted(n, doubt, observed, density / lanes / 1e3, range_m, headways, spread)
    low, high = volume_bounds(counted, confidence)
    return FlowTable(
        start_us=start_us.astype(np.int64),
        end_us=end_us.astype(np.int64),
        group=np.tile(np.arange(len(groups)), count // max(len(groups), 1)),
        groups=groups,
        coverage=coverage,
        observed=observed,
        n=n,
        volume_low=low,
        volume_high=high,
        flow_vph=flow_vph,
        time_mean_speed_mps=_ratio(_sum(cell, c.speed_mps, count), n),
        space_mean_speed_mps=np.minimum(space_mean, _ratio(_sum(cell, c.speed_mps, count), n)),
        p85_speed_mps=percentile(c.speed_mps, cell, count, _P85),
        occupancy_percent=100.0 / seconds * _sum(cell, (length_m + VIRTUAL_LENGTH_M) / c.speed_mps, count),
        density_per_km=density,
        mean_length_m=_mean(cell, c.length_m, count),
        mean_headway_s=_mean(cell, c.headway_s, count),
        mean_gap_s=_mean(cell, c.gap_s, count),
        peak_hour_factor=_peak_hour_factor(c, cell, start_us, end_us, n),
        histogram=_histogram(c.speed_mps, cell, count),
        lengths_known=known.astype(np.int64),
    )


def _lanes(c: CrossingTable, cell: I64, count: int) -> I64:
    """Return in how many lanes the vehicles of each cell drove, at least one."""
    most = int(c.lane.max(initial=0)) + 1
    pairs = np.unique(cell * most + c.lane)
    return np.maximum(np.bincount(pairs // most, minlength=count), 1)


def _headway_spread(c: CrossingTable, cell: I64, count: int) -> tuple[I64, F64]:
    """Return how many headways of each cell are known, and their squared deviations in means."""
    known = ~np.isnan(c.headway_s)
    headway_s, cell = c.headway_s[known], cell[known]
    number = np.bincount(cell, minlength=count)
    mean = _ratio(_sum(cell, headway_s, count), number)
    deviation = headway_s / np.maximum(mean[cell], 1e-3) - 1.0
    return number, _sum(cell, deviation**2, count)


def _sum(cell: I64, values: F64, count: int) -> F64:
    return np.asarray(np.bincount(cell, values, minlength=count), dtype=np.float64)


def _ratio(above: F64 | I64, below: F64 | I64) -> F64:
    return np.asarray(np.divide(above, below, out=np.full(len(below), np.nan), where=below > 0))


def _mean(cell: I64, values: F64, count: int) -> F64:
    """Return the mean of the known values of each cell."""
    known = ~np.isnan(values)
    return _ratio(_sum(cell[known], values[known], count), np.bincount(cell[known], minlength=count))


def percentile(values: F64, cell: I64, count: int, share: float) -> F64:
    """Return the percentile of each cell by linear interpolation between order statistics, NaN when empty."""
    if not len(values):
        return np.full(count, np.nan)
    low, high = float(values.min()), float(values.max())
    order = np.argsort(cell + (values - low) / (2.0 * (high - low) + 1.0))  # by cell, and by value inside it
    ranked = values[order]
    n = np.bincount(cell, minlength=count)
    first = np.cumsum(n) - n
    place = share * (n - 1)
    below = np.floor(place).astype(np.int64)
    out = np.full(count, np.nan)
    some = n > 0
    a = ranked[first[some] + below[some]]
    b = ranked[first[some] + np.minimum(below[some] + 1, n[some] - 1)]
    out[some] = a + (place[some] - below[some]) * (b - a)
    return out


def _histogram(speed_mps: F64, cell: I64, count: int) -> I64:
    place = np.minimum((speed_mps / SPEED_BIN_MPS).astype(np.int64), SPEED_BINS - 1)
    flat = np.bincount(cell * SPEED_BINS + place, minlength=count * SPEED_BINS)
    return flat.reshape(count, SPEED_BINS)


def _peak_hour_factor(c: CrossingTable, cell: I64, start_us: F64, end_us: F64, n: I64) -> F64:
    """Return the factor of the intervals that last an hour, NaN for others and where nobody came."""
    quarter = np.minimum((c.time_us - start_us[cell]) // (15 * MINUTE_US), 3).astype(np.int64)
    hour = (end_us - start_us == 60 * MINUTE_US) & (n > 0)
    fours = np.bincount(cell * 4 + quarter * hour[cell], minlength=4 * len(start_us)).reshape(-1, 4)
    return np.where(hour, n / np.maximum(4 * fours.max(axis=1, initial=0), 1), np.nan)
