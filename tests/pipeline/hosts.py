"""Post to a host under test, wait for it, and read what it stored."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from sqlalchemy import Engine

from service.pipeline.host import EmbeddedHost
from service.storage.database import connection as reading
from service.storage.tables import track_states, tracks
from tests.pipeline.recordings import all_rows, fold_records, records


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
