"""Exports from processes of their own: the same bytes, and a process that ends early is told."""

from __future__ import annotations

import asyncio
import os
import signal

import numpy as np
import pytest

from service.api import exports, tracks
from service.api.exports import Exports, joined
from service.errors import StorageError
from service.formats.sensor import SensorConfig
from service.pipeline.nursery import Nursery
from service.storage import migrate
from service.storage.database import open_database, session_scope
from service.storage.rows import STATE_SAMPLE, StateBlock, TrackKey
from service.storage.shards import begin_epoch
from service.storage.sites import create_sensor
from service.storage.tracks import save_blocks

SECONDS, TRACKS, BLOCK = 40, 20, 20
WINDOW = {"sensor_id": "radar-1", "start_us": 0, "end_us": tracks.LAST_US}


@pytest.fixture
def engine(tmp_path):
    """A database with states of twenty tracks."""
    opened = open_database(f"sqlite:///{tmp_path}/rows.sqlite")
    migrate.upgrade(opened)
    samples = np.zeros(BLOCK, STATE_SAMPLE)
    samples["frame_offset"] = np.arange(BLOCK)
    samples["time_offset_ms"] = np.arange(BLOCK) * 50
    samples["x_m"] = np.random.default_rng(1).normal(0, 30, BLOCK)
    with session_scope(opened) as writer:
        create_sensor(writer, SensorConfig(sensor_id="radar-1"), now_us=1)
        begin_epoch(writer, "radar-1", first_position=1, reason="test", time_us=1, now_us=1)
        for second in range(SECONDS):
            blocks = [
                StateBlock(
                    TrackKey("radar-1", 1, n + 1), 1_747_000_000 + second, BLOCK * second, samples.tobytes()
                )
                for n in range(TRACKS)
            ]
            save_blocks(writer, blocks, now_us=1)
    opened.dispose()
    yield opened
    opened.dispose()


@pytest.fixture
def nursery(engine):
    made = Nursery({exports.WORK: exports.work_of(engine.url.render_as_string())})
    yield made
    made.close()


async def collect(reply) -> list[bytes]:
    return [piece async for piece in reply.body_iterator]


def export(engine, nursery, form) -> list[bytes]:
    return asyncio.run(collect(Exports(engine, nursery).stream("states", {"form": form, **WINDOW}, "x/y")))


def test_pieces_are_joined_without_a_byte_lost():
    pieces = [bytes([k % 256]) * 1000 for k in range(200)]

    found = list(joined(iter(pieces)))

    assert b"".join(found) == b"".join(pieces)
    assert all(len(piece) >= exports.PIECE_BYTES for piece in found[:-1])
    assert list(joined(iter(()))) == []


@pytest.mark.parametrize("form", ["ndjson", "csv"])
def test_a_process_exports_the_bytes_that_a_thread_does(engine, nursery, form):
    in_process, in_thread = export(engine, nursery, form), export(engine, None, form)

    assert b"".join(in_process) == b"".join(in_thread)
    assert b"".join(in_thread).count(b"\n") >= SECONDS * BLOCK
    assert len(in_process) < SECONDS * BLOCK / 5  # far fewer pieces than lines


def test_a_process_that_is_killed_cuts_the_export_off(engine, nursery):
    pids = []
    start = nursery.start
    nursery.start = lambda *arguments: pids.append(start(*arguments)) or pids[-1]

    async def run():
        reply = Exports(engine, nursery).stream("states", {"form": "ndjson", **WINDOW}, "x/y")
        async for _ in reply.body_iterator:
            os.kill(pids[0], signal.SIGKILL)

    with pytest.raises(StorageError, match="before its time"):
        asyncio.run(run())


def test_an_export_that_nobody_reads_on_lets_go_of_its_place(engine, nursery):
    made = Exports(engine, nursery)

    async def run():
        pieces = made.stream("states", {"form": "ndjson", **WINDOW}, "x/y").body_iterator
        await anext(pieces)
        assert made.running == 1
        await pieces.aclose()

    asyncio.run(run())
    assert made.running == 0


def test_without_processes_left_a_thread_goes_on(engine, nursery):
    nursery.close()

    assert b"".join(export(engine, nursery, "ndjson")) == b"".join(export(engine, None, "ndjson"))
