"""Where a tracker process is just now: in memory that it shares with the service, so that its death tells.

A record that makes the fold raise an error is told by that error. One that ends the whole process (a fault
in compiled code, no memory left), or keeps it for ever, leaves only this: the sensor and position that were
being folded. Writing it takes less than a microsecond a record, and three where it is kept in a file too, for
the case that the service is killed with it.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile

from service.pipeline.blame import PlaceFile

_LAYOUT = struct.Struct("<QQQ")  # number of the sensor (0: none is folded), position, sign of life
_BYTES = mmap.PAGESIZE


class Place:
    """The record that is being folded; written by the tracker process, read by the service."""

    def __init__(self, memory: mmap.mmap | bytearray, file: PlaceFile | None = None) -> None:
        self._memory = memory
        self._file = file
        self._life = 0

    def begin(self, number: int, position: int) -> None:
        """Take in that a record is folded from now on."""
        self._life += 1
        _LAYOUT.pack_into(self._memory, 0, number, position, self._life)
        if self._file is not None:
            self._file.write(number, position)

    def end(self) -> None:
        """Take in that it is folded; also a sign of life of other work."""
        self._life += 1
        _LAYOUT.pack_into(self._memory, 0, 0, 0, self._life)
        if self._file is not None:
            self._file.write(0, 0)

    def read(self) -> tuple[int, int, int]:
        """Return number of the sensor (0: none is folded), position, and what changes with every step."""
        number, position, life = _LAYOUT.unpack_from(self._memory, 0)
        return number, position, life


def nowhere(file: PlaceFile | None = None) -> Place:
    """Return a place that no other process sees, but for the file."""
    return Place(bytearray(_LAYOUT.size), file)


def open_place(descriptor: int, file: PlaceFile | None = None) -> Place:
    """Return the place in the shared memory of this file descriptor."""
    return Place(mmap.mmap(descriptor, _BYTES), file)


def shared_memory() -> int:
    """Return the descriptor of memory that processes can share: a file that has no name."""
    create = getattr(os, "memfd_create", None)  # Linux only
    if create is not None:
        descriptor: int = create("wayside-place")
    else:
        with tempfile.TemporaryFile() as file:
            descriptor = os.dup(file.fileno())
    os.ftruncate(descriptor, _BYTES)
    return descriptor


class Stall:
    """Tells when a process has given no sign of life for too long."""

    def __init__(self, place: Place, patience_s: float, now_s: float) -> None:
        self._place = place
        self._patience_s = patience_s
        self._seen = place.read()
        self._since_s = now_s

    def over(self, now_s: float, *, heard: bool) -> bool:
        """Return whether the patience is over, once each time; `heard`: a message came from the process."""
        seen = self._place.read()
        if heard or seen != self._seen:
            self._seen, self._since_s = seen, now_s
        if now_s - self._since_s < self._patience_s:
            return False
        self._since_s = now_s
        return True
