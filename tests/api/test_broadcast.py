from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable

import pytest

from service.api import broadcast, live_view
from service.api.broadcast import Broadcasts
from service.formats.sensor import SensorConfig
from service.pipeline.live import LiveEntry, LiveView

RATE_HZ = 50.0


class FakeHost:
    """A live view into which the test publishes."""

    def __init__(self) -> None:
        self.live = LiveView()

    def config(self, sensor_id):
        return SensorConfig(sensor_id=sensor_id)

    def publish(self, version):
        self.live.publish(LiveEntry("radar-1", version, 1, time.time_ns() // 1000))


def run(scene: Callable[[FakeHost, Broadcasts], object]):
    async def play():
        host = FakeHost()
        try:
            return await asyncio.wait_for(scene(host, Broadcasts(host, RATE_HZ)), 20)
        finally:
            host.live.end()
            await asyncio.sleep(0.05)

    return asyncio.run(play())


def parsed(piece):
    fields = dict(line.split(": ", 1) for line in piece.decode().strip().splitlines() if ": " in line)
    return fields.get("event"), fields.get("id"), json.loads(fields["data"]) if "data" in fields else None


async def until_version(stream, version):
    """Read up to an update, and return the names and ids of all that came."""
    seen = []
    async for piece in stream:
        event, identity, data = parsed(piece)
        seen.append((event, identity if event == "live" else data))
        if (event, identity) == ("live", str(version)):
            return seen
    return seen


def test_an_update_is_rendered_once_for_all_readers(monkeypatch):
    rendered = []
    body = live_view.body
    monkeypatch.setattr(live_view, "body", lambda *a, **k: rendered.append(1) or body(*a, **k))

    async def scene(host, broadcasts):
        host.publish(1)
        streams = [broadcasts.stream("radar-1", None, points=False) for _ in range(40)]
        readers = [asyncio.ensure_future(until_version(stream, 4)) for stream in streams]
        for version in (2, 3, 4):
            await asyncio.sleep(2 / RATE_HZ)
            host.publish(version)
        return await asyncio.gather(*readers)

    for seen in run(scene):
        assert seen[-1] == ("live", "4")
    assert 2 <= len(rendered) <= 4


def test_a_slow_reader_gets_the_newest_and_is_told_how_many_it_missed():
    async def scene(host, broadcasts):
        host.publish(1)
        slow, quick = (broadcasts.stream("radar-1", None, points=False) for _ in range(2))
        await until_version(slow, 1)
        await until_version(quick, 1)
        for version in range(2, 8):
            host.publish(version)
            await until_version(quick, version)
        return await until_version(slow, 7)

    assert run(scene) == [("missed", {"updates": 5}), ("live", "7")]


def test_a_reader_who_comes_back_gets_what_it_missed_from_the_buffer():
    async def scene(host, broadcasts):
        host.publish(1)
        stays, goes = (broadcasts.stream("radar-1", None, points=False) for _ in range(2))
        await until_version(goes, 1)
        await goes.aclose()
        await until_version(stays, 1)
        for version in (2, 3, 4):
            host.publish(version)
            await until_version(stays, version)
        return await until_version(broadcasts.stream("radar-1", 2, points=False), 4)

    assert run(scene) == [(None, None), ("live", "3"), ("live", "4")]


@pytest.mark.parametrize("warm", [True, False])
def test_a_reader_whose_place_is_no_longer_kept_is_told_so(warm):
    async def scene(host, broadcasts):
        host.publish(900)
        if warm:
            await until_version(broadcasts.stream("radar-1", None, points=False), 900)
        return await until_version(broadcasts.stream("radar-1", 17, points=False), 900)

    assert run(scene) == [(None, None), ("missed", {"updates": None}), ("live", "900")]


def test_the_buffer_is_bounded(monkeypatch):
    monkeypatch.setattr(broadcast, "KEPT_UPDATES", 3)

    async def scene(host, broadcasts):
        stream = broadcasts.stream("radar-1", None, points=False)
        for version in range(1, 9):
            host.publish(version)
            await until_version(stream, version)
        return [update.version for update in broadcasts._of("radar-1", points=False)._kept]

    assert run(scene) == [6, 7, 8]


def test_a_broadcast_without_readers_ends_and_begins_again(monkeypatch):
    monkeypatch.setattr(broadcast, "LINGER_S", 0.01)

    async def scene(host, broadcasts):
        host.publish(1)
        stream = broadcasts.stream("radar-1", None, points=False)
        await until_version(stream, 1)
        first = broadcasts._of("radar-1", points=False)
        await stream.aclose()
        while first.over is None:
            await asyncio.sleep(0.01)
            host.publish(2)
        again = await until_version(broadcasts.stream("radar-1", None, points=False), 2)
        return first.over, again[-1]

    assert run(scene) == ("unread", ("live", "2"))


def test_a_sensor_that_is_removed_ends_its_streams():
    async def scene(host, broadcasts):
        host.publish(1)
        stream = broadcasts.stream("radar-1", None, points=False)
        await until_version(stream, 1)
        host.live.remove("radar-1")
        return [parsed(piece)[0] async for piece in stream]

    assert run(scene) == ["end"]
