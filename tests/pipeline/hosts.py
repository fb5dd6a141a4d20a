"""Post to a host under test, wait for it, and read what it stored."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from sqlalchemy import Engine, select

from service.pipeline.host import EmbeddedHost
from service.storage.database import connection as reading
from service.storage.tables import snapshots, track_states, tracks
from tests.pipeline import simple_tracker
from tests.pipeline.recordings import all_rows, fold_records, recording, records


def submit(host: EmbeddedHost, frames, sensor_id: str = "radar-1") -> list[str]:
    return [result.outcome.value for result in asyncio.run(host.submit(sensor_id, frames))]


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < deadline, "the condition did not come true in 30 s"
        time.sleep(0.002)  # yields to the threads of the host


def caught_up(host: EmbeddedHost) -> bool:
    return all(s.stored_position == s.logged_position for s in host.health().sensors)


def stored_rows(database: Engine) -> tuple[list, list]:
    """What the database holds of tracks and states, without log positions and storage days."""
    with reading(database) as reader:
        summaries = [
            tuple(v for k, v in row._mapping.items() if k not in {"as_of", "stored_day"})
            for row in reader.execute(tracks.select().order_by(tracks.c.epoch, tracks.c.number))
        ]
        order = (track_states.c.epoch, track_states.c.number, track_states.c.second)
        blocks = [tuple(row) for row in reader.execute(track_states.select().order_by(*order))]
    return summaries, blocks


def folded_rows(frames) -> tuple[int, int]:
    rows = all_rows(fold_records(records(frames))[1])
    return len(rows.tracks), len(rows.blocks)


def stored_position(database: Engine) -> int:
    """Return up to where of the log the rows of radar-1 are stored."""
    with reading(database) as reader:
        return int(reader.execute(select(snapshots.c.position)).scalar_one())


class SlowTracker:
    """The small tracker, at ten frames a second."""

    initial_state = staticmethod(simple_tracker.initial_state)
    coast = staticmethod(simple_tracker.coast)

    @staticmethod
    def step(*args) -> tuple:
        time.sleep(0.1)
        return simple_tracker.step(*args)


def check_that_a_stop_in_a_backlog_loses_nothing(running, database: Engine) -> None:
    """Stop a slow tracker that has no time left, and let a quick one fold the rest."""
    frames = recording(60)
    with running(SlowTracker()) as host:
        assert submit(host, frames) == ["accepted"] * 60
    assert stored_position(database) < 60
    database.dispose()  # a connection must not be shared with a fork
    with running() as host:
        wait_until(lambda: caught_up(host))
        assert host.live.newest("radar-1").epoch == 1

    summaries, blocks = stored_rows(database)
    assert (len(summaries), len(blocks)) == folded_rows(frames)
