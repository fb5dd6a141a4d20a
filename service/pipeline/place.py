"""Where a tracker process is just now: in memory that it shares with the service, so that its death tells.

A record that makes the fold raise an error is told by that error. One that ends the whole process (a fault
in compiled code, no memory left), or keeps it for ever, leaves only this: the sensor and position that were
being folded. Writing it takes less than a microsecond a record.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
from dataclasses import dataclass, field

_LAYOUT = struct.Struct("<QQQ")  # number of the sensor (0: none is folded), position, sign of life
_BYTES = mmap.PAGESIZE

DEATHS = 3  # over one record, before it is set aside
# Where so many records are set aside within so few, it is not they but the state of the tracker.
HOPELESS_RECORDS, HOPELESS_SPAN = 4, 1000


class Place:
    """The record that is being folded; written by the tracker process, read by the service."""

    def __init__(self, memory: mmap.mmap | bytearray) -> None:
        self._memory = memory
        self._life = 0

    def begin(self, number: int, position: int) -> None:
        """Take in that a record is folded from now on."""
        self._life += 1
        _LAYOUT.pack_into(self._memory, 0, number, position, self._life)

    def end(self) -> None:
        """Take in that it is folded; also a sign of life of other work."""
        self._life += 1
        _LAYOUT.pack_into(self._memory, 0, 0, 0, self._life)

    def read(self) -> tuple[int, int, int]:
        """Return number of the sensor (0: none is folded), position, and what changes with every step."""
        number, position, life = _LAYOUT.unpack_from(self._memory, 0)
        return number, position, life


def nowhere() -> Place:
    """Return a place that nobody else sees."""
    return Place(bytearray(_LAYOUT.size))


def open_place(descriptor: int) -> Place:
    """Return the place in the shared memory of this file."""
    return Place(mmap.mmap(descriptor, _BYTES))


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


@dataclass(slots=True)
class Blame:
    """The records of one sensor over which its process died."""

    position: int = 0  # of the last death
    deaths: int = 0  # there
    set_aside: list[int] = field(default_factory=list)  # positions, rising
    forgiven: int = 0  # of them, when somebody had the sensor tracked again

    def died_at(self, position: int) -> bool:
        """Take in a death; return whether the record at `position` is set aside by it."""
        self.deaths = self.deaths + 1 if position == self.position else 1
        self.position = position
        if self.deaths < DEATHS or position in self.set_aside:
            return False
        self.set_aside = sorted([*self.set_aside, position])
        return True

    def forgive(self) -> None:
        """Begin to count anew; what was set aside stays so."""
        self.position = self.deaths = 0
        self.forgiven = len(self.set_aside)

    @property
    def hopeless(self) -> bool:
        """Whether so many of the newest records were set aside that the sensor had better stop."""
        newest = self.set_aside[self.forgiven :][-HOPELESS_RECORDS:]
        return len(newest) == HOPELESS_RECORDS and newest[-1] - newest[0] < HOPELESS_SPAN


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
