"""Turn rows of counts as the fold gives them out into the tables that measures are computed from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.storage.rows import CellRow, CrossingBlock, MinuteRow
from service.traffic.cells import CELL
from service.traffic.edie import CellTable
from service.traffic.flow import CrossingTable, Received, crossing_table
from service.traffic.records import CROSSING


def crossings_of(blocks: Sequence[CrossingBlock]) -> CrossingTable:
    """Return the crossings of some blocks by time."""
    counts = [len(block.records) // CROSSING.itemsize for block in blocks]
    return crossing_table(
        np.frombuffer(b"".join(block.records for block in blocks), CROSSING),
        np.repeat(np.array([block.minute for block in blocks], np.int64), counts),
        np.repeat(np.array([block.epoch for block in blocks], np.int64), counts),
        np.repeat(np.array([block.line_id for block in blocks], dtype=np.str_), counts),
    )


def received_of(minutes: Sequence[MinuteRow]) -> Received:
    """Return what came in each minute; of several epochs inside one minute the sum."""
    rows = sorted((row.minute, row.frames, row.expected, row.observed_us) for row in minutes)
    table = np.array(rows, np.int64).reshape(-1, 4)
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
