"""Send the views of a sensor to any number of streams: each is rendered once and shared by all of them.

The newest view wins: a reader that is slower than the updates misses some, and is told how many. The last
ones are kept, so that a reader who comes back gets what it missed. Nothing here asks the database.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import dataclass

import orjson
import structlog

from service.api import live_view
from service.errors import NotFound
from service.pipeline.host import EmbeddedHost
from service.pipeline.live import STALE_AFTER_US, LiveEntry

KEEP_ALIVE_S = 15.0
LINGER_S = 10.0  # a broadcast goes on without readers, so that one who comes back finds what it missed
KEPT_UPDATES = 50  # of a sensor: 5 s at ten a second, about half a megabyte with 30 vehicles

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Update:
    """One view as it goes over the wire."""

    number: int  # counts the updates of the broadcast, from 1
    version: int  # the log position that it shows
    data: bytes  # the whole event


class Broadcast:
    """The updates of one sensor, with or without points, as long as somebody reads them."""

    def __init__(self, host: EmbeddedHost, sensor_id: str, period_s: float, *, points: bool) -> None:
        self._host = host
        self._sensor_id = sensor_id
        self._period_s = period_s
        self._points = points
        self._kept: deque[Update] = deque(maxlen=KEPT_UPDATES)
        self._news = asyncio.Event()  # replaced with each update: whoever waits on the old one is woken
        self._task: asyncio.Task[None] | None = None
        self._readers = 0
        self._left_s = 0.0  # when the last reader went, monotonic
        self.over: str | None = None  # why there will be no more updates

    async def stream(self, seen: int | None) -> AsyncIterator[bytes]:
        """Yield the bytes of one reader's stream; `seen` is the last version that it had, None for none."""
        self._join()
        try:
            yield b"retry: 1000\n\n"
            number = 0
            if seen is not None and self._kept:
                for piece in self._since(seen):
                    yield piece
                number, seen = self._kept[-1].number, None
            while self.over is None:
                if not self._kept or self._kept[-1].number == number:
                    if not await _woken(self._news):
                        yield b": keep-alive\n\n"
                    continue
                update = self._kept[-1]
                if 0 < number < update.number - 1 or seen not in {None, update.version}:
                    yield _missed(update.number - 1 - number if number else None)
                number = update.number
                if update.version != seen:
                    yield update.data
                seen = None
            if self.over == "removed":
                yield b"event: end\ndata: {}\n\n"
        finally:
            self._leave()

    def _since(self, seen: int) -> list[bytes]:
        """Return what a reader missed since a version, as far as it is kept."""
        known = [update.number for update in self._kept if update.version == seen]
        if known:
            return [update.data for update in self._kept if update.number > known[0]]
        return [_missed(None), self._kept[-1].data]

    def _join(self) -> None:
        self._readers += 1
        if self._task is None:
            self._task = asyncio.create_task(self._run())

    def _leave(self) -> None:
        self._readers -= 1
        self._left_s = time.monotonic()

    async def _run(self) -> None:
        try:
            await self._follow()
        except Exception:  # noqa: BLE001 - the edge of a task: readers must not wait for ever
            _log.exception("streams of a sensor ended", sensor_id=self._sensor_id)
            self._end("failed")

    async def _follow(self) -> None:
        """Make updates at most once a period, until the sensor goes or nobody has read for a while."""
        live, shown = self._host.live, None
        while self._readers > 0 or time.monotonic() - self._left_s < LINGER_S:
            entry = live.newest(self._sensor_id)
            if entry is None or live.ended:
                self._end("removed" if entry is None else "closing")
                return
            now_us = time.time_ns() // 1000
            view = entry.version, entry.state(now_us)
            if view != shown:
                shown = view
                self._publish(entry, now_us)
                await asyncio.sleep(self._period_s)
                continue
            await live.wait(self._sensor_id, entry.version, _patience_s(entry, now_us))
        self._end("unread")

    def _publish(self, entry: LiveEntry, now_us: int) -> None:
        try:
            config = self._host.config(self._sensor_id)
        except NotFound:  # on its way out
            return
        body = live_view.body(entry, config, now_us, points=self._points)
        number = self._kept[-1].number + 1 if self._kept else 1
        data = b"id: %d\nevent: live\ndata: %b\n\n" % (entry.version, body)
        self._kept.append(Update(number, entry.version, data))
        self._wake()

    def _end(self, reason: str) -> None:
        self.over = reason
        self._wake()

    def _wake(self) -> None:
        news, self._news = self._news, asyncio.Event()
        news.set()


class Broadcasts:
    """The broadcasts of one process, by sensor and form; made when somebody asks."""

    def __init__(self, host: EmbeddedHost, rate_hz: float) -> None:
        self._host = host
        self._period_s = 1.0 / rate_hz
        self._all: dict[tuple[str, bool], Broadcast] = {}

    async def stream(self, sensor_id: str, seen: int | None, *, points: bool) -> AsyncIterator[bytes]:
        """Yield a reader's stream; a sensor's broadcast begins with its first reader."""
        async for piece in self._of(sensor_id, points=points).stream(seen):
            yield piece

    def _of(self, sensor_id: str, *, points: bool) -> Broadcast:
        found = self._all.get((sensor_id, points))
        if found is None or found.over is not None:
            found = Broadcast(self._host, sensor_id, self._period_s, points=points)
            self._all = {key: one for key, one in self._all.items() if one.over is None}
            self._all[sensor_id, points] = found
        return found


async def _woken(news: asyncio.Event) -> bool:
    """Wait for an update; return whether one came before a sign of life is due."""
    try:
        async with asyncio.timeout(KEEP_ALIVE_S):
            await news.wait()
    except TimeoutError:
        return False
    return True


def _missed(updates: int | None) -> bytes:
    """Return the notice that updates were left out; None: so many that they are no longer kept."""
    return b"event: missed\ndata: %b\n\n" % orjson.dumps({"updates": updates})


def _patience_s(entry: LiveEntry, now_us: int) -> float:
    """Return how long to wait for news: until the view turns stale, if it can."""
    if entry.received_us is None or entry.state(now_us) == "stale":
        return KEEP_ALIVE_S
    return min((entry.received_us + STALE_AFTER_US - now_us) / 1e6 + 0.01, KEEP_ALIVE_S)
