"""Write the crossings and the traffic measures of tracked frames into files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import orjson

if TYPE_CHECKING:
    from collections.abc import Iterable

    from service.formats.sensor import SensorConfig
    from service.storage.rows import CellRow, CrossingBlock, MinuteRow, Rows

CROSSINGS, FLOW, CELLS = "crossings.jsonl", "flow.jsonl", "cells.jsonl"
COUNT_FILES = (CROSSINGS, FLOW, CELLS)


class CountFiles:
    """The newest rows of counts, gathered while frames are folded."""

    def __init__(self, config: SensorConfig) -> None:
        self._config = config
        self._blocks: dict[object, CrossingBlock] = {}
        self._minutes: dict[object, MinuteRow] = {}
        self._cells: dict[object, CellRow] = {}

    def add(self, rows: Rows) -> None:
        """Take over what one record led to."""
        self._blocks.update((row.key, row) for row in rows.crossings)
        self._minutes.update((row.key, row) for row in rows.minutes)
        self._cells.update((row.key, row) for row in rows.cells)

    def write(self, folder: Path) -> dict[str, object]:
        """Write a line for each crossing, for each minute, line, lane and direction, and for each cell."""
        from service.storage.count_tables import cells_of, crossings_of, received_of
        from service.traffic.count_intervals import Confidence
        from service.traffic.edie import edie_table
        from service.traffic.flow import flow_table
        from service.traffic.flow_fields import crossing_fields, edie_fields, flow_fields, groups_of
        from service.traffic.records import MINUTE_US

        sensor_id = self._config.sensor_id
        crossings = crossings_of(list(self._blocks.values()), self._config.length_bounds_m)
        received = received_of(list(self._minutes.values()))
        fields = crossing_fields(sensor_id, crossings)
        _write_lines(folder / CROSSINGS, ({**row, "x": row["x_m"], "y": row["y_m"]} for row in fields))
        edges = np.zeros(1, np.int64)
        if len(received.minute):
            edges = np.arange(received.minute[0], received.minute[-1] + 2) * MINUTE_US
        lines = [line.line_id for line in self._config.count_lines]
        groups = groups_of(crossings, lines, (), frozenset({"lane", "direction"}))
        confidence = Confidence(mount_height_m=self._config.mount_height_m)
        flow = flow_table(crossings, received, edges, groups, confidence)
        _write_lines(folder / FLOW, flow_fields(sensor_id, flow))
        edie = edie_table(cells_of(list(self._cells.values())), received, edges)
        _write_lines(folder / CELLS, edie_fields(sensor_id, edie))
        return {"crossings": len(crossings)}


def _write_lines(path: Path, rows: Iterable[dict[str, object]]) -> None:
    with path.open("wb") as lines:
        for row in rows:
            lines.write(orjson.dumps(row) + b"\n")
