"""Append to a log, cut the power right after the acknowledgement, print what the log holds after that.

python -m tests.chaos.power_cut FOLDER FULL|OFF
"""

from __future__ import annotations

import os
import sqlite3
import sys
from pathlib import Path

from service.chaos.disk import Disk
from service.pipeline.records import FrameRecord
from service.pipeline.sqlite_log import LogLimits, SqliteLog
from tests.pipeline.recordings import recording


def main(folder: Path, synchronous: str) -> None:
    disk = Disk(lambda _: True)
    disk.install()
    log = SqliteLog(folder, LogLimits(free_share=0.0))
    log._active()._writer.execute(f"PRAGMA synchronous = {synchronous}")
    for frame in recording(5):
        log.append("radar-1", [FrameRecord(frame, 0)])
    sys.stdout.write(f"{disk.syncs}\n")
    sys.stdout.flush()
    disk.lose(None)
    os._exit(0)


if __name__ == "__main__":
    assert sqlite3.threadsafety
    main(Path(sys.argv[1]), sys.argv[2])
