"""Measure how many bytes one stored track state costs, indexes and track rows included, and one logged frame.

    python benchmarks/storage_size.py [--minutes 10] [--sensors 1] [--life 12.0] [--points 120] [--json]

Writes through `save_flush`, a second at a time, as the host does: tracks with measurement noise at 20 Hz that
come and go (`--life` seconds each, so that first and last blocks are cut). Then moves the journal into the
file and looks at its size. The log gets frames of 0.5 to 1.5 times `--points` points, one a commit.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sqlite3
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from sqlalchemy import Engine, text

from benchmarks.commit import commit
from service.formats.sensor import SensorConfig
from service.pipeline.codec import encode_record
from service.pipeline.records import FrameRecord
from service.pipeline.sqlite_log import LogLimits, SqliteLog
from service.storage.database import open_database, session_scope
from service.storage.migrate import upgrade
from service.storage.rows import STATE_SAMPLE, Rows, StateBlock, TrackKey, TrackSummary
from service.storage.shards import Snapshot, begin_epoch, save_flush, save_snapshot
from service.storage.sites import create_sensor
from service.tracking.model import Frame

RATE_HZ = 20
TRACKS = 60
START_S = 1_747_000_000
BAR_BYTES_PER_STATE = 30.0
SEED = 1
SNAPSHOT_EVERY_S = 10
LOG_FRAMES = 2000
SNAPSHOT_BYTES = 170_000  # a state of 60 tracks


@dataclass(frozen=True, slots=True)
class Load:
    """What is written."""

    seconds: int
    sensors: int
    tracks: int
    life_s: float
    snapshot_bytes: int = SNAPSHOT_BYTES
    points: int = 120


@dataclass(frozen=True, slots=True)
class Result:
    """What it cost."""

    states: int
    tracks: int
    file_bytes: int
    empty_bytes: int  # of the file before the first row: a page for each table and index
    bytes_per_state: float  # without them
    flush_ms: float  # mean of one sensor's second
    log_bytes_per_frame: float
    log_overhead: float  # file bytes a byte of frame
    log_mb_per_sensor_hour: float
    rows_mb_per_sensor_hour: float


class Traffic:
    """Endless tracks of one sensor: a slot of the road takes a new vehicle as soon as one has left."""

    def __init__(self, sensor_id: str, load: Load, rng: np.random.Generator) -> None:
        self.sensor_id, self.load, self.rng = sensor_id, load, rng
        phase = rng.uniform(0, load.life_s, load.tracks)
        self.born_frame = -np.round(phase * RATE_HZ).astype(int)
        self.number = np.arange(1, load.tracks + 1)
        self.next_number = load.tracks + 1

    def second(self, index: int) -> Rows:
        """Return the blocks and summaries of one second."""
        blocks: list[StateBlock] = []
        summaries: list[TrackSummary] = []
        life = round(self.load.life_s * RATE_HZ)
        for slot in range(self.load.tracks):
            first, end = index * RATE_HZ, (index + 1) * RATE_HZ
            while first < end:
                last = min(end, self.born_frame[slot] + life)
                if last > first:
                    blocks.append(self._block(slot, index, first, last))
                    summaries.append(self._summary(slot, int(last) - 1, ended=last < end))
                if last < end:
                    self.born_frame[slot], self.number[slot] = last, self.next_number
                    self.next_number += 1
                first = last
        return Rows(tuple(blocks), tuple(summaries))

    def _block(self, slot: int, index: int, first: int, last: int) -> StateBlock:
        frames = np.arange(first, last)
        age_s = (frames - self.born_frame[slot]) / RATE_HZ
        noise = self.rng.normal(size=(6, len(frames)))
        samples = np.zeros(len(frames), STATE_SAMPLE)
        samples["x_m"] = 3.5 * (slot % 4) - 5 + 0.1 * noise[0]
        samples["y_m"] = 150 - 12 * age_s + 0.1 * noise[1]
        samples["vx_mps"] = 0.2 * noise[2]
        samples["vy_mps"] = -12 + 0.2 * noise[3]
        samples["std_x_m"] = 0.2 + 0.01 * noise[4]
        samples["std_y_m"] = 0.15 + 0.01 * noise[5]
        samples["lane"], samples["status"] = slot % 4 + 1, 1
        samples["frame_offset"] = frames - first
        samples["time_offset_ms"] = (frames - index * RATE_HZ) * 1000 // RATE_HZ
        return StateBlock(self._key(slot), START_S + index, int(first), samples.tobytes())

    def _summary(self, slot: int, frame: int, *, ended: bool) -> TrackSummary:
        born = int(self.born_frame[slot])
        return TrackSummary(
            key=self._key(slot),
            as_of=frame + 1,
            ended=ended,
            first_time_us=START_S * 1_000_000 + born * 1_000_000 // RATE_HZ,
            last_time_us=START_S * 1_000_000 + frame * 1_000_000 // RATE_HZ,
            first_frame=max(born, 0),
            last_frame=frame,
            states=frame - born + 1,
            hits=frame - born + 1,
            length_m=4.5 + self.rng.normal(),
            width_m=1.8 + 0.1 * self.rng.normal(),
            length_class="short",
            existence=float(self.rng.uniform(0.9, 1)),
            first_x_m=self.rng.normal(),
            first_y_m=self.rng.normal(),
            last_x_m=self.rng.normal(),
            last_y_m=self.rng.normal(),
            distance_m=self.rng.normal(),
            mean_speed_mps=12 + self.rng.normal(),
            max_speed_mps=14 + self.rng.normal(),
        )

    def _key(self, slot: int) -> TrackKey:
        return TrackKey(self.sensor_id, 1, int(self.number[slot]))


def measure_log(folder: Path, points: int, seed: int = SEED) -> tuple[float, float]:
    """Write frames into a new log; return bytes of file a frame, and a byte of frame."""
    rng = np.random.default_rng(seed)
    log = SqliteLog(folder, LogLimits(free_share=0.0))
    body_bytes = 0
    for k in range(LOG_FRAMES):
        columns = rng.normal(size=(4, rng.integers(points // 2, 3 * points // 2))).astype(np.float32)
        record = FrameRecord(Frame("radar-1", START_S * 1_000_000 + k, k, None, *columns), 0)
        body_bytes += len(encode_record(record))
        log.append("radar-1", [record])
    log.close()
    size = log.size_bytes()
    return size / LOG_FRAMES, size / body_bytes


def measure(path: Path, load: Load, seed: int = SEED) -> Result:
    """Write the load into a new database at `path` and return what it cost."""
    engine = open_database(f"sqlite:///{path}")
    upgrade(engine)
    empty = _size(engine, path)
    traffic = [Traffic(f"radar-{i + 1}", load, np.random.default_rng((seed, i))) for i in range(load.sensors)]
    states, flush_s = _write(engine, traffic, load)
    with engine.connect() as connection:
        tracks = connection.scalar(text("SELECT count(*) FROM tracks"))
    size = _size(engine, path)
    engine.dispose()
    frame_bytes, overhead = measure_log(path.parent / "log", load.points, seed)
    return Result(
        states,
        tracks or 0,
        size,
        empty,
        (size - empty) / states,
        1000 * flush_s / (load.seconds * load.sensors),
        frame_bytes,
        overhead,
        frame_bytes * RATE_HZ * 3600 / 1e6,
        size / (load.seconds * load.sensors) * 3600 / 1e6,
    )


def _size(engine: Engine, path: Path) -> int:
    """Return the bytes of the database file with all that was committed in it."""
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
    return path.stat().st_size


def _write(engine: Engine, traffic: list[Traffic], load: Load) -> tuple[int, float]:
    """Write second by second; return the number of states and the time inside the transactions."""
    with session_scope(engine) as connection:
        shards = {}
        for source in traffic:
            create_sensor(connection, SensorConfig(sensor_id=source.sensor_id), now_us=START_S * 1_000_000)
            shards[source.sensor_id] = begin_epoch(
                connection, source.sensor_id, first_position=1, reason="first start", time_us=0, now_us=0
            )
    states, flush_s = 0, 0.0
    for index in range(load.seconds):
        for source in traffic:
            rows = source.second(index)
            states += sum(len(block.samples) for block in rows.blocks) // STATE_SAMPLE.itemsize
            now_us = (START_S + index) * 1_000_000
            shard = shards[source.sensor_id]
            started = time.perf_counter()
            with session_scope(engine) as connection:
                shard = save_flush(connection, shard, (index + 1) * RATE_HZ, rows, now_us=now_us)
                if load.snapshot_bytes and index % SNAPSHOT_EVERY_S == 0:
                    state = Snapshot(shard.cursor, bytes(load.snapshot_bytes))
                    save_snapshot(connection, shard, state, now_us=now_us)
            flush_s += time.perf_counter() - started
            shards[source.sensor_id] = shard
    return states, flush_s


def circumstances() -> dict[str, object]:
    """Return what a number measured here depends on."""
    machine = {
        "architecture": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
    }
    return {
        "machine": machine | {"sqlite": sqlite3.sqlite_version},
        "bar_bytes_per_state": BAR_BYTES_PER_STATE,
        "commit": commit(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--sensors", type=int, default=1)
    parser.add_argument("--tracks", type=int, default=TRACKS)
    parser.add_argument("--life", type=float, default=12.0, help="seconds that one track lives")
    parser.add_argument("--points", type=int, default=120, help="of a logged frame, on average")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    load = Load(round(given.minutes * 60), given.sensors, given.tracks, given.life, points=given.points)
    with tempfile.TemporaryDirectory() as folder:
        result = measure(Path(folder) / "rows.sqlite", load)
    if given.json:
        record = {"load": asdict(load), "seed": SEED, "result": asdict(result)} | circumstances()
        print(json.dumps(record, indent=1))
    else:
        print(f"{result.bytes_per_state:.2f} bytes a state (bar {BAR_BYTES_PER_STATE:g})")
        print(f"{result.states} states, {result.tracks} tracks, {result.file_bytes / 2**20:.1f} MiB")
        print(f"{result.flush_ms:.2f} ms a flush")
        print(
            f"{result.log_bytes_per_frame:.0f} bytes a frame in the log, {result.log_overhead:.2f} of its own"
        )
        print(
            f"a sensor and hour: log {result.log_mb_per_sensor_hour:.0f} MB, "
            f"rows {result.rows_mb_per_sensor_hour:.0f} MB"
        )


if __name__ == "__main__":
    main()
