"""The newest tracks of every sensor, and the readers that wait for newer ones.

The tracker thread publishes, readers wait in an event loop. An entry is a value: what is rendered from it
is rendered once and shared by all readers. Only the newest entry of a sensor is kept, so a slow reader
costs nothing.
"""

from __future__ import annotations

import asyncio
import threading
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from service.pipeline.fold_state import Folded

STALE_AFTER_US = 2_000_000

LiveState = Literal["waiting", "live", "stale"]


@dataclass(frozen=True, slots=True)
class LiveEntry:
    """What is known of a sensor after one folded record."""

    sensor_id: str
    version: int  # log position of the newest folded record; 0: nothing folded yet
    epoch: int
    received_us: int | None = None  # host's time of the newest frame
    folded: Folded | None = None  # the newest frame or tick
    points_from: Folded | None = None  # the newest frame, which has the points
    _rendered: dict[str, bytes] = field(default_factory=dict, compare=False, repr=False)

    def state(self, now_us: int) -> LiveState:
        """Return whether frames are coming in."""
        if self.received_us is None:
            return "waiting"
        return "stale" if now_us - self.received_us > STALE_AFTER_US else "live"

    def rendered(self, form: str, render: Callable[[LiveEntry], bytes]) -> bytes:
        """Return what `render` makes of the entry, made once for each form and then shared."""
        data = self._rendered.get(form)
        if data is None:
            data = self._rendered[form] = render(self)
        return data


class LiveView:
    """The newest entry of every sensor, for any number of readers."""

    def __init__(self) -> None:
        self._entries: dict[str, LiveEntry] = {}
        self._waiters: dict[str, set[asyncio.Future[None]]] = defaultdict(set)
        self._guard = threading.Lock()  # over the waiters
        self.ended = False  # nobody shall wait any more

    def publish(self, entry: LiveEntry) -> None:
        """Make the entry the newest of its sensor, and wake who waits; from any thread."""
        self._entries[entry.sensor_id] = entry
        self._wake(entry.sensor_id)

    def remove(self, sensor_id: str) -> None:
        """Forget a sensor."""
        self._entries.pop(sensor_id, None)
        self._wake(sensor_id)

    def newest(self, sensor_id: str) -> LiveEntry | None:
        """Return the newest entry, None for an unknown sensor."""
        return self._entries.get(sensor_id)

    def end(self) -> None:
        """Wake whoever waits, and let nobody wait from now on."""
        self.ended = True
        for sensor_id in list(self._waiters):
            self._wake(sensor_id)

    async def wait(self, sensor_id: str, after: int, timeout_s: float) -> LiveEntry | None:
        """Return the newest entry as soon as its version is not `after`, or when the time is up.

        Any other version counts as news, so that a reader with a version of an earlier installation is
        answered at once. None: the sensor is unknown, or was removed meanwhile.
        """
        entry = self._entries.get(sensor_id)
        if entry is None or entry.version != after or timeout_s <= 0 or self.ended:
            return entry
        try:
            async with asyncio.timeout(timeout_s):
                return await self._news(sensor_id, after)
        except TimeoutError:
            return self._entries.get(sensor_id)

    async def _news(self, sensor_id: str, after: int) -> LiveEntry | None:
        loop = asyncio.get_running_loop()
        while True:
            news: asyncio.Future[None] = loop.create_future()
            with self._guard:
                self._waiters[sensor_id].add(news)
            try:
                entry = self._entries.get(sensor_id)
                if entry is None or entry.version != after or self.ended:
                    return entry
                await news
            finally:
                self._forget(sensor_id, news)

    def _forget(self, sensor_id: str, news: asyncio.Future[None]) -> None:
        news.cancel()
        with self._guard:
            waiters = self._waiters.get(sensor_id)
            if waiters is not None:
                waiters.discard(news)
                if not waiters:
                    del self._waiters[sensor_id]

    def _wake(self, sensor_id: str) -> None:
        with self._guard:
            waiters = self._waiters.pop(sensor_id, set())
        by_loop: dict[asyncio.AbstractEventLoop, list[asyncio.Future[None]]] = defaultdict(list)
        for news in waiters:
            by_loop[news.get_loop()].append(news)
        for loop, items in by_loop.items():
            if not loop.is_closed():
                loop.call_soon_threadsafe(_settle, items)


def _settle(waiters: list[asyncio.Future[None]]) -> None:
    for news in waiters:
        if not news.done():
            news.set_result(None)
