from __future__ import annotations

import asyncio
import threading

from service.pipeline.live import STALE_AFTER_US, LiveEntry, LiveView


def entry(version: int, sensor_id: str = "radar-1", received_us: int | None = 5) -> LiveEntry:
    return LiveEntry(sensor_id, version, 1, received_us)


def test_a_reader_with_an_older_version_is_answered_at_once():
    view = LiveView()
    view.publish(entry(3))

    assert asyncio.run(view.wait("radar-1", 2, 5.0)).version == 3


def test_a_version_that_never_was_counts_as_older():
    view = LiveView()
    view.publish(entry(3))

    assert asyncio.run(view.wait("radar-1", 900, 5.0)).version == 3


def test_readers_of_several_event_loops_wake_when_another_thread_publishes():
    view = LiveView()
    view.publish(entry(1))
    waiting = threading.Barrier(3)
    seen: list[int] = []

    def read() -> None:
        async def run() -> None:
            readers = [asyncio.ensure_future(view.wait("radar-1", 1, 30.0)) for _ in range(5)]
            await asyncio.sleep(0)
            waiting.wait()
            seen.extend(found.version for found in await asyncio.gather(*readers))

        asyncio.run(run())

    threads = [threading.Thread(target=read) for _ in range(2)]
    for thread in threads:
        thread.start()
    waiting.wait()
    view.publish(entry(2))
    for thread in threads:
        thread.join()

    assert seen == [2] * 10
    assert not view._waiters


def test_a_reader_gets_the_old_entry_when_its_time_is_up():
    view = LiveView()
    view.publish(entry(1))

    assert asyncio.run(view.wait("radar-1", 1, 0.01)).version == 1
    assert not view._waiters


def test_other_sensors_do_not_wake_a_reader_and_removal_does():
    async def run() -> LiveEntry | None:
        view = LiveView()
        view.publish(entry(1))
        reader = asyncio.ensure_future(view.wait("radar-1", 1, 30.0))
        await asyncio.sleep(0)
        view.publish(entry(7, "radar-2"))
        for _ in range(5):
            await asyncio.sleep(0)
        assert not reader.done()
        view.remove("radar-1")
        return await reader

    assert asyncio.run(run()) is None


def test_a_cancelled_reader_leaves_nothing_behind():
    async def run() -> LiveView:
        view = LiveView()
        view.publish(entry(1))
        reader = asyncio.ensure_future(view.wait("radar-1", 1, 30.0))
        await asyncio.sleep(0)
        reader.cancel()
        await asyncio.gather(reader, return_exceptions=True)
        return view

    assert not asyncio.run(run())._waiters


def test_an_entry_is_rendered_once_for_all_readers():
    made: list[int] = []

    def render(one: LiveEntry) -> bytes:
        made.append(one.version)
        return b"rendered"

    one = entry(4)

    assert [one.rendered("json", render) for _ in range(3)] == [b"rendered"] * 3
    assert one.rendered("points", render) == b"rendered"
    assert made == [4, 4]


def test_the_state_follows_the_age_of_the_newest_frame():
    assert entry(0, received_us=None).state(10) == "waiting"
    assert entry(1, received_us=10).state(10 + STALE_AFTER_US) == "live"
    assert entry(1, received_us=10).state(11 + STALE_AFTER_US) == "stale"
