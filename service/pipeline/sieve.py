"""Turn what the log holds into records; what is damaged, or was set aside, stands there as such."""

from __future__ import annotations

from collections.abc import Iterable

import structlog

from service.errors import StorageError
from service.formats.columnar import points_digest
from service.pipeline.blame import DEATHS
from service.pipeline.codec import decode_record
from service.pipeline.records import DamagedRecord, FrameRecord, Record

_log = structlog.get_logger(__name__)


class Sieve:
    """Decodes records, and counts those that are left out."""

    def __init__(self) -> None:
        self.damaged_records = 0
        self._positions: dict[str, frozenset[int]] = {}
        self._digests: dict[str, frozenset[int]] = {}

    def set_aside(self, sensor_id: str, positions: Iterable[int], digests: Iterable[int]) -> None:
        """Take in which records of a sensor are not to be folded: a tracker died over them before.

        digests: of their frames, which may stand in the log once more.
        """
        self._positions[sensor_id] = frozenset(positions)
        self._digests[sensor_id] = frozenset(digests)

    def record(self, sensor_id: str, position: int, body: bytes) -> Record:
        """Return the record with these bytes."""
        if position in self._positions.get(sensor_id, ()):
            self.damaged_records += 1
            return DamagedRecord(
                f"the tracker's process ended or hung {DEATHS} times over this record", fatal=True
            )
        try:
            record = decode_record(body)
        except StorageError as error:
            self.damaged_records += 1
            _log.error("record damaged", sensor_id=sensor_id, position=position, error=str(error))
            return DamagedRecord(str(error))
        digests = self._digests.get(sensor_id)
        if digests and isinstance(record, FrameRecord) and points_digest(record.frame) in digests:
            self.damaged_records += 1
            return DamagedRecord("a frame with the same time and points was set aside before")
        return record
