"""Turn recorded frames into frames that happen now: shifted times, a new boot, and when each is due.

Frames stay as they are in the file (row-wise or columnar, in the sensor's own conventions); only their
identity changes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import orjson

from service.errors import InvalidInput
from service.formats.json_lines import numbered_lines
from service.formats.rfc3339 import format_time_exact, parse_time_us

SECOND_US = 1_000_000


@dataclass(frozen=True, slots=True)
class Recording:
    """JSON lines files of one sensor, looked through once."""

    paths: tuple[Path, ...]
    sensor_id: str | None  # as the first frame says
    frames: int
    first_us: int
    last_us: int

    @property
    def duration_us(self) -> int:
        """Time from the first frame to the last."""
        return self.last_us - self.first_us

    def shift_us(self, now_us: int, speed: float) -> int:
        """Return what to add to each time so that a replay begun now is never ahead of the clock.

        At speed 1 the first frame happens now; faster, the last one happens when it is sent.
        """
        return now_us + round(self.duration_us / speed) - self.last_us

    def due_s(self, time_us: int, speed: float) -> float:
        """Return when a frame is to be sent, in seconds after the start."""
        return (time_us - self.first_us) / SECOND_US / speed


@dataclass(frozen=True, slots=True)
class RecordedFrame:
    """One line of a recording."""

    time_us: int
    content: dict[str, object]

    def moved(self, shift_us: int, boot_id: str) -> dict[str, object]:
        """Return the frame at a later time and of another boot."""
        timestamp = format_time_exact(self.time_us + shift_us)
        return self.content | {"timestamp": timestamp, "boot_id": boot_id}


def look_through(paths: Sequence[Path]) -> Recording:
    """Return what a replay must know beforehand; raises InvalidInput naming file and line."""
    sensor_id: str | None = None
    count = first_us = last_us = 0
    for frame in read_recording(paths):
        if count == 0:
            first_us = frame.time_us
            named = frame.content.get("sensor_id")
            sensor_id = named if isinstance(named, str) else None
        count += 1
        last_us = max(last_us, frame.time_us)
    if count == 0:
        raise InvalidInput(f"there are no frames in {', '.join(map(str, paths))}")
    return Recording(tuple(paths), sensor_id, count, first_us, last_us)


def read_recording(paths: Sequence[Path]) -> Iterator[RecordedFrame]:
    """Yield the frames of JSON lines files, gzip or not; raises InvalidInput naming file and line."""
    for path in paths:
        for number, line in numbered_lines(path):
            yield _frame(line, f"{path}, line {number}")


def count_lines(paths: Sequence[Path]) -> int:
    """Return the number of lines that are not blank, for the length of a progress bar."""
    return sum(1 for path in paths for _ in numbered_lines(path))


def _frame(line: bytes, place: str) -> RecordedFrame:
    try:
        content = orjson.loads(line)
    except orjson.JSONDecodeError as error:
        raise InvalidInput(f"{place}: is not JSON: {error}") from None
    timestamp = content.get("timestamp") if isinstance(content, dict) else None
    if not isinstance(timestamp, str):
        raise InvalidInput(f"{place}: want a frame with a timestamp")
    try:
        return RecordedFrame(parse_time_us(timestamp), content)
    except ValueError as error:
        raise InvalidInput(f"{place}: {error}") from None
