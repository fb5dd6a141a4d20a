"""From echoes to detections: those that share a resolution cell merge, only strong cells are reported."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, I64, Bool

FALSE_ALARM, GHOST, CLUTTER = -1, -2, 0  # sources of detections that are no vehicle's


@dataclass(frozen=True, slots=True)
class Echoes:
    """N echoes or merged echoes; `power` is linear over the noise of one cell."""

    range_m: F64
    azimuth_rad: F64
    radial_velocity_mps: F64
    power: F64
    source: I64  # vehicle id, CLUTTER, FALSE_ALARM or GHOST

    def __len__(self) -> int:
        return len(self.range_m)

    def take(self, index: I64 | Bool) -> Echoes:
        """Return the echoes that an index or a mask picks."""
        return Echoes(
            self.range_m[index],
            self.azimuth_rad[index],
            self.radial_velocity_mps[index],
            self.power[index],
            self.source[index],
        )

    @property
    def snr_db(self) -> F64:
        """Return the power in decibels."""
        return 10 * np.log10(self.power)


@dataclass(frozen=True, slots=True)
class Resolution:
    """Widths of the cells, and how far below the strongest echo of its range-Doppler cell one is lost."""

    range_m: float
    velocity_mps: float
    azimuth_rad: float
    sidelobe: float  # linear power


def merge_cells(echoes: Echoes, cell: Resolution) -> Echoes:
    """Return one echo for each resolved group, at the power-weighted mean of its members.

    Range and Doppler cells are those of the two FFTs; inside one, sorted by azimuth, a group begins where the
    first echo of the last group is one azimuth resolution away. The source is that of the strongest member.
    Groups under the side lobes of their range-Doppler cell are dropped.
    """
    if not len(echoes):
        return echoes
    range_bin = np.floor(echoes.range_m / cell.range_m)
    velocity_bin = np.rint(echoes.radial_velocity_mps / cell.velocity_mps)
    order = np.lexsort((echoes.azimuth_rad, velocity_bin, range_bin))
    e, range_bin, velocity_bin = echoes.take(order), range_bin[order], velocity_bin[order]
    opens_cell = np.ones(len(e), dtype=np.bool_)
    opens_cell[1:] = (range_bin[1:] != range_bin[:-1]) | (velocity_bin[1:] != velocity_bin[:-1])
    start = _group_starts(opens_cell, e.azimuth_rad, cell.azimuth_rad)
    power = np.add.reduceat(e.power, start)

    def mean(column: F64) -> F64:
        return np.asarray(np.add.reduceat(e.power * column, start) / power)

    group = np.repeat(np.arange(len(start)), np.diff(np.append(start, len(e))))
    by_power = np.lexsort((e.power, group))
    strongest = by_power[np.append(start[1:], len(e)) - 1]
    merged = Echoes(
        mean(e.range_m), mean(e.azimuth_rad), mean(e.radial_velocity_mps), power, e.source[strongest]
    )
    cell_start = np.flatnonzero(opens_cell[start])
    peak = np.maximum.reduceat(power, cell_start)
    cell_of_group = np.cumsum(opens_cell[start]) - 1
    return merged.take(power > cell.sidelobe * peak[cell_of_group])


def _group_starts(opens_cell: Bool, azimuth_rad: F64, width_rad: float) -> I64:
    """Return the index of the first echo of each group in the sorted echoes."""
    apart = 4 * np.pi  # more than any two azimuths differ
    place = (np.cumsum(opens_cell) - 1) * apart + azimuth_rad
    following = np.searchsorted(place, place + width_rad, side="left").tolist()
    cell_end = np.append(np.flatnonzero(opens_cell)[1:], len(place))
    end = cell_end[np.cumsum(opens_cell) - 1].tolist()
    starts, k = [], 0
    while k < len(place):
        starts.append(k)
        k = max(min(following[k], end[k]), k + 1)
    return np.array(starts, dtype=np.int64)


def detection_probability(snr_db: F64, *, threshold_db: float, slope_db: float, most: float) -> F64:
    """Return the chance that a cell is reported: logistic in SNR about the threshold."""
    return most / (1 + np.exp(-(snr_db - threshold_db) / slope_db))
