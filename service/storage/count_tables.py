"""Turn rows of counts as the fold gives them out into the tables that measures are computed from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.storage.rows import CellRow, CrossingBlock, MinuteRow
from service.traffic.cells import CELL
from service.traffic.edie import CellTable
from service.traffic.flow import CrossingTable, Received, crossing_table
from service.traffic.records import CROSSING

CrossingRow = tuple[int, str, int, bytes]


def crossings_of(blocks: Sequence[CrossingBlock], length_bounds_m: Sequence[float]) -> CrossingTable:
    """Return the crossings of some blocks by time."""
    rows = [(block.epoch, block.line_id, block.minute, block.records) for block in blocks]
    return crossings_of_rows(rows, length_bounds_m)


def crossings_of_rows(rows: Sequence[CrossingRow], length_bounds_m: Sequence[float]) -> CrossingTable:
    """Return the crossings of epoch, line, minute and records of some blocks by time."""
    epoch, line_id, minute, records = zip(*rows, strict=True) if rows else ((), (), (), ())
    counts = [len(part) // CROSSING.itemsize for part in records]
    return crossing_table(
        np.frombuffer(b"".join(records), CROSSING),
        np.repeat(np.array(minute, np.int64), counts),
        np.repeat(np.array(epoch, np.int64), counts),
        np.repeat(np.array(line_id, dtype=np.str_), counts),
        length_bounds_m,
    )


def received_of(minutes: Sequence[MinuteRow]) -> Received:
    """Return what came in each minute; of several epochs inside one minute the sum."""
    return received_of_rows([(row.minute, row.frames, row.expected, row.observed_us) for row in minutes])


def received_of_rows(rows: Sequence[tuple[int, int, int, int]]) -> Received:
    """Return the same of minute, frames, frames expected and microseconds observed."""
    table = np.array(sorted(rows), np.int64).reshape(-1, 4)
    minute, first = np.unique(table[:, 0], return_index=True)
    if not len(minute):
        return Received(*table.T)
    return Received(
        minute,
        np.add.reduceat(table[:, 1], first),
        np.maximum.reduceat(table[:, 2], first),
        np.add.reduceat(table[:, 3], first),
    )


def cells_of(rows: Sequence[CellRow]) -> CellTable:
    """Return Edie's sums of some minutes."""
    counts = [len(row.cells) // CELL.itemsize for row in rows]
    heads = np.array([(row.minute, row.epoch, row.map_version) for row in rows], np.int64).reshape(-1, 3)
    minute, epoch, version = heads.repeat(counts, axis=0).T
    return CellTable(minute, epoch, version, np.frombuffer(b"".join(row.cells for row in rows), CELL))
