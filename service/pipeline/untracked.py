"""Sensors whose tracker failed: what they may keep in the log, when it expires, how they are tracked again.

The log's files are shared by all sensors. One that is not tracked would hold each file back for ever, until
no frame of any sensor could be taken. So what waits of it is bounded in three ways:

* Its own frames are refused while those that wait take more than its share of the log.
* Its records expire with the oldest file when others need the room, which the log sees to by itself.
* They expire when they were received too long ago.

Where the record at which it failed has expired, the sensor is tracked again: a new epoch begins behind, with
an event that says which records were left out. While it fails again and again, that is tried ever more
seldom, since it may cost the other sensors of its tracker process some seconds each time.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import structlog

from service.errors import Conflict, Unavailable
from service.formats.sensor import SensorConfig
from service.pipeline.blame import BlameBook
from service.pipeline.channel import Doorway, Standing
from service.pipeline.order import OrderState
from service.pipeline.periodic import Periodic
from service.pipeline.sqlite_log import SqliteLog

LOOK_S = 1.0
FIRST_PAUSE_S, MOST_PAUSE_S = 60.0, 3600.0  # between two epochs of a sensor that fails again
CALM_S = 7200.0
RETRY_AFTER_S = 60.0  # it takes an expiry or an administrator

_log = structlog.get_logger(__name__)


class Trackers(Protocol):
    """Who folds the sensors."""

    def standing(self, sensor_id: str) -> Standing | None:
        """Return where a sensor stands, None for one that is not tracked here."""
        ...

    def restart(self, config: SensorConfig, anew: str | None) -> None:
        """Track a sensor that failed once more; `anew`: why its next epoch begins."""
        ...


@dataclass(frozen=True, slots=True)
class Allowance:
    """What a sensor that is not tracked may keep in the log."""

    bytes: int
    age_us: int


@dataclass(frozen=True, slots=True)
class _Try:
    """When a sensor that failed was last told to begin anew; monotonic seconds."""

    position: int = 0  # behind which
    pause_s: float = FIRST_PAUSE_S
    again_s: float = -math.inf  # not before

    def next(self, position: int, now_s: float) -> _Try:
        calm = now_s - self.again_s > CALM_S
        pause_s = FIRST_PAUSE_S if calm else min(2 * self.pause_s, MOST_PAUSE_S)
        return _Try(position, pause_s, now_s + pause_s)


class Untracked:
    """Looks after the sensors that failed, once a second."""

    def __init__(  # noqa: PLR0913, PLR0917 - its collaborators
        self,
        frame_log: SqliteLog,
        trackers: Trackers,
        doorways: Callable[[], Mapping[str, Doorway]],
        allowance: Allowance,
        blames: BlameBook,
        clock_us: Callable[[], int],
    ) -> None:
        self._frame_log = frame_log
        self._trackers = trackers
        self._doorways = doorways
        self._allowance = allowance
        self._blames = blames
        self._clock_us = clock_us
        self._tries: dict[str, _Try] = {}
        self._guard = threading.Lock()  # over restarts
        self._thread = Periodic("untracked", LOOK_S, self.look)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def stop(self) -> None:
        """End."""
        self._thread.stop()

    # ------------------------------------------------------------- what the log and the door ask

    def given_up(self, sensor_id: str) -> bool:
        """Return whether a sensor's records hold no file of the log back; uses no lock."""
        standing = self._trackers.standing(sensor_id)
        if standing is None:
            return sensor_id not in self._doorways()  # let go, while frames of it were on their way
        return standing.failure is not None

    def require_room(self, doorway: Doorway) -> None:
        """Raise Unavailable when the frames of a sensor that failed fill its share of the log."""
        waiting = doorway.waiting_bytes
        if waiting <= self._allowance.bytes:
            return
        standing = self._trackers.standing(doorway.sensor_id)
        if standing is not None and standing.failure is not None:
            raise Unavailable(
                f"sensor {doorway.sensor_id} is not tracked ({standing.failure}), and the {waiting} bytes of "
                f"its frames that wait fill its share of the log, {self._allowance.bytes} bytes; frames are "
                "taken again when the oldest have expired, or an administrator has restarted the sensor",
                RETRY_AFTER_S,
            )

    # ------------------------------------------------------------- expiry and restart

    def look(self) -> None:
        """Let expire what is too old of the sensors that failed, and track those again that may go on."""
        oldest_us, now_s = self._clock_us() - self._allowance.age_us, time.monotonic()
        for doorway in self._doorways().values():
            with self._guard:
                standing = self._trackers.standing(doorway.sensor_id)
                tried = self._tries.get(doorway.sensor_id, _Try())
                if standing is None or standing.failure is None or now_s < tried.again_s:
                    continue
                position = doorway.waiting_since_before(oldest_us)
                if position is not None:
                    self._frame_log.expire(doorway.sensor_id, position)
                if self._kept(doorway) > max(standing.folded_position, tried.position) + 1:
                    self._begin_anew(doorway, standing, "frames that waited for the tracker expired")

    def restart(self, doorway: Doorway, *, skip: bool) -> int:
        """Track a sensor that failed once more, and return how many records are left out for good.

        That is as far as the tracker told; its event and its count are exact. Raises Conflict when the sensor
        has not failed.
        """
        with self._guard:
            standing = self._trackers.standing(doorway.sensor_id)
            if standing is None or standing.failure is None:
                raise Conflict(f"sensor {doorway.sensor_id} has not failed; there is nothing to restart")
            if not skip:
                self._blames.forgive(doorway.sensor_id)
                self._trackers.restart(doorway.config, None)
                return 0
            last = self._frame_log.last_position(doorway.sensor_id)
            self._frame_log.expire(doorway.sensor_id, last)
            return self._begin_anew(
                doorway, standing, "an administrator had what waited for the tracker left out"
            )

    def _begin_anew(self, doorway: Doorway, standing: Standing, why: str) -> int:
        sensor_id = doorway.sensor_id
        last = self._kept(doorway) - 1
        count = max(0, last - max(standing.folded_position, doorway.folded))
        _log.warning("sensor begins anew", sensor_id=sensor_id, reason=why, failure=standing.failure)
        self._tries[sensor_id] = self._tries.get(sensor_id, _Try()).next(last, time.monotonic())
        doorway.pass_folded(last)
        if not doorway.waiting:  # the next frame is the first of the epoch
            doorway.door = doorway.durable_door = OrderState()
        self._blames.forgive(sensor_id)
        self._trackers.restart(doorway.config, f"{why} after it failed ({standing.failure})")
        return count

    def _kept(self, doorway: Doorway) -> int:
        """Return the position of the oldest record that is kept, or of the next one."""
        sensor_id = doorway.sensor_id
        return self._frame_log.first_position(sensor_id) or self._frame_log.last_position(sensor_id) + 1
