"""The tracker as a thread of the serving process: for tests, and where there is one processor only."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Generic

import structlog

from service.formats.sensor import SensorConfig
from service.pipeline.channel import Channel, Reopening, Standing
from service.pipeline.fold_state import S
from service.pipeline.folding import DRAIN_S, IDLE_S, Folding
from service.pipeline.live import LiveEntry, LiveView
from service.pipeline.tracker_member import ProcessHealth
from service.telemetry import Samples, Telemetry

_log = structlog.get_logger(__name__)
_US_PER_S = 1_000_000


class Readers:
    """Shows what was folded, here or in another process, to the readers of this one."""

    def __init__(
        self,
        live: LiveView,
        telemetry: Telemetry,
        clock_us: Callable[[], int],
        folded: Callable[[str, int], None],
    ) -> None:
        """`folded` hears of each sensor's newest folded position."""
        self._live = live
        self._readable = telemetry.stage.labels("readable")
        self._clock_us = clock_us
        self._folded = folded

    def show(self, entry: LiveEntry, *, frame: bool) -> None:
        """Make the view the newest of its sensor.

        A tracker process that was started again folds some records once more: only what is newer than the
        newest view is shown.
        """
        newest = self._live.newest(entry.sensor_id)
        known = newest is not None and (newest.epoch, newest.version) >= (entry.epoch, entry.version)
        if not known:
            self._live.publish(entry)
        self._folded(entry.sensor_id, entry.version)  # who hears of it finds the view
        if known:
            return
        if frame and entry.received_us is not None:
            self._readable.observe(max(0, self._clock_us() - entry.received_us) / _US_PER_S)

    def folded(self, sensor_id: str, position: int) -> None:
        """Take in how far a sensor is folded."""
        self._folded(sensor_id, position)

    def gone(self, sensor_id: str) -> None:
        """Forget a sensor that was let go."""
        self._live.remove(sensor_id)


class TrackerThread(Generic[S]):
    """Folds its channels until it is told to stop."""

    def __init__(self, folding: Folding[S]) -> None:
        self._folding = folding
        self._news = threading.Event()
        self._stop_by_s: float | None = None
        self._thread = threading.Thread(target=self._run, name="wayside-tracker", daemon=True)

    def start(self) -> None:
        """Begin to fold."""
        self._thread.start()

    def stop(self) -> None:
        """Fold what is logged while there is time, store it with a snapshot of each sensor, and end."""
        if self._thread.is_alive():
            self._stop_by_s = time.monotonic() + DRAIN_S
            self._news.set()
            self._thread.join()

    def news(self, positions: dict[str, int]) -> None:  # noqa: ARG002 - the log itself tells
        """Tell that there are new records."""
        self._news.set()

    def wake(self) -> None:
        """Tell that there may be something to do."""
        self._news.set()

    @property
    def alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    @property
    def channels(self) -> dict[str, Channel[S]]:
        """The sensors that it folds."""
        return self._folding.channels

    def add(self, channel: Channel[S], config: SensorConfig) -> None:  # noqa: ARG002 - the channel has it
        """Take a sensor in."""
        self._folding.add(channel)
        self._news.set()

    def leave(self, sensor_id: str) -> None:
        """Let a sensor go once all that is logged of it is folded and stored."""
        channel = self._folding.channels.get(sensor_id)
        if channel is not None:
            channel.leaving = True
            self._news.set()

    def restart(self, config: SensorConfig, anew: str | None) -> None:
        """Track a sensor that failed once more; `anew`: why its next epoch begins."""
        self._folding.reopen(config.sensor_id, Reopening(config, anew))
        self._news.set()

    def reconfigure(self, config: SensorConfig) -> None:
        """Do nothing: the new configuration comes by the log."""

    def standing(self, sensor_id: str) -> Standing | None:
        """Return where a sensor stands, None for one that is not here."""
        channel = self._folding.channels.get(sensor_id)
        return None if channel is None else channel.standing()

    def health(self) -> tuple[ProcessHealth, ...]:
        """Return nothing: there is no process beside this one."""
        return ()

    def samples(self) -> list[Samples]:
        """Return nothing: all is counted in the host's own metrics."""
        return []

    @property
    def damaged_records(self) -> int:
        """None of its own: the log counts them itself."""
        return 0

    def _run(self) -> None:
        try:
            self._fold_all()
        except Exception:  # noqa: BLE001 - the edge of the thread; health tells that it ended
            _log.exception("tracker thread ended")

    def _fold_all(self) -> None:
        while True:
            stop_by_s = self._stop_by_s
            self._news.clear()
            worked = self._folding.take_turns()
            if stop_by_s is not None and (not worked or time.monotonic() >= stop_by_s):
                break
            if not worked:
                self._news.wait(IDLE_S)
        self._folding.finish()
