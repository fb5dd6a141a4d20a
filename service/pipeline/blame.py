"""The deaths of trackers, by the record that was being folded, and the records that were set aside for them.

Kept in a file beside the log, so that neither a service that is killed together with its trackers nor one
that tracks in a thread of its own can meet the same record for ever. Rarely written: at each death.
"""

from __future__ import annotations

import json
import os
import struct
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

import structlog

DEATHS = 3  # over one record, before it is set aside
# Where so many records are set aside within so few, it is not they but the state of the tracker.
HOPELESS_RECORDS, HOPELESS_SPAN = 4, 1000
REMEMBERED = 64  # records of a sensor that were set aside; older ones a snapshot has long passed

_FILE = "set_aside.json"
_PLACE = struct.Struct("<QQ")  # number of the sensor (0: none is folded), position

_log = structlog.get_logger(__name__)


@dataclass(slots=True)
class Blame:
    """The records of one sensor over which its process died."""

    position: int = 0  # of the last death
    deaths: int = 0  # there
    set_aside: list[int] = field(default_factory=list)  # positions, rising
    digests: list[int] = field(default_factory=list)  # of the frames there (formats.columnar.points_digest)
    forgiven: int = 0  # the position up to which they do not speak against the state any more

    def died_at(self, position: int) -> bool:
        """Take in a death; return whether the record at `position` is set aside by it."""
        self.deaths = self.deaths + 1 if position == self.position else 1
        self.position = position
        if self.deaths < DEATHS or position in self.set_aside:
            return False
        self.set_aside = sorted([*self.set_aside, position])[-REMEMBERED:]
        return True

    def forgive(self) -> None:
        """Begin to count anew; what was set aside stays so."""
        self.position = self.deaths = 0
        self.forgiven = max(self.set_aside, default=0)

    @property
    def hopeless(self) -> bool:
        """Whether so many of the newest records were set aside that the sensor had better stop."""
        newest = [position for position in self.set_aside if position > self.forgiven][-HOPELESS_RECORDS:]
        return len(newest) == HOPELESS_RECORDS and newest[-1] - newest[0] < HOPELESS_SPAN

    @property
    def failure(self) -> str | None:
        """Why the sensor is not tracked any more, None when it is."""
        return (
            f"the tracker's process ends at every record, last at {self.position}" if self.hopeless else None
        )


class BlameBook:
    """The blames of all sensors; from any thread."""

    def __init__(
        self,
        folder: Path,
        digest_at: Callable[[str, int], int | None],
        on_set_aside: Callable[[str], None],
    ) -> None:
        """Read the folder's file.

        digest_at: returns what names the frame of a sensor at a position of the log, None where there is
        none.  on_set_aside: hears of each sensor of which one more record is set aside.
        """
        self._folder = folder
        self._digest_at = digest_at
        self._on_set_aside = on_set_aside
        self._guard = threading.Lock()
        self._blames = self._load()

    def of(self, sensor_id: str) -> Blame:
        """Return the blame of a sensor as it is now."""
        return self._blames.get(sensor_id, Blame())

    def died_at(self, sensor_id: str, position: int) -> bool:
        """Take in, durably, a death over a record; return whether the record is set aside by it."""
        with self._guard:
            blame = self._blames.setdefault(sensor_id, Blame())
            set_aside = blame.died_at(position)
            if set_aside:
                digest = self._digest_at(sensor_id, position)
                blame.digests = (blame.digests if digest is None else [*blame.digests, digest])[-REMEMBERED:]
            self._save()
        if set_aside:
            _log.error("record set aside", sensor_id=sensor_id, position=position)
            self._on_set_aside(sensor_id)
        return set_aside

    def forgive(self, sensor_id: str) -> None:
        """Let a sensor be tracked again whatever was set aside so far."""
        with self._guard:
            if sensor_id in self._blames:
                self._blames[sensor_id].forgive()
                self._save()

    def forget(self, sensor_id: str) -> None:
        """Let go of a sensor that was purged."""
        with self._guard:
            if self._blames.pop(sensor_id, None) is not None:
                self._save()

    # ------------------------------------------------------------- the places at which trackers died

    def place_path(self, index: int) -> Path:
        """Return the file that a tracker keeps its place in: it outlives the machine's other memory of it."""
        return self._folder / f"place-{index}"

    def take_places(self) -> list[tuple[int, int]]:
        """Return number and position at which trackers of an earlier, killed service stood; once."""
        found = []
        for path in self._folder.glob("place-*"):
            with suppress(OSError, struct.error):
                number, position = _PLACE.unpack(path.read_bytes())
                found += [(number, position)] * bool(number)
            self._remove(path)
        return found

    def clear_place(self, index: int) -> None:
        """Forget where a tracker stood whose death was counted."""
        self._remove(self.place_path(index))

    @staticmethod
    def _remove(path: Path) -> None:
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            _log.warning("a tracker's place not removed", file=path.name, reason=str(error))

    # ------------------------------------------------------------- the file

    def _load(self) -> dict[str, Blame]:
        path = self._folder / _FILE
        try:
            known = json.loads(path.read_bytes())
            return {str(sensor_id): Blame(**values) for sensor_id, values in known.items()}
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, TypeError, AttributeError) as error:
            _log.error("what was set aside is not known", file=path.name, error=str(error))
            return {}

    def _save(self) -> None:
        path = self._folder / _FILE
        fresh = path.with_suffix(".new")
        try:
            with fresh.open("wb") as file:
                file.write(json.dumps({name: asdict(blame) for name, blame in self._blames.items()}).encode())
                file.flush()
                os.fsync(file.fileno())
            fresh.replace(path)
        except OSError as error:  # counted in memory all the same
            _log.warning("what was set aside is not stored", reason=str(error))


class PlaceFile:
    """Writes a place down where another process finds it after this one was killed, the service with it."""

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        self.write(0, 0)

    def write(self, number: int, position: int) -> None:
        """Keep the place, in the system's memory of the file; a full disk does not hinder the work."""
        try:
            os.pwrite(self._descriptor, _PLACE.pack(number, position), 0)
        except OSError as error:
            _log.debug("place not written", reason=str(error))
