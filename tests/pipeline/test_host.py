from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import math
import sqlite3
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import structlog
from sqlalchemy import Engine, delete, update

from service.errors import NotFound, StorageError, Unavailable
from service.formats.columnar import encode_frame
from service.formats.tracks import stored_line
from service.pipeline import flushing, folding, tracker_thread
from service.pipeline.channel import open_channel
from service.pipeline.door import Outcome
from service.pipeline.fold import TICK_US
from service.pipeline.folding import TICK_GRACE_US
from service.pipeline.host import EmbeddedHost
from service.pipeline.offline import track
from service.pipeline.records import FrameRecord
from service.pipeline.sqlite_log import LogLimits, SqliteLog
from service.settings import Settings
from service.storage import migrate
from service.storage.database import connection as reading
from service.storage.database import open_database, session_scope
from service.storage.events import list_events
from service.storage.shards import load_shard
from service.storage.sites import create_sensor, update_sensor
from service.storage.states import stream_states
from service.storage.tables import snapshots
from service.storage.tracks import save_blocks, save_summaries
from service.telemetry import Telemetry, set_up_logging
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
    frame,
    pausing_recording,
    recording,
)

SECOND_US = 1_000_000


@pytest.fixture(autouse=True)
def _short_log_lines() -> Iterator[None]:
    """A rendered traceback with all its values takes seconds."""
    set_up_logging("warning", "json")
    yield
    structlog.reset_defaults()


class Clock:
    """A wall clock that stands until it is moved."""

    def __init__(self) -> None:
        self.now_us = START_US + SECOND_US

    def __call__(self) -> int:
        return self.now_us


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Engine]:
    engine = open_database(f"sqlite:///{tmp_path}/rows.sqlite")
    migrate.upgrade(engine)
    with session_scope(engine) as writer:
        create_sensor(writer, CONFIG, now_us=START_US)
    yield engine
    engine.dispose()


@pytest.fixture
def running(
    database: Engine, tmp_path: Path, clock: Clock
) -> Callable[..., contextlib.AbstractContextManager]:
    """Return a context manager of a host that runs on the test's data directory."""

    @contextlib.contextmanager
    def run(tracker=simple_tracker, **changes: object) -> Iterator[EmbeddedHost]:
        values = {"flush_interval_s": 0.01, "disk_free_min_share": 0.0, "clock_ahead_limit_s": 1e9}
        settings = Settings(data_dir=tmp_path, **(values | changes))
        host = EmbeddedHost(database, settings, tracker=tracker, clock_us=clock)
        host.start()
        try:
            yield host
        finally:
            host.stop()

    return run


def let_time_pass(host: EmbeddedHost, clock: Clock) -> None:
    """Move the clock on, second by second, until no track is left."""
    channel = host._trackers.channels["radar-1"]
    wait_until(lambda: caught_up(host))
    while not channel.state.quiet:
        ticks = channel.state.ticks
        clock.now_us += SECOND_US
        host._trackers.wake()
        waiting = clock.now_us - channel.heard_us < (ticks + 1) * TICK_US + TICK_GRACE_US
        wait_until(lambda ticks=ticks, waiting=waiting: waiting or channel.state.ticks > ticks)
    wait_until(lambda: caught_up(host))


def test_frames_are_tracked_served_and_stored(running, database):
    frames = recording(50)
    with running() as host:
        assert submit(host, frames) == ["accepted"] * 50
        wait_until(lambda: caught_up(host))

        entry = host.live.newest("radar-1")
        assert entry.folded.number == 50
        assert list(entry.folded.estimates.number) == [1, 2]
        assert len(entry.points_from.frame) == 2
        (health,) = host.health().sensors
        assert (health.state, health.queue_depth, health.failure) == ("live", 0, None)

    summaries, blocks = stored_rows(database)
    assert (len(summaries), len(blocks)) == folded_rows(frames)


def test_the_live_view_wakes_a_reader_when_a_frame_was_tracked(running):
    async def run(host: EmbeddedHost) -> int:
        await host.submit("radar-1", recording(1))
        version = 0
        while version < 2:
            version = (await host.live.wait("radar-1", version, 20.0)).version
        return version

    with running() as host:
        assert asyncio.run(run(host)) == 2  # the configuration is the first record


def test_the_reply_tells_repeats_late_frames_and_conflicts(running):
    frames = recording(6)
    other = dataclasses.replace(frames[5], snr_db=frames[5].snr_db + 1)
    with running() as host:
        assert submit(host, [*frames[:2], *frames[3:]]) == ["accepted"] * 5
        assert submit(host, [frames[0], frames[2], other]) == ["duplicate", "late", "conflict"]


def test_frames_of_another_sensor_or_of_the_far_future_are_rejected(running, clock):
    ahead = frame(2, clock.now_us + 61 * SECOND_US)
    strange = dataclasses.replace(frame(1, START_US), sensor_id="radar-9")
    with running() as host:
        host._door._ahead_limit_s = 60.0
        results = asyncio.run(host.submit("radar-1", [strange, ahead, frame(1, START_US)]))

    assert [result.outcome for result in results] == [Outcome.REJECTED, Outcome.REJECTED, Outcome.ACCEPTED]
    assert "radar-9" in results[0].reason
    assert "61 s ahead" in results[1].reason


def test_an_unknown_sensor_is_not_found(running):
    with running() as host, pytest.raises(NotFound):
        submit(host, recording(1), "radar-7")


def test_a_stop_does_not_wait_for_a_long_backlog(running, database, monkeypatch):
    monkeypatch.setattr(tracker_thread, "DRAIN_S", 0.0)

    check_that_a_stop_in_a_backlog_loses_nothing(running, database)


def test_a_restart_goes_on_where_it_stopped(running, database):
    frames = recording(60)
    with running() as host:
        submit(host, frames[:30])
    with running() as host:
        assert submit(host, [frames[29]]) == ["duplicate"]
        submit(host, frames[30:])
        wait_until(lambda: caught_up(host))
        assert host.live.newest("radar-1").epoch == 1
        assert list(host.live.newest("radar-1").folded.estimates.number) == [1, 2]

    summaries, blocks = stored_rows(database)
    assert (len(summaries), len(blocks)) == folded_rows(frames)


def test_the_records_of_a_sensor_that_fell_silent_may_be_dropped(running, database):
    with running(snapshot_interval_s=0.8) as host:
        submit(host, recording(30))
        wait_until(lambda: caught_up(host))
        last = host._frame_log.last_position("radar-1")

        # By itself, with no further frame: else the log fills up behind these records and refuses everybody.
        wait_until(lambda: host._frame_log._released.get("radar-1") == last)
        with reading(database) as reader:
            assert load_shard(reader, "radar-1").snapshot.position == last


def test_a_restart_lets_go_of_what_the_snapshot_covers_before_any_frame(running):
    with running() as host:
        submit(host, recording(30))
        last = host._frame_log.last_position("radar-1")
    with running() as host:
        assert host._frame_log._released == {"radar-1": last}


def test_without_a_snapshot_the_first_epoch_is_folded_again_from_the_log(running, database):
    frames = recording(60)
    with running() as host:
        submit(host, frames)
    before = stored_rows(database)
    with session_scope(database) as writer:
        writer.execute(delete(snapshots))

    with running() as host:
        wait_until(lambda: caught_up(host) and host.health().sensors[0].queue_depth == 0)
        assert host.live.newest("radar-1").folded.number == 60

    assert stored_rows(database) == before
    with reading(database) as reader:
        assert load_shard(reader, "radar-1").epoch == 1
        assert not list_events(reader, "radar-1").items


def test_an_unreadable_snapshot_of_a_lost_log_begins_an_epoch_with_an_event(running, database, tmp_path):
    with running() as host:
        submit(host, recording(30))
    for path in (tmp_path / "log").glob("segment-*"):
        path.unlink()

    later = recording(30, first=31, start_us=START_US + 30 * PERIOD_US)
    with running() as host:
        submit(host, later)
        wait_until(lambda: caught_up(host))
        assert host.live.newest("radar-1").epoch == 2
        assert host.live.newest("radar-1").version == 31 + 1 + 30

    with reading(database) as reader:
        (event,) = list_events(reader, "radar-1").items
    assert (event.kind, event.epoch) == ("tracker_restarted", 2)
    assert "the log ends at position 0" in event.detail["reason"]


def test_a_snapshot_of_another_build_begins_an_epoch_once_the_log_was_shortened(running, database, tmp_path):
    with running() as host:
        submit(host, recording(30))
    with session_scope(database) as writer:
        writer.execute(update(snapshots).values(state=b"of another build"))
    (segment,) = (tmp_path / "log").glob("segment-*.sqlite")
    with contextlib.closing(sqlite3.connect(segment)) as shortened, shortened:
        shortened.execute("DELETE FROM record WHERE position < 10")

    with running() as host:
        submit(host, recording(3, first=31, start_us=START_US + 30 * PERIOD_US))
        wait_until(lambda: caught_up(host))
        assert host.live.newest("radar-1").epoch == 2


def test_a_changed_configuration_is_taken_over_between_frames(running, database):
    changed = CONFIG.model_copy(update={"filter": "ekf"})
    with running() as host:
        submit(host, recording(5))
        with session_scope(database) as writer:
            sensor = update_sensor(writer, "radar-1", {"config": changed}, now_us=START_US)
        host.configure(sensor)
        assert host.config("radar-1") == changed
        wait_until(lambda: caught_up(host))
        assert host._trackers.channels["radar-1"].state.config == changed.canonical_json()

    with running() as host:  # and after a restart no second record of it is needed
        assert host.health().sensors[0].logged_position == 7


def test_a_configuration_changed_while_the_host_was_down_is_logged_at_the_start(running, database):
    changed = CONFIG.model_copy(update={"filter": "ekf"})
    with running() as host:
        submit(host, recording(5))
    with session_scope(database) as writer:
        update_sensor(writer, "radar-1", {"config": changed}, now_us=START_US)

    with running() as host:
        wait_until(lambda: caught_up(host))
        assert host._trackers.channels["radar-1"].state.config == changed.canonical_json()


def test_silence_ends_tracks_by_ticks(running, database, clock):
    with running() as host:
        submit(host, recording(30))
        let_time_pass(host, clock)
        assert len(host.live.newest("radar-1").folded.estimates) == 0
        logged = host.health().sensors[0].logged_position

        clock.now_us += 60 * SECOND_US
        host._trackers.wake()
        assert host.health().sensors[0].logged_position == logged

    summaries, _ = stored_rows(database)
    assert all(row[3] for row in summaries)


def test_the_host_stores_the_same_bytes_as_the_file_gives(running, database, clock, tmp_path):
    frames = pausing_recording()
    with running() as host:
        for one in frames:
            clock.now_us = max(clock.now_us, one.time_us)
            submit(host, [one])
        let_time_pass(host, clock)
    live = stored_rows(database)
    served = [
        stored_line("radar-1", one.epoch, one.frame, one.time_us, one.states)
        for one in stream_states(database, "radar-1", START_US, START_US + 3600 * SECOND_US)
    ]

    offline = open_database(f"sqlite:///{tmp_path}/offline.sqlite")
    migrate.upgrade(offline)
    found = track(frames, CONFIG, tracker=simple_tracker)
    rows = found.rows
    with session_scope(offline) as writer:
        create_sensor(writer, CONFIG, now_us=START_US)
        save_blocks(writer, rows.blocks, now_us=clock.now_us)
        save_summaries(writer, rows.tracks, now_us=clock.now_us)

    assert live == stored_rows(offline)
    assert len(live[0]) == 4
    assert served == [line for line, scan in zip(found.lines(), found, strict=True) if len(scan.estimates)]
    offline.dispose()


def test_one_failing_sensor_does_not_stop_the_others(running, database):
    def fail(state, one, parameters) -> tuple:
        if one.sensor_id == "radar-1" and one.sequence == 3:
            raise ZeroDivisionError("made up")
        return simple_tracker.step(state, one, parameters)

    failing = SimpleNamespace(
        initial_state=simple_tracker.initial_state, step=fail, coast=simple_tracker.coast
    )
    other = CONFIG.model_copy(update={"sensor_id": "radar-2"})
    with session_scope(database) as writer:
        create_sensor(writer, other, now_us=START_US)
    with running(failing) as host:
        submit(host, recording(5))
        submit(host, [dataclasses.replace(f, sensor_id="radar-2") for f in recording(5)], "radar-2")
        wait_until(lambda: host.live.newest("radar-2").version == 6)
        wait_until(lambda: host._trackers.channels["radar-1"].failure is not None)
        failures = {s.sensor_id: s.failure for s in host.health().sensors}

    assert failures["radar-2"] is None
    assert failures["radar-1"] == "record 4: ZeroDivisionError: made up"


def test_a_sensor_waits_while_its_log_cannot_be_read_and_goes_on_by_itself(database, tmp_path):
    log = SqliteLog(tmp_path / "log", LogLimits(segment_bytes=65_536, free_share=0.0))
    channel = open_channel(database, log, CONFIG, simple_tracker, now_us=START_US, now_s=0.0)
    frames = [FrameRecord(one, 0, encode_frame(one)) for one in recording(200)]
    for first in range(0, 200, 20):
        log.append("radar-1", frames[first : first + 20])
    assert log.file_count() > 2
    views = SimpleNamespace(show=lambda *_, **__: None, gone=lambda _: None)
    fold = folding.Folding(
        database, log, views, simple_tracker, Telemetry(), pace=folding.Pace(), clock_us=lambda: START_US
    )
    fold.add(channel)
    before, now_s = channel.state, time.monotonic()
    obstacle = tmp_path / "log" / "segment-00000001.sqlite-wal"
    obstacle.mkdir()

    with structlog.testing.capture_logs() as logs:
        assert not fold.take_turns()
        assert channel.read_again_s >= now_s + 1.0  # not again at every turn
        channel.read_again_s = now_s
        assert not fold.take_turns()
        channel.read_again_s = math.inf
        obstacle.rmdir()
        assert not fold.take_turns()
    assert channel.state is before
    assert channel.failure is None
    assert [entry["event"] for entry in logs] == ["records not read, will try again"]

    channel.read_again_s = now_s
    while fold.take_turns():
        pass
    assert channel.state.position == log.last_position("radar-1") == 200
    assert channel.failure is None
    log.close()


def test_a_record_is_set_aside_although_its_log_cannot_be_read(running, tmp_path):
    frames = recording(60)
    with running(log_segment_bytes=65_536) as host:
        for first in range(0, 60, 20):
            submit(host, frames[first : first + 20])
        wait_until(lambda: caught_up(host))
        assert host._frame_log.file_count() > 2
        obstacle = tmp_path / "log" / "segment-00000002.sqlite-wal"  # the first one holds the configuration
        obstacle.mkdir()
        deaths = [host._blames.died_at("radar-1", 2) for _ in range(3)]
        obstacle.rmdir()

        assert deaths == [False, False, True]
        assert host._blames.of("radar-1").digests == []


def test_a_damaged_record_leaves_an_event_and_holds_nobody_up(running, database, tmp_path):
    with running() as host:
        submit(host, recording(10))
    with session_scope(database) as writer:
        writer.execute(delete(snapshots))  # so that all is folded again
    (segment,) = (tmp_path / "log").glob("segment-*.sqlite")
    with contextlib.closing(sqlite3.connect(segment)) as log, log:
        log.execute("UPDATE record SET body = zeroblob(length(body)) WHERE position BETWEEN 3 AND 8")

    with running() as host:
        submit(host, recording(5, first=11, start_us=START_US + 10 * PERIOD_US))
        wait_until(lambda: caught_up(host) and host.health().sensors[0].queue_depth == 0)
        assert host.health().storage.log_damaged_records >= 6
        assert host.live.newest("radar-1").folded.number == 15

    with reading(database) as reader:
        events = list_events(reader, "radar-1").items
    assert [event.kind for event in events] == ["record_damaged"] * 6
    assert [event.detail["position"] for event in events] == [3, 4, 5, 6, 7, 8]


def test_the_flushes_of_many_sensors_are_spread(running, database, monkeypatch):
    names = [f"radar-{n}" for n in range(1, 11)]
    with session_scope(database) as writer:
        for name in names[1:]:
            create_sensor(writer, CONFIG.model_copy(update={"sensor_id": name}), now_us=START_US)
    flushes = []

    def note(engine, channels, snapshots, *, now_us):
        flushes.append([channel.sensor_id for channel in channels])
        return flushing.store(engine, channels, snapshots, now_us=now_us)

    monkeypatch.setattr(folding, "store", note)
    with running(flush_interval_s=0.2) as host:
        for name in names:
            submit(host, [dataclasses.replace(f, sensor_id=name) for f in recording(5)], name)
        wait_until(lambda: caught_up(host))
        spread = list(flushes)

    assert {name for flush in spread for name in flush} == set(names)
    assert max(map(len, spread)) <= 2  # a fifth of them


def test_a_forgotten_sensor_takes_no_frames_and_what_it_sent_is_stored(running, database):
    with running() as host:
        submit(host, recording(30))
        host.forget("radar-1")
        with pytest.raises(NotFound):
            submit(host, recording(1))
        wait_until(lambda: host.live.newest("radar-1") is None)

    assert len(stored_rows(database)[0]) == 2


def test_a_full_log_refuses_and_the_frames_may_come_again(running):
    frames = recording(4)
    with running() as host:
        submit(host, frames[:2])
        host._frame_log._refusal = "the log is full"
        host._frame_log._room_checked_s = time.monotonic() + 60
        with pytest.raises(Unavailable, match="full"):
            submit(host, frames[2:])
        host._frame_log._refusal = None

        assert submit(host, frames[2:]) == ["accepted", "accepted"]


def test_a_second_host_on_the_same_data_is_refused(running):
    with running(), pytest.raises(StorageError, match="another process"), running():
        pass


def test_a_clock_set_back_opens_an_epoch_in_the_database(running, database):
    behind = recording(30, first=31, start_us=START_US - 1000 * SECOND_US)
    with running() as host:
        submit(host, [*recording(30), *behind])
        wait_until(lambda: caught_up(host))
        assert host.live.newest("radar-1").epoch == 2

    with reading(database) as reader:
        shard = load_shard(reader, "radar-1")
        (event,) = list_events(reader, "radar-1").items
    assert (shard.epoch, shard.epoch_first_position) == (2, 34)
    assert event.detail["reason"] == "the sensor's clock was set back"

    with running() as host:
        submit(host, recording(5, first=61, start_us=behind[-1].time_us + PERIOD_US))
        wait_until(lambda: caught_up(host))
        assert host.live.newest("radar-1").epoch == 2


def test_the_metrics_tell_frames_by_fate(running):
    frames = recording(6)
    with running() as host:
        submit(host, [*frames[:2], *frames[3:], frames[0], frames[2]])
        wait_until(lambda: caught_up(host))
        host.health()
        text = host.telemetry.text().decode()

    assert 'wayside_frames_total{fate="tracked",sensor_id="radar-1"} 3.0' in text
    assert 'wayside_frames_total{fate="held",sensor_id="radar-1"} 2.0' in text
    assert 'wayside_frames_total{fate="duplicate",sensor_id="radar-1"} 1.0' in text
    assert 'wayside_frames_total{fate="late",sensor_id="radar-1"} 1.0' in text
    assert 'wayside_frames_missing_total{sensor_id="radar-1"} 1.0' in text
    assert 'wayside_tracks{sensor_id="radar-1",status="confirmed"} 2.0' in text
