"""Run a host on a data directory and post frames of a recording to it, one line of output a durable frame.

    python -m tests.pipeline.crash_host DATA_DIR FIRST LAST TRACKER_PROCESSES

The simple tracker stands in for the real one: what is tested is that nothing is lost or doubled.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from service.pipeline import tracker_process
from service.pipeline.host import EmbeddedHost
from service.pipeline.nursery import Nursery
from service.settings import Settings
from service.storage import migrate
from service.storage.database import connection, open_database, session_scope
from service.storage.sites import create_sensor, list_sensors
from service.telemetry import set_up_logging
from tests.pipeline import simple_tracker
from tests.pipeline.recordings import CONFIG, START_US, recording

FRAMES = 400


def main(data_dir: Path, first: int, last: int, processes: int) -> None:
    settings = Settings(
        data_dir=data_dir,
        disk_free_min_share=0.0,
        clock_ahead_limit_s=1e9,
        flush_interval_s=0.02,
        snapshot_interval_s=0.1,
        snapshot_frames=50,
        tracker_processes=processes,
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
        nursery = Nursery(
            {tracker_process.WORK: tracker_process.work_of(settings, simple_tracker, lambda: START_US)}
        )
    host = EmbeddedHost(
        database, settings, tracker=simple_tracker, clock_us=lambda: START_US, nursery=nursery
    )
    host.start()
    for frame in recording(FRAMES)[first - 1 : last]:
        (result,) = asyncio.run(host.submit("radar-1", [frame]))
        sys.stdout.write(f"{frame.sequence} {result.outcome.value}\n")
        sys.stdout.flush()
    host.stop()
    database.dispose()


if __name__ == "__main__":
    set_up_logging("error")
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
