"""The tracker in processes of its own: the same rows, and nothing lost or doubled when one is killed."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import structlog
from sqlalchemy import Engine

from service.errors import StorageError
from service.pipeline import tracker_process, tracker_processes
from service.pipeline.host import EmbeddedHost
from service.pipeline.nursery import Nursery
from service.settings import Settings
from service.storage import migrate
from service.storage.database import connection as reading
from service.storage.database import open_database, session_scope
from service.storage.events import list_events
from service.storage.sites import create_sensor, update_sensor
from service.telemetry import set_up_logging
from tests.pipeline import simple_tracker
from tests.pipeline.hosts import (
    caught_up,
    check_that_a_stop_in_a_backlog_loses_nothing,
    folded_rows,
    stored_rows,
    submit,
    wait_until,
)
from tests.pipeline.recordings import (
    CONFIG,
    PERIOD_US,
    START_US,
    fold_records,
    pausing_recording,
    recording,
    records,
)

SECOND_US = 1_000_000


@pytest.fixture(autouse=True)
def _short_log_lines() -> Iterator[None]:
    set_up_logging("warning", "json")
    yield
    structlog.reset_defaults()


@pytest.fixture(scope="module", autouse=True)
def _kernels_are_loaded() -> None:
    """Load the kernels before a nursery is forked, as the service does: else each process would by itself."""
    fold_records(records(recording(60)))


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Engine]:
    engine = open_database(f"sqlite:///{tmp_path}/rows.sqlite")
    migrate.upgrade(engine)
    with session_scope(engine) as writer:
        create_sensor(writer, CONFIG, now_us=START_US)
    engine.dispose()
    yield engine
    engine.dispose()


@pytest.fixture
def running(database: Engine, tmp_path: Path) -> Callable[..., contextlib.AbstractContextManager]:
    """Return a context manager of a host with tracker processes on the test's data directory."""

    @contextlib.contextmanager
    def run(tracker=simple_tracker, **changes: object) -> Iterator[EmbeddedHost]:
        clock = changes.pop("clock_us", lambda: START_US + SECOND_US)
        values = {"flush_interval_s": 0.01, "tracker_processes": 1} | changes
        settings = Settings(data_dir=tmp_path, disk_free_min_share=0.0, clock_ahead_limit_s=1e9, **values)
        nursery = Nursery({tracker_process.WORK: tracker_process.work_of(settings, tracker, clock)})
        host = EmbeddedHost(database, settings, tracker=tracker, clock_us=clock, nursery=nursery)
        try:
            host.start()
            yield host
        finally:
            host.stop()
            nursery.close()

    return run


def pid_of(host: EmbeddedHost) -> int:
    (process,) = host.health().processes
    assert process.pid is not None
    return process.pid


def test_frames_are_tracked_served_and_stored_by_a_process(running, database):
    frames = recording(50)
    with running() as host:
        assert submit(host, frames) == ["accepted"] * 50
        wait_until(lambda: caught_up(host))
        entry = host.live.newest("radar-1")
        (health,) = host.health().sensors
        text = host.metrics().decode()
        child = pid_of(host)

    assert entry.folded.number == 50
    assert list(entry.folded.estimates.number) == [1, 2]
    assert len(entry.points_from.frame) == 2
    assert (health.state, health.queue_depth, health.failure) == ("live", 0, None)
    assert 'wayside_frames_total{fate="tracked",sensor_id="radar-1"} 50.0' in text
    assert 'wayside_tracks{sensor_id="radar-1",status="confirmed"} 2.0' in text
    assert 'wayside_stage_seconds_count{stage="logged"}' in text
    assert 'wayside_stage_seconds_count{stage="folded"} 50.0' in text
    assert child != os.getpid()
    summaries, blocks = stored_rows(database)
    assert (len(summaries), len(blocks)) == folded_rows(frames)


def test_a_reader_is_woken_when_a_process_has_tracked_a_frame(running):
    async def run(host: EmbeddedHost) -> int:
        await host.submit("radar-1", recording(1))
        version = 0
        while version < 2:
            version = (await host.live.wait("radar-1", version, 20.0)).version
        return version

    with running() as host:
        assert asyncio.run(run(host)) == 2


def test_a_stop_does_not_wait_for_a_long_backlog(running, database, monkeypatch):
    monkeypatch.setattr(tracker_process, "DRAIN_S", 0.0)

    check_that_a_stop_in_a_backlog_loses_nothing(running, database)


def test_processes_store_the_same_rows_as_a_thread(running, database, tmp_path):
    frames = pausing_recording()
    with running() as host:
        submit(host, frames)
    in_processes = stored_rows(database)

    other = tmp_path / "thread"
    engine = open_database(f"sqlite:///{other}/rows.sqlite")
    migrate.upgrade(engine)
    with session_scope(engine) as writer:
        create_sensor(writer, CONFIG, now_us=START_US)
    settings = Settings(data_dir=other, disk_free_min_share=0.0, clock_ahead_limit_s=1e9)
    host = EmbeddedHost(engine, settings, tracker=simple_tracker, clock_us=lambda: START_US + SECOND_US)
    host.start()
    submit(host, frames)
    host.stop()

    assert in_processes == stored_rows(engine)
    assert len(in_processes[0]) == 4
    engine.dispose()


def test_silence_ends_tracks_by_ticks_that_the_process_asks_for(running, database):
    begun_s = time.monotonic()
    hurried = lambda: START_US + round((time.monotonic() - begun_s) * 20 * SECOND_US)  # noqa: E731
    with running(clock_us=hurried) as host:
        submit(host, recording(30))
        wait_until(lambda: caught_up(host) and len(host.live.newest("radar-1").folded.estimates) == 0)
        wait_until(lambda: caught_up(host))

    summaries, _ = stored_rows(database)
    assert len(summaries) == 2
    assert all(row[3] for row in summaries)  # ended


def test_a_killed_process_is_started_again_and_nothing_is_lost_or_doubled(running, database):
    frames = recording(120)
    with running(snapshot_frames=20) as host:
        versions = []
        publish = host.live.publish
        host.live.publish = lambda entry: (versions.append((entry.epoch, entry.version)), publish(entry))
        for first in range(0, 120, 30):
            submit(host, frames[first : first + 30])
            wait_until(lambda: host.health().sensors[0].queue_depth == 0)
            os.kill(pid_of(host), signal.SIGKILL)
            wait_until(lambda n=first // 30 + 1: host.health().processes[0].restarts == n)
        wait_until(lambda: host.health().tracking and caught_up(host))
        entry = host.live.newest("radar-1")
        text = host.metrics().decode()

    assert entry.folded.number == 120
    assert versions == sorted(set(versions))  # readers never go back
    assert 'wayside_tracker_process_restarts_total{process="0"} 4.0' in text
    summaries, blocks = stored_rows(database)
    assert (len(summaries), len(blocks)) == folded_rows(frames)
    with reading(database) as reader:
        assert not list_events(reader, "radar-1").items


def test_frames_are_taken_while_no_process_runs(running, database):
    frames = recording(60)
    with running() as host:
        submit(host, frames[:20])
        os.kill(pid_of(host), signal.SIGKILL)
        wait_until(lambda: not host.health().tracking)
        assert submit(host, frames[20:]) == ["accepted"] * 40
        assert host.ready
        wait_until(lambda: caught_up(host) and host.live.newest("radar-1").folded.number == 60)

    assert tuple(map(len, stored_rows(database))) == folded_rows(frames)


def test_a_changed_configuration_goes_over_and_survives_a_new_process(running, database):
    changed = CONFIG.model_copy(update={"filter": "ekf"})
    with running() as host:
        submit(host, recording(5))
        with session_scope(database) as writer:
            sensor = update_sensor(writer, "radar-1", {"config": changed}, now_us=START_US)
        host.configure(sensor)
        os.kill(pid_of(host), signal.SIGKILL)
        wait_until(lambda: host.health().processes[0].restarts == 1 and caught_up(host))
        submit(host, recording(10)[5:])
        wait_until(lambda: caught_up(host))

        assert host.live.newest("radar-1").folded.number == 10
        assert host.health().sensors[0].logged_position == 12


def test_a_forgotten_sensor_is_let_go_and_its_log_can_be_purged(running, database):
    with running() as host:
        submit(host, recording(30))
        host.forget("radar-1")
        wait_until(lambda: host.live.newest("radar-1") is None)
        host.purge("radar-1")
        assert host._frame_log.read("radar-1", 0, 10) == []
        assert host.health().processes[0].sensors == 0

    assert len(stored_rows(database)[0]) == 2


def test_the_log_may_drop_what_the_process_has_a_snapshot_of(running):
    with running(snapshot_interval_s=0.3) as host:
        submit(host, recording(30))
        wait_until(lambda: caught_up(host))
        last = host._frame_log.last_position("radar-1")
        wait_until(lambda: host._frame_log._released.get("radar-1") == last)


def test_a_process_follows_the_log_over_many_files(running, database):
    frames = recording(200)
    with running(log_limit_bytes=8 * 65_536, snapshot_frames=10) as host:
        for first in range(0, 200, 20):
            submit(host, frames[first : first + 20])
            wait_until(lambda: caught_up(host))
        assert host._frame_log.file_count() > 1

    assert tuple(map(len, stored_rows(database))) == folded_rows(frames)


def test_sensors_are_shared_among_the_processes(running, database):
    with session_scope(database) as writer:
        for n in (2, 3, 4):
            config = CONFIG.model_copy(update={"sensor_id": f"radar-{n}"})
            create_sensor(writer, config, now_us=START_US)
    database.dispose()
    with running(tracker_processes=2) as host:
        for n in (1, 2, 3, 4):
            name = f"radar-{n}"
            submit(host, [dataclasses.replace(f, sensor_id=name) for f in recording(20)], name)
        wait_until(lambda: caught_up(host))
        health = host.health()

        pids = {process.pid for process in health.processes}
        niceness = [os.getpriority(os.PRIO_PROCESS, pid) - os.nice(0) for pid in pids]
    assert [process.sensors for process in health.processes] == [2, 2]
    assert len(pids) == 2
    assert niceness == [tracker_process.NICENESS] * 2
    assert {sensor.folded_position for sensor in health.sensors} == {21}


def test_one_failing_sensor_does_not_stop_the_others_of_its_process(running, database):
    def fail(state, one, parameters):
        if one.sensor_id == "radar-1" and one.sequence == 3:
            raise ZeroDivisionError("made up")
        return simple_tracker.step(state, one, parameters)

    failing = SimpleNamespace(
        initial_state=simple_tracker.initial_state, step=fail, coast=simple_tracker.coast
    )
    with session_scope(database) as writer:
        create_sensor(writer, CONFIG.model_copy(update={"sensor_id": "radar-2"}), now_us=START_US)
    database.dispose()
    with running(failing) as host:
        submit(host, recording(5))
        submit(host, [dataclasses.replace(f, sensor_id="radar-2") for f in recording(5)], "radar-2")
        wait_until(lambda: host.live.newest("radar-2").version == 6)
        wait_until(lambda: host.health().sensors[0].failure is not None)
        failures = {s.sensor_id: s.failure for s in host.health().sensors}

    assert failures == {"radar-1": "record 4: ZeroDivisionError: made up", "radar-2": None}


def with_second_sensor(database: Engine) -> None:
    with session_scope(database) as writer:
        create_sensor(writer, CONFIG.model_copy(update={"sensor_id": "radar-2"}), now_us=START_US)
    database.dispose()


def of_second_sensor(frames):
    return [dataclasses.replace(frame, sensor_id="radar-2") for frame in frames]


def tracker_that(harm: Callable[[], object], is_poison: Callable) -> SimpleNamespace:
    """Return a tracker that does harm at some frames."""

    def step(state, frame, parameters):
        if is_poison(frame):
            harm()
        return simple_tracker.step(state, frame, parameters)

    return SimpleNamespace(initial_state=simple_tracker.initial_state, step=step, coast=simple_tracker.coast)


def damage_of(database: Engine, sensor_id: str) -> list[int]:
    with reading(database) as reader:
        events = list_events(reader, sensor_id).items
    database.dispose()  # nothing open when a nursery is forked
    return [event.detail["position"] for event in events if event.kind == "record_damaged"]


@pytest.mark.parametrize(
    "harm",
    [
        pytest.param(lambda: os._exit(9), id="ends"),
        pytest.param(lambda: time.sleep(60), id="hangs", marks=pytest.mark.slow),
    ],
)
def test_a_record_that_ends_or_hangs_the_process_is_set_aside(running, database, monkeypatch, harm):
    monkeypatch.setattr(tracker_processes, "HUNG_S", 3.0)
    poison = lambda frame: frame.sensor_id == "radar-1" and frame.sequence == 20  # noqa: E731
    with_second_sensor(database)
    frames = recording(40)
    with running(tracker_that(harm, poison)) as host:
        submit(host, frames)
        submit(host, of_second_sensor(frames), "radar-2")
        wait_until(lambda: host.health().tracking and caught_up(host))
        wait_until(lambda: host.live.newest("radar-1").folded.number == 40)
        health = host.health()
        text = host.metrics().decode()
        last = host._frame_log.last_position("radar-1")
        assert host._frame_log._released.get("radar-1", 0) >= 21  # the snapshot behind it is stored
        submit(host, recording(50)[40:])
        wait_until(lambda: caught_up(host) and host.live.newest("radar-1").folded.number == 50)

    assert last == 41
    assert health.processes[0].restarts == 3
    assert [sensor.failure for sensor in health.sensors] == [None, None]
    assert health.storage.log_damaged_records == 1
    assert 'wayside_tracker_process_restarts_total{process="0"} 3.0' in text
    assert damage_of(database, "radar-1") == [21]  # behind the configuration
    assert damage_of(database, "radar-2") == []

    with running(tracker_that(harm, poison)) as host:  # it is not met again
        submit(host, recording(60)[50:])
        again = frames[19]
        other_boot = dataclasses.replace(again, boot_id="b", sequence=1)
        assert submit(host, [again, other_boot]) == ["rejected"] * 2
        wait_until(lambda: caught_up(host))
        assert host.health().processes[0].restarts == 0
    assert damage_of(database, "radar-1") == [21]


def test_copies_of_a_record_that_is_set_aside_do_no_harm(running, database, monkeypatch):
    monkeypatch.setattr(tracker_processes, "PAUSE_MOST_S", 0.05)
    poison = recording(10)[-1]
    copies = [dataclasses.replace(poison, boot_id=f"b{n}", sequence=n) for n in range(6)]
    with running(tracker_that(lambda: os._exit(9), lambda one: one.time_us == poison.time_us)) as host:
        submit(host, [*recording(10), *copies])  # logged before the first of them is set aside
        wait_until(lambda: host.health().tracking and caught_up(host))
        assert submit(host, [copies[0], poison]) == ["rejected"] * 2
        later = [dataclasses.replace(one, boot_id="b9") for one in recording(15)[10:]]
        assert submit(host, later) == ["accepted"] * 5
        wait_until(lambda: caught_up(host) and host.health().sensors[0].failure is None)
        health = host.health()

    assert health.processes[0].restarts == 3
    assert health.sensors[0].folded_position == 22
    assert damage_of(database, "radar-1") == list(range(11, 18))


def test_a_frame_that_was_held_back_is_set_aside_with_the_record_that_released_it(running, database):
    frames = recording(30)
    order = [*frames[:10], frames[11], frames[10], *frames[12:]]  # 12 waits for 11, and 12 is the poison
    with running(tracker_that(lambda: os._exit(9), lambda frame: frame.sequence == 12)) as host:
        submit(host, order)
        wait_until(lambda: host.health().tracking and caught_up(host))
        wait_until(lambda: host.live.newest("radar-1").folded.number == 30)
        health = host.health()
        text = host.metrics().decode()

    assert health.processes[0].restarts == 3
    assert damage_of(database, "radar-1") == [13]
    assert 'wayside_frames_total{fate="dropped",sensor_id="radar-1"} 1.0' in text


def test_a_sensor_whose_every_record_ends_the_process_stops_and_the_others_go_on(
    running, database, monkeypatch
):
    monkeypatch.setattr(tracker_processes, "PAUSE_MOST_S", 0.05)
    with_second_sensor(database)
    frames = recording(30)
    poison = lambda frame: frame.sensor_id == "radar-1" and frame.sequence >= 10  # noqa: E731
    with running(tracker_that(lambda: os._exit(9), poison)) as host:
        submit(host, frames)
        submit(host, of_second_sensor(frames), "radar-2")
        wait_until(lambda: host.health().sensors[0].failure is not None)
        wait_until(lambda: host.health().tracking and host.live.newest("radar-2").folded.number == 30)
        health = host.health()
        text = host.metrics().decode()
        host.forget("radar-1")  # the one that stopped can be let go
        wait_until(lambda: host.live.newest("radar-1") is None)

    # Behind each gap two frames are held back; they go with the third, which releases them: 11, 14, 17, 20.
    assert health.processes[0].restarts == 12
    assert [s.failure for s in health.sensors] == [
        "the tracker's process ends at every record, last at 20",
        None,
    ]
    assert 'wayside_sensor_failed{sensor_id="radar-1"} 1.0' in text


def test_a_sensor_that_stopped_is_tracked_again_by_an_administrator(running, database, monkeypatch):
    monkeypatch.setattr(tracker_processes, "PAUSE_MOST_S", 0.05)
    poison = lambda frame: frame.sequence is not None and 10 <= frame.sequence < 30  # noqa: E731
    with running(tracker_that(lambda: os._exit(9), poison)) as host:
        submit(host, recording(30))
        wait_until(lambda: host.health().sensors[0].failure is not None)
        assert host.restart("radar-1", skip=True) >= 31 - 20  # behind the last that was set aside
        wait_until(lambda: host.health().tracking and caught_up(host))
        submit(host, recording(10, first=31, start_us=START_US + 30 * PERIOD_US))
        wait_until(lambda: host.live.newest("radar-1").folded is not None)
        wait_until(lambda: host.live.newest("radar-1").folded.number == 40 and caught_up(host))
        (health,) = host.health().sensors
        text = host.metrics().decode()

    assert (health.failure, health.epoch) == (None, 2)
    assert 'wayside_sensor_failed{sensor_id="radar-1"} 0.0' in text
    with reading(database) as reader:
        (event,) = [e for e in list_events(reader, "radar-1").items if e.kind == "tracker_restarted"]
    reason = event.detail["reason"]
    assert reason.startswith(
        "an administrator had what waited for the tracker left out after it failed (the "
    )
    assert reason.endswith("to 31")
    left_out = int(reason.partition("); ")[2].partition(" ")[0])
    assert 11 <= left_out <= 31  # with what the process had folded, but not stored, each time that it ended
    assert f'wayside_frames_total{{fate="expired",sensor_id="radar-1"}} {left_out}.0' in text


def test_the_log_does_not_wait_for_a_sensor_that_stopped_and_was_let_go(running, monkeypatch):
    monkeypatch.setattr(tracker_processes, "PAUSE_MOST_S", 0.05)
    with running(tracker_that(lambda: os._exit(9), lambda frame: frame.sequence >= 10)) as host:
        submit(host, recording(30))
        wait_until(lambda: host.health().sensors[0].failure is not None and host.health().tracking)
        host.forget("radar-1")
        wait_until(lambda: host.live.newest("radar-1") is None)
        assert host._frame_log._released["radar-1"] == host._frame_log.last_position("radar-1") == 31


@pytest.mark.slow
def test_a_process_that_is_stopped_while_idle_is_started_again(running, monkeypatch):
    monkeypatch.setattr(tracker_processes, "HUNG_S", 3.0)
    with running() as host:
        submit(host, recording(5))
        wait_until(lambda: caught_up(host))
        os.kill(pid_of(host), signal.SIGSTOP)
        wait_until(lambda: host.health().processes[0].restarts == 1 and host.health().tracking)
        submit(host, recording(10)[5:])
        wait_until(lambda: caught_up(host) and host.live.newest("radar-1").folded.number == 10)
        assert host.health().storage.log_damaged_records == 0


def test_a_second_host_is_refused_and_the_first_goes_on(running):
    with running() as host:
        with pytest.raises(StorageError, match="another process"), running():
            pass
        assert submit(host, recording(3)) == ["accepted"] * 3
        wait_until(lambda: caught_up(host))


def test_a_host_waits_for_the_processes_of_a_killed_one(tmp_path):
    (tmp_path / "log").mkdir()
    mark = tracker_process._mark(tmp_path / "log")
    tracker_process.fcntl.flock(mark, tracker_process.fcntl.LOCK_SH)
    patience, tracker_process.ORPHANS_S = tracker_process.ORPHANS_S, 0.05
    try:
        with pytest.raises(StorageError, match="earlier run"):
            tracker_process.wait_for_orphans(tmp_path / "log")
    finally:
        tracker_process.ORPHANS_S = patience
        os.close(mark)
    tracker_process.wait_for_orphans(tmp_path / "log")


def test_a_nursery_starts_work_hands_files_over_and_ends_with_its_owner():
    def work(descriptors, arguments):
        os.write(descriptors[0], str(arguments["n"] + 1).encode())

    nursery = Nursery({"add": work})
    reading_end, writing_end = os.pipe()
    pid = nursery.start("add", [writing_end], {"n": 41})
    os.close(writing_end)

    assert os.read(reading_end, 100) == b"42"
    assert os.read(reading_end, 100) == b""
    assert pid not in {os.getpid(), nursery.pid}
    os.close(reading_end)
    nursery.close()
    with pytest.raises(StorageError, match="gone"):
        nursery.start("add", [], {"n": 1})
