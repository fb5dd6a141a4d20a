"""A real server in a process of its own, whose disk can be full when the run wants it."""

from __future__ import annotations

import shutil
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import httpx
from sqlalchemy import Engine

from service.api import server
from service.chaos import child, process
from service.chaos.disk import Disk, available
from service.chaos.process import Running, Say
from service.chaos.workload import START_US, Batch, configs
from service.errors import StorageError
from service.formats.json_frames import frame_to_wire
from service.pipeline import sqlite_log
from service.pipeline.host import EmbeddedHost
from service.storage.database import session_scope
from service.storage.sites import create_sensor, list_sensors

FULL, NEARLY_FULL = "full", "nearly-full"  # files in the data directory: while they are there, so is the disk
HTTP_ACCEPTED, HTTP_UNAVAILABLE = 202, 503
PAUSE_S = 0.02
PATIENCE_S = 30.0


def serve(say: Say, data_dir: Path) -> None:
    """Serve on a free port of the loopback until a signal; says the address, or why it was refused."""
    chosen = child.settings(data_dir).model_copy(
        update={"host": "127.0.0.1", "port": 0, "disk_free_min_share": 0.05}
    )
    if available():
        Disk(lambda operation: operation.kind != "write" or not (data_dir / FULL).exists()).install()
    shutil.disk_usage = partial(_disk_usage, data_dir)  # of this process only
    sqlite_log._ROOM_CHECK_S = child.ROOM_CHECK_S  # noqa: SLF001
    server.EmbeddedHost = partial(EmbeddedHost, clock_us=lambda: START_US)  # type: ignore[attr-defined,assignment]
    try:
        server.run(chosen, prepare=_register, on_ready=lambda address: say({"url": address}))
    except StorageError as error:
        say({"refused": str(error)})


def _disk_usage(data_dir: Path, _: Path) -> shutil._ntuple_diskusage:
    free = 4 if (data_dir / NEARLY_FULL).exists() else 50
    return shutil._ntuple_diskusage(100, 100 - free, free)  # noqa: SLF001 - what the original returns


def _register(engine: Engine) -> None:
    with session_scope(engine) as connection:
        known = {sensor.sensor_id for sensor in list_sensors(connection).items}
        for config in configs():
            if config.sensor_id not in known:
                create_sensor(connection, config, now_us=START_US)


@contextmanager
def serving(data_dir: Path) -> Iterator[tuple[Running, httpx.Client]]:
    """Yield a server on a data directory and a client of it; the server is told to stop by the caller."""
    running = process.start(lambda say: serve(say, data_dir))
    said = running.listen(until=lambda message: "url" in message)
    if not said or "url" not in said[-1]:
        raise StorageError(f"the server did not start: {said}")
    with httpx.Client(base_url=str(said[-1]["url"]), timeout=PATIENCE_S) as client:
        try:
            yield running, client
        except BaseException:
            running.send(signal.SIGKILL)
            raise


def post(client: httpx.Client, batch: Batch) -> httpx.Response:
    """Post one batch and return the reply."""
    body = [frame_to_wire(frame) for frame in batch.frames]
    return client.post(f"/api/v1/sensors/{batch.sensor_id}/frames:batch", json=body)


def post_all(client: httpx.Client, work: Sequence[Batch]) -> int:
    """Post batches, each again while the service is unavailable; return how often it was."""
    refused = 0
    deadline_s = time.monotonic() + PATIENCE_S
    for batch in work:
        while (reply := post(client, batch)).status_code == HTTP_UNAVAILABLE:
            refused += 1
            if time.monotonic() > deadline_s:
                raise StorageError(f"the service does not recover: {reply.text}")
            time.sleep(PAUSE_S)
        reply.raise_for_status()
    return refused
