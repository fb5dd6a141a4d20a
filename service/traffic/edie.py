"""Turn the sums of cells into Edie's measures: flow, density and speed of a piece of lane over a time.

In a region of area |A| = L T, with d(A) the distance driven and t(A) the time spent in it by all vehicles:
q = d(A) / |A|, k = t(A) / |A|, v = d(A) / t(A). So q = k v exactly.

Source: Edie, L. C., "Discussion of traffic stream measurements and definitions", 1963.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.tracking.model import F64, I64
from service.traffic.flow import Received, covered
from service.traffic.records import DECIMALS, MINUTE_US

_M_PER_KM = 1000.0
_S_PER_HOUR = 3600.0


@dataclass(frozen=True, slots=True)
class CellTable:
    """Sums of cells (N,) by minute; `table` is an array of traffic.cells.CELL."""

    minute: I64
    epoch: I64
    map_version: I64
    table: NDArray[np.void]


@dataclass(frozen=True, slots=True)
class EdieTable:
    """Measures of R cells and intervals, (R,) each, by time, epoch, map version, lane and cell."""

    start_us: I64
    end_us: I64
    epoch: I64
    map_version: I64
    lane: I64
    cell: I64
    length_m: F64
    distance_m: F64
    time_s: F64
    coverage: F64
    observed: F64
    flow_vph: F64
    density_per_km: F64
    speed_mps: F64  # NaN: nobody was there


def edie_table(cells: CellTable, received: Received, edges_us: I64) -> EdieTable:
    """Return the measures of every cell in which somebody drove, by interval between two edges.

    The area is the cell's length times the observed part of the interval: what nobody saw is not empty road.
    """
    coverage, observed = covered(received, edges_us)
    place = np.searchsorted(edges_us, cells.minute * MINUTE_US, side="right") - 1
    inside = (place >= 0) & (place < len(coverage))
    inside[inside] &= observed[place[inside]] > 0
    t = cells.table[inside]
    keys = np.stack(
        [place[inside], cells.epoch[inside], cells.map_version[inside], t["lane"], t["cell"]], axis=1
    ).astype(np.int64)
    unique, index = np.unique(keys, axis=0, return_inverse=True)
    index = index.reshape(-1)
    count = len(unique)
    distance_m = _summed(index, t["distance_m"], count)
    time_s = _summed(index, t["time_s"], count)
    length_m = np.zeros(count)
    length_m[index] = np.round(t["length_m"].astype(np.float64), DECIMALS)
    bins = unique[:, 0]
    seconds = (edges_us[bins + 1] - edges_us[bins]) / 1e6
    area = length_m * seconds * observed[bins]
    return EdieTable(
        start_us=edges_us[bins],
        end_us=edges_us[bins + 1],
        epoch=unique[:, 1],
        map_version=unique[:, 2],
        lane=unique[:, 3],
        cell=unique[:, 4],
        length_m=length_m,
        distance_m=distance_m,
        time_s=time_s,
        coverage=coverage[bins],
        observed=observed[bins],
        flow_vph=_S_PER_HOUR * distance_m / area,
        density_per_km=_M_PER_KM * time_s / area,
        speed_mps=np.divide(distance_m, time_s, out=np.full(count, np.nan), where=time_s > 0),
    )


def _summed(index: I64, column: NDArray[np.floating], count: int) -> F64:
    values = np.round(column.astype(np.float64), DECIMALS)
    return np.asarray(np.bincount(index, values, minlength=count), dtype=np.float64)
