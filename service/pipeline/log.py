"""The protocol of the durable log: the one seam that has two implementations (SQLite files, NATS)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from service.pipeline.records import Record


class FrameLog(Protocol):
    """An ordered, durable log for each sensor. Positions start at 1 and grow by one inside a sensor."""

    def append(self, sensor_id: str, records: Sequence[Record]) -> list[int]:
        """Write the records, wait until they are durable, and return their positions."""
        ...

    def read(self, sensor_id: str, after: int, limit: int) -> list[tuple[int, Record]]:
        """Return up to `limit` records with positions above `after`, in order."""
        ...

    def last_position(self, sensor_id: str) -> int:
        """Return the newest position, 0 for an empty log."""
        ...

    def first_position(self, sensor_id: str) -> int:
        """Return the oldest position still kept, 0 for an empty log."""
        ...
