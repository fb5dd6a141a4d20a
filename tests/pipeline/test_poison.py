"""A record that ends the whole service, not only its tracker: one that is started again gets past it."""

from __future__ import annotations

import dataclasses
import os
import signal
from pathlib import Path
from types import SimpleNamespace

import pytest

from service.chaos import process
from service.pipeline import tracker_process
from service.pipeline.host import EmbeddedHost
from service.pipeline.nursery import Nursery
from service.settings import Settings
from service.storage import migrate
from service.storage.database import connection, open_database, session_scope
from service.storage.events import list_events
from service.storage.sites import create_sensor, list_sensors
from service.telemetry import set_up_logging
from tests.pipeline import simple_tracker
from tests.pipeline.hosts import caught_up, submit, wait_until
from tests.pipeline.recordings import CONFIG, START_US, fold_records, recording, records

POISON = 20


@pytest.fixture(scope="module", autouse=True)
def _kernels_are_loaded() -> None:
    fold_records(records(recording(60)))


def serve(say: process.Say, data_dir: Path, processes: int, frames) -> None:
    """Run a service whose tracker ends all of it at the poison, post frames, and say what came of them."""
    set_up_logging("error", "json")
    service = os.getpid()

    def step(state, frame, parameters):
        if frame.time_us == recording(POISON)[-1].time_us:
            os.kill(service, signal.SIGKILL)
            os._exit(9)
        return simple_tracker.step(state, frame, parameters)

    tracker = SimpleNamespace(
        initial_state=simple_tracker.initial_state, step=step, coast=simple_tracker.coast
    )
    clock = lambda: START_US  # noqa: E731
    settings = Settings(
        data_dir=data_dir, disk_free_min_share=0.0, clock_ahead_limit_s=1e9, tracker_processes=processes
    )
    database = open_database(settings.rows_url)
    migrate.upgrade(database)
    with connection(database) as reader:
        known = list_sensors(reader).items
    if not known:
        with session_scope(database) as writer:
            create_sensor(writer, CONFIG, now_us=START_US)
    nursery = None
    if processes:
        database.dispose()
        nursery = Nursery({tracker_process.WORK: tracker_process.work_of(settings, tracker, clock)})
    host = EmbeddedHost(database, settings, tracker=tracker, clock_us=clock, nursery=nursery)
    host.start()
    outcomes = submit(host, frames) if frames else []
    wait_until(lambda: caught_up(host))
    newest = host.live.newest("radar-1").folded
    host.stop()
    with connection(database) as reader:
        kinds = [event.kind for event in list_events(reader, "radar-1").items]
    say({"outcomes": outcomes, "number": newest and newest.number, "events": kinds})


@pytest.mark.parametrize("processes", [0, 1], ids=["thread", "process"])
def test_a_record_that_kills_the_whole_service_is_set_aside_after_three_starts(tmp_path, processes):
    def run(frames) -> process.Ended:
        return process.start(lambda say: serve(say, tmp_path, processes, frames)).end()

    frames = recording(40)
    assert run(frames).killed
    assert run([]).killed
    assert run([]).killed

    ended = run([])
    assert ended.said == [{"outcomes": [], "number": 40, "events": ["record_damaged"]}]

    poison = frames[POISON - 1]
    again = run([poison, dataclasses.replace(poison, boot_id="after", sequence=1), *recording(41)[40:]])
    assert again.said == [
        {"outcomes": ["rejected", "rejected", "accepted"], "number": 41, "events": ["record_damaged"]}
    ]
