"""The process that is cut: a host on a data directory, to which it posts what is left of the workload."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path

from service.chaos.cut import Cutter, Plan
from service.chaos.process import Say
from service.chaos.workload import START_US, Batch, configs
from service.errors import Unavailable
from service.pipeline import sqlite_log, tracker_process
from service.pipeline.host import EmbeddedHost
from service.pipeline.nursery import Nursery
from service.settings import Settings
from service.storage import migrate
from service.storage.database import connection, open_database, session_scope
from service.storage.sites import create_sensor, list_sensors
from service.tracking import tracker

RETRY_S = 0.005
ROOM_CHECK_S = 0.02  # a second in the service; here the log fills a hundred times as fast
LOG_BYTES = 2 * 2**20  # of eight files: small enough that some are dropped on the way


def settings(data_dir: Path, processes: int = 0) -> Settings:
    """Return settings under which a short run meets all that a long one does.

    processes: that track; none, so that the layer below SQLite sees every write.
    """
    return Settings(
        _env_file=None,
        data_dir=data_dir,
        database_url=None,
        disk_free_min_share=0.0,
        clock_ahead_limit_s=1e9,
        flush_interval_s=0.02,
        snapshot_interval_s=0.1,
        snapshot_frames=40,
        log_limit_bytes=LOG_BYTES,
        tracker_processes=processes,
    )


def post(  # noqa: PLR0913 - what distinguishes one run from another
    say: Say,
    data_dir: Path,
    work: Sequence[Batch],
    first: int,
    *,
    plan: Plan | None = None,
    processes: int = 0,
    clock_us: Callable[[], int] = lambda: START_US,
) -> None:
    """Post the batches from `first` on, say what became of each, and stop in order unless cut before."""
    cutter = Cutter(plan)
    cutter.install()
    sqlite_log._ROOM_CHECK_S = ROOM_CHECK_S  # noqa: SLF001
    chosen = settings(data_dir, processes)
    if processes:
        cutter.lead_group()
    database = open_database(chosen.rows_url)
    cutter.migrating = True
    migrate.upgrade(database)
    cutter.migrating = False
    with connection(database) as reader:
        known = {sensor.sensor_id for sensor in list_sensors(reader).items}
    for config in configs():
        if config.sensor_id not in known:
            with session_scope(database) as writer:
                create_sensor(writer, config, now_us=START_US)
    nursery = None
    if processes:
        database.dispose()  # nothing open when processes are forked
        nursery = _nursery(chosen, cutter, clock_us)
    host = EmbeddedHost(database, chosen, clock_us=clock_us, nursery=nursery)
    cutter.trackers = lambda: [one.pid for one in host.tracker_processes() if one.running and one.pid]
    host.start()
    for index in range(first, len(work)):
        outcomes = asyncio.run(_submit(host, work[index]))
        say({"batch": index, "outcomes": outcomes})
    host.stop()
    if nursery is not None:
        nursery.close()
    database.dispose()
    seen = {str(name): count for name, count in cutter.seen.items()}
    say({"done": True, "seen": seen, "watched": cutter.disk is not None, "cut": cutter.done})


def _nursery(chosen: Settings, cutter: Cutter, clock_us: Callable[[], int]) -> Nursery:
    work = tracker_process.work_of(chosen, tracker, clock_us)

    def watched(descriptors: list[int], arguments: dict[str, object]) -> None:
        cutter.enter_tracker()
        work(descriptors, arguments)

    return Nursery({tracker_process.WORK: watched})


async def _submit(host: EmbeddedHost, batch: Batch) -> list[str]:
    while True:
        try:
            results = await host.submit(batch.sensor_id, batch.frames)
        except Unavailable:
            await asyncio.sleep(RETRY_S)
        else:
            return [result.outcome.value for result in results]
