"""A sensor whose tracker failed: its share of the log, its expiry, and how it is tracked again."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import structlog
from sqlalchemy import Engine

from service.errors import Conflict, NotFound, Unavailable
from service.pipeline import sqlite_log, untracked
from service.pipeline.host import EmbeddedHost
from service.settings import Settings
from service.storage import migrate
from service.storage.database import connection as reading
from service.storage.database import open_database, session_scope
from service.storage.events import list_events
from service.storage.sites import create_sensor
from service.telemetry import set_up_logging
from tests.pipeline import simple_tracker
from tests.pipeline.hosts import caught_up, submit, wait_until
from tests.pipeline.recordings import CONFIG, PERIOD_US, START_US, recording

SECOND_US = 1_000_000
HOUR_US = 3600 * SECOND_US
SMALL_LOG_BYTES, LARGEST_BATCH_BYTES = 8 * 65_536, 32_768
POISON = 3  # the number of the frame at which radar-1 fails


class Clock:
    def __init__(self) -> None:
        self.now_us = START_US + SECOND_US

    def __call__(self) -> int:
        return self.now_us


def step(state, frame, parameters):
    if frame.sensor_id == "radar-1" and frame.sequence == POISON:
        raise ZeroDivisionError("made up")
    return simple_tracker.step(state, frame, parameters)


FAILING = SimpleNamespace(initial_state=simple_tracker.initial_state, step=step, coast=simple_tracker.coast)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Engine]:
    engine = open_database(f"sqlite:///{tmp_path}/rows.sqlite")
    migrate.upgrade(engine)
    with session_scope(engine) as writer:
        for name in ("radar-1", "radar-2"):
            create_sensor(writer, CONFIG.model_copy(update={"sensor_id": name}), now_us=START_US)
    yield engine
    engine.dispose()


@pytest.fixture
def running(
    database: Engine, tmp_path: Path, clock: Clock, monkeypatch
) -> Iterator[Callable[..., contextlib.AbstractContextManager[EmbeddedHost]]]:
    monkeypatch.setattr(untracked, "LOOK_S", 3600.0)  # the tests say when
    monkeypatch.setattr(sqlite_log, "_ROOM_CHECK_S", 0.0)
    set_up_logging("warning", "json")

    @contextlib.contextmanager
    def run(**changes: object) -> Iterator[EmbeddedHost]:
        values = {
            "flush_interval_s": 0.01,
            "snapshot_frames": 20,
            "snapshot_interval_s": 0.1,
            "disk_free_min_share": 0.0,
            "clock_ahead_limit_s": 1e9,
        }
        settings = Settings(data_dir=tmp_path, **(values | changes))
        host = EmbeddedHost(database, settings, tracker=FAILING, clock_us=clock)
        host.start()
        try:
            yield host
        finally:
            host.stop()

    yield run
    structlog.reset_defaults()


def of(sensor_id: str, count: int, first: int = 1, *, vehicles: int = 2):
    start_us = START_US + (first - 1) * PERIOD_US
    frames = recording(count, first=first, start_us=start_us, vehicles=vehicles)
    return [dataclasses.replace(frame, sensor_id=sensor_id) for frame in frames]


def failure_of(host: EmbeddedHost) -> str | None:
    return next(s.failure for s in host.health().sensors if s.sensor_id == "radar-1")


def tracked_number(host: EmbeddedHost, sensor_id: str) -> int:
    folded = host.live.newest(sensor_id).folded
    return 0 if folded is None else folded.number


def fail(host: EmbeddedHost) -> None:
    for frame in of("radar-1", 5):
        submit(host, [frame], "radar-1")
    wait_until(lambda: failure_of(host) is not None)


def submit_when_there_is_room(host: EmbeddedHost, frames, sensor_id: str) -> None:
    """Submit as a sensor does: again where the log was full, until the snapshots let its oldest file go."""
    outcomes: list[str] = []

    def taken() -> bool:
        with contextlib.suppress(Unavailable):
            outcomes[:] = submit(host, frames, sensor_id)
        return bool(outcomes)

    wait_until(taken)
    assert outcomes == ["accepted"] * len(frames)


def restarts(database: Engine) -> list[str]:
    with reading(database) as reader:
        events = list_events(reader, "radar-1").items
    return [str(event.detail["reason"]) for event in events if event.kind == "tracker_restarted"]


def test_a_failed_sensor_never_stops_the_others_and_comes_back_when_its_frames_expired(running, database):
    with running(log_limit_bytes=SMALL_LOG_BYTES) as host:
        fail(host)
        for k in range(30):  # more than the log holds
            frames = of("radar-2", 20, 1 + 20 * k, vehicles=60)
            submit_when_there_is_room(host, frames, "radar-2")
            submit_when_there_is_room(host, of("radar-1", 2, 6 + 2 * k, vehicles=60), "radar-1")
            wait_until(lambda n=20 * (k + 1): tracked_number(host, "radar-2") == n)
        assert host._frame_log.first_position("radar-2") > 20
        # the last batch is taken while there is room for a record, however large it is
        assert host._frame_log.size_bytes() <= SMALL_LOG_BYTES + LARGEST_BATCH_BYTES
        assert host.health().log_refusal is None

        assert restarts(database) == []  # nobody has looked yet

        host._untracked.look()
        wait_until(lambda: failure_of(host) is None and caught_up(host))
        assert submit(host, of("radar-1", 5, 1000), "radar-1") == ["accepted"] * 5
        wait_until(lambda: tracked_number(host, "radar-1") == 1004)
        text = host.metrics().decode()

    (reason,) = restarts(database)
    assert reason.startswith("frames that waited for the tracker expired after it failed (record 4: ")
    lost = int(reason.partition("); ")[2].partition(" ")[0])
    assert lost > 10
    assert reason.endswith(f" {lost} records were left out, at positions 4 to {3 + lost}")
    assert f'wayside_frames_total{{fate="expired",sensor_id="radar-1"}} {float(lost)}' in text
    assert 'wayside_sensor_failed{sensor_id="radar-1"} 0.0' in text


def test_what_waits_of_a_failed_sensor_is_bounded_and_shown(running):
    limit_bytes = 4 * SMALL_LOG_BYTES
    with running(log_limit_bytes=limit_bytes) as host:
        fail(host)
        waiting = lambda: next(iter(host.health().sensors)).waiting_bytes  # noqa: E731
        taken = 0
        while waiting() <= limit_bytes // 8:
            submit(host, of("radar-1", 50, 6 + taken, vehicles=60), "radar-1")
            taken += 50
        with pytest.raises(Unavailable, match="fill its share") as refused:
            submit(host, of("radar-1", 1, 6 + taken), "radar-1")
        health = next(s for s in host.health().sensors if s.sensor_id == "radar-1")
        text = host.metrics().decode()

    assert "radar-1 is not tracked (record 4: ZeroDivisionError: made up)" in str(refused.value)
    assert refused.value.retry_after_s == untracked.RETRY_AFTER_S
    assert limit_bytes // 8 < health.waiting_bytes < limit_bytes // 8 + 51 * 1024
    assert health.waiting_bytes == taken * (64 + 16 * 60) + 3 * (64 + 16 * 2)
    assert f'wayside_waiting_log_bytes{{sensor_id="radar-1"}} {float(health.waiting_bytes)}' in text


def test_frames_that_wait_are_counted_again_after_a_restart_of_the_service(running):
    with running() as host:
        fail(host)
        before = [s.waiting_bytes for s in host.health().sensors]
    with running() as host:
        wait_until(lambda: failure_of(host) is not None)
        assert [s.waiting_bytes for s in host.health().sensors] == before
    assert before == [3 * (64 + 16 * 2), 0]


def test_what_was_received_too_long_ago_expires_and_the_rest_is_tracked(running, database, clock):
    with running(untracked_hours=2.0) as host:
        fail(host)
        clock.now_us += HOUR_US
        submit(host, of("radar-1", 5, 6), "radar-1")
        host._untracked.look()
        assert failure_of(host) is not None  # nothing is old enough

        clock.now_us += HOUR_US + SECOND_US
        host._untracked.look()
        wait_until(lambda: failure_of(host) is None and tracked_number(host, "radar-1") == 10)
        assert {s.waiting_bytes for s in host.health().sensors} == {0}

    assert [reason.partition("; ")[2] for reason in restarts(database)] == [
        "3 records were left out, at positions 4 to 6"
    ]


def test_a_sensor_that_fails_again_is_tried_ever_more_seldom(running, database, clock, monkeypatch):
    times = [0.0]
    monkeypatch.setattr(untracked, "time", SimpleNamespace(monotonic=lambda: times[0]))
    monkeypatch.setitem(globals(), "POISON", 3)
    with running(untracked_hours=1.0) as host:
        fail(host)
        for n in range(2):
            clock.now_us += 2 * HOUR_US
            monkeypatch.setitem(globals(), "POISON", 12 + 10 * n)
            times[0] += 1.0 if n == 0 else untracked.FIRST_PAUSE_S - 2.0
            submit(host, of("radar-1", 10, 6 + 10 * n), "radar-1")
            host._untracked.look()
            if n == 0:
                wait_until(lambda: (failure_of(host) or "").startswith("record 13"))
        assert len(restarts(database)) == 1  # too early for another
        times[0] += 3.0
        clock.now_us += 2 * HOUR_US
        host._untracked.look()
        wait_until(lambda: len(restarts(database)) == 2)


def test_an_administrator_has_what_waits_left_out(running, database):
    with running() as host:
        fail(host)
        assert host.restart("radar-1", skip=True) == 3
        wait_until(lambda: failure_of(host) is None)
        assert submit(host, of("radar-1", 5, 1), "radar-1") == ["accepted"] * 5  # a new history
        wait_until(lambda: failure_of(host) is not None)  # which has the same frame in it
        assert host.restart("radar-1", skip=True) == 3
        wait_until(lambda: failure_of(host) is None)
        submit(host, of("radar-1", 5, 4), "radar-1")
        wait_until(lambda: tracked_number(host, "radar-1") == 8)
        wait_until(lambda: caught_up(host))

    assert [reason.partition("; ")[2] for reason in restarts(database)] == [
        "3 records were left out, at positions 4 to 6",
        "3 records were left out, at positions 9 to 11",
    ]
    with running() as host:
        submit(host, of("radar-1", 5, 9), "radar-1")
        wait_until(lambda: tracked_number(host, "radar-1") == 13)
        assert failure_of(host) is None
    assert len(restarts(database)) == 2


def test_an_administrator_has_it_tried_again_once_the_fault_is_gone(running, database, monkeypatch):
    with running() as host:
        fail(host)
        monkeypatch.setitem(globals(), "POISON", 0)
        assert host.restart("radar-1", skip=False) == 0
        wait_until(lambda: failure_of(host) is None and tracked_number(host, "radar-1") == 5)
    assert restarts(database) == []


def test_a_sensor_that_has_not_failed_is_not_restarted(running):
    with running() as host:
        with pytest.raises(Conflict, match="has not failed"):
            host.restart("radar-1", skip=True)
        with pytest.raises(NotFound):
            host.restart("radar-9", skip=True)
