"""The door of the host: what a caller hears of posted frames, and how they get into the log."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from service.errors import WaysideError
from service.formats.columnar import digest_of, encode_frame, points_digest
from service.pipeline.channel import Doorway
from service.pipeline.order import Fate, OrderState, admit
from service.pipeline.records import FrameRecord
from service.pipeline.sqlite_log import SqliteLog
from service.telemetry import Telemetry
from service.tracking.model import Frame

_US_PER_S = 1_000_000


class Outcome(StrEnum):
    """What the caller hears of a posted frame; the fold decides by log order."""

    ACCEPTED = "accepted"
    DUPLICATE = "duplicate"
    LATE = "late"
    CONFLICT = "conflict"
    REJECTED = "rejected"


@dataclass(frozen=True, slots=True)
class ItemResult:
    """What became of one posted frame."""

    outcome: Outcome
    reason: str | None = None
    pointer: str = ""  # to what is wrong in a rejected frame


@dataclass(frozen=True, slots=True)
class _Sorted:
    """A submission at the door: what to say of each frame, what to log, and the order after it."""

    results: list[ItemResult]
    records: list[FrameRecord]
    order: OrderState


class Door:
    """Lets frames of any sensor into the log."""

    def __init__(self, frame_log: SqliteLog, telemetry: Telemetry, ahead_limit_s: float) -> None:
        self._frame_log = frame_log
        self._telemetry = telemetry
        self._ahead_limit_s = ahead_limit_s
        self._durable = telemetry.stage.labels("logged")

    async def submit(self, doorway: Doorway, frames: Sequence[Frame], received_us: int) -> list[ItemResult]:
        """Log frames of a sensor and return, once they are durable, what became of each.

        Raises Unavailable when the log or the disk is full.
        """
        started_s = time.perf_counter()
        found = self._sort(doorway, frames, received_us)
        if not found.records:
            return found.results
        doorway.door, failures = found.order, doorway.door_failures
        try:
            positions = await self._frame_log.append_async(doorway.sensor_id, found.records)
        except WaysideError:
            # The frames will come again: they must not be taken for repeats then.
            doorway.door = doorway.durable_door
            doorway.door_failures += 1
            raise
        if doorway.door_failures == failures:
            doorway.durable_door = found.order
        else:
            # Earlier frames that the log refused stand in `found.order`: they must not.
            doorway.durable_door = _passed(doorway.durable_door, found.records)
            doorway.door = _passed(doorway.door, found.records)
        doorway.expect(positions[-1], received_us, (record.frame for record in found.records))
        self._durable.observe(time.perf_counter() - started_s)
        return found.results

    def count_rejected(self, sensor_id: str, count: int) -> None:
        """Count frames that could not be read."""
        self._telemetry.frames.labels(sensor_id, Outcome.REJECTED.value).inc(count)

    def _sort(self, doorway: Doorway, frames: Sequence[Frame], received_us: int) -> _Sorted:
        results: list[ItemResult] = []
        records: list[FrameRecord] = []
        order, newest_us = doorway.door, None
        for frame in frames:
            refusal = self._refusal(doorway, frame, received_us)
            if refusal is not None:
                results.append(refusal)
                newest_us = frame.time_us
                continue
            encoded = encode_frame(frame)
            order, admission = admit(order, frame, digest_of(encoded))
            result = _result(admission.fate, frame)
            results.append(result)
            records.append(FrameRecord(frame, received_us, encoded))
            if result.outcome is Outcome.ACCEPTED:
                newest_us = frame.time_us
        if newest_us is not None:
            doorway.clock.observe(newest_us, received_us)
        if len(records) < len(frames):
            self.count_rejected(doorway.sensor_id, len(frames) - len(records))
        return _Sorted(results, records, order)

    def _refusal(self, doorway: Doorway, frame: Frame, received_us: int) -> ItemResult | None:
        if frame.sensor_id != doorway.sensor_id:
            reason = f"the frame is of {frame.sensor_id}, not of {doorway.sensor_id}"
            return ItemResult(Outcome.REJECTED, reason, "/sensor_id")
        if doorway.set_aside and points_digest(frame) in doorway.set_aside:
            reason = "the tracker ended over this frame again and again; it was set aside for good"
            return ItemResult(Outcome.REJECTED, reason, "")
        ahead_s = (frame.time_us - received_us) / _US_PER_S
        if ahead_s > self._ahead_limit_s:
            reason = f"its time is {ahead_s:.0f} s ahead of the host's, at most {self._ahead_limit_s:.0f} s"
            return ItemResult(Outcome.REJECTED, reason, "/timestamp")
        return None


def _passed(order: OrderState, records: Sequence[FrameRecord]) -> OrderState:
    for record in records:
        order, _ = admit(order, record.frame)
    return order


def _result(fate: Fate, frame: Frame) -> ItemResult:
    name = f"at {frame.time_us} us" if frame.sequence is None else str(frame.sequence)
    match fate:
        case Fate.DUPLICATE:
            return ItemResult(Outcome.DUPLICATE)
        case Fate.LATE:
            return ItemResult(
                Outcome.LATE, f"frame {name} came after later ones were tracked; it is kept, not tracked"
            )
        case Fate.CONFLICT:
            return ItemResult(Outcome.CONFLICT, f"frame {name} came before with another content")
        case _:
            return ItemResult(Outcome.ACCEPTED)
