"""The protocol of the durable log: the one seam that has two implementations (SQLite files, NATS)."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from typing import Protocol

from service.pipeline.records import Record


class FrameLog(Protocol):
    """An ordered, durable log for each sensor. Positions start at 1 and grow by one inside a sensor."""

    def append(self, sensor_id: str, records: Sequence[Record]) -> list[int]:
        """Write the records, wait until they are durable, and return their positions."""
        ...

    def append_later(self, sensor_id: str, records: Sequence[Record]) -> Future[list[int]]:
        """Do the same without waiting; the future gives the positions once the records are durable."""
        ...

    def read(self, sensor_id: str, after: int, limit: int) -> list[tuple[int, Record]]:
        """Return up to `limit` records with positions above `after`, in order.

        Raises Unavailable when they cannot be read for now, StorageError when they never can.
        """
        ...

    def last_position(self, sensor_id: str) -> int:
        """Return the newest position, 0 for an empty log."""
        ...

    def first_position(self, sensor_id: str) -> int:
        """Return the oldest position still kept, 0 for an empty log."""
        ...

    def reserve(self, sensor_id: str, position: int) -> None:
        """Put the sensor's next record behind `position`."""
        ...

    def release(self, sensor_id: str, position: int) -> None:
        """Allow the sensor's records up to `position` to be dropped when room is needed."""
        ...
