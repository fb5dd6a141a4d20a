"""Measure ingest: frames per second that one process logs while it tracks, and how soon they are readable.

    python benchmarks/ingest.py [--sensors N] [--rate HZ] [--points N] [--seconds S] [--json OUT.json]
                                [--http [--alone [--batch N]]]

Each sensor posts at its rate, one frame a call. Without `--http` the numbers are those of the host alone,
and "readable" is the time from the call of `submit` to the wake-up of a reader that waits at the live view.
With it a real server process is posted to (benchmarks/http_ingest.py); `--alone`: as fast as it takes,
without tracking, `--batch` frames a request.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import os
import sys
import tempfile
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402
import structlog  # noqa: E402

from service.errors import Unavailable  # noqa: E402
from service.formats.sensor import SensorConfig  # noqa: E402
from service.pipeline.host import EmbeddedHost, wall_clock_us  # noqa: E402
from service.settings import Settings  # noqa: E402
from service.storage import migrate  # noqa: E402
from service.storage.database import open_database, session_scope  # noqa: E402
from service.storage.sites import create_sensor  # noqa: E402
from service.tracking.model import Frame  # noqa: E402


@dataclass
class Measured:
    durable_s: list[float] = field(default_factory=list)
    readable_s: list[float] = field(default_factory=list)
    refused: int = 0


def scene(points: int, frames: int, rate_hz: float, seed: int) -> list[Frame]:
    """Vehicles of ten points each on three lanes, receding, with noise; time starts at 0."""
    rng = np.random.default_rng(seed)
    vehicles = max(1, points // 10)
    x0 = rng.choice([-3.5, 0.0, 3.5], vehicles)
    y0, speed = 25.0 + rng.uniform(0, 100, vehicles), rng.uniform(8, 16, vehicles)
    made = []
    for k in range(frames):
        centre = 25.0 + (y0 - 25.0 + speed * k / rate_hz) % 110.0
        x = np.repeat(x0, 10)[:points] + rng.uniform(-0.8, 0.8, min(points, vehicles * 10))
        y = np.repeat(centre, 10)[:points] + rng.uniform(-2.0, 2.0, len(x))
        distance = np.hypot(x, y)
        columns = (
            distance,
            np.arctan2(x, y),
            np.repeat(speed, 10)[:points] * y / distance,
            np.full(len(x), 22.0),
        )
        made.append(Frame("x", 0, k + 1, None, *(c.astype(np.float32) for c in columns)))
    return made


async def post(
    host: EmbeddedHost, sensor_id: str, frames: list[Frame], rate_hz: float, into: Measured
) -> None:
    loop = asyncio.get_running_loop()
    begin = loop.time()
    sent: dict[int, float] = {}
    reader = asyncio.ensure_future(read(host, sensor_id, sent, len(frames), into))
    tasks = []
    for k, frame in enumerate(frames):
        await asyncio.sleep(max(0.0, begin + k / rate_hz - loop.time()))
        stamped = replace(frame, sensor_id=sensor_id, time_us=wall_clock_us())
        sent[k + 1] = time.perf_counter()
        tasks.append(asyncio.ensure_future(submit(host, sensor_id, stamped, sent[k + 1], into)))
    await asyncio.gather(*tasks)
    await asyncio.wait_for(reader, 60)


async def submit(host: EmbeddedHost, sensor_id: str, frame: Frame, sent_s: float, into: Measured) -> None:
    try:
        await host.submit(sensor_id, [frame])
        into.durable_s.append(time.perf_counter() - sent_s)
    except Unavailable:
        into.refused += 1


async def read(host: EmbeddedHost, sensor_id: str, sent: dict[int, float], last: int, into: Measured) -> None:
    version, seen = 0, 0
    while seen < last:
        entry = await host.live.wait(sensor_id, version, 30.0)
        if entry is None or entry.version == version:
            return
        version = entry.version
        number = 0 if entry.folded is None else entry.folded.number
        if number > seen:
            now_s = time.perf_counter()
            into.readable_s += [now_s - sent[n] for n in range(seen + 1, number + 1) if n in sent]
            seen = number


def percentiles_ms(values: list[float]) -> dict[str, float]:
    return {f"p{q}": round(1e3 * float(np.percentile(values, q)), 1) for q in (50, 95, 99)} if values else {}


def warm_up(host: EmbeddedHost, frames: list[Frame]) -> None:
    """Track the first frames before the clock starts, so that kernels are compiled."""

    async def run() -> None:
        base_us = wall_clock_us() - len(frames) * 50_000
        for k, frame in enumerate(frames):
            await host.submit("warm-up", [replace(frame, sensor_id="warm-up", time_us=base_us + k * 50_000)])

    asyncio.run(run())
    while any(sensor.queue_depth for sensor in host.health().sensors):
        time.sleep(0.05)
    host.forget("warm-up")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sensors", type=int, default=10)
    parser.add_argument("--rate", type=float, default=20.0)
    parser.add_argument("--points", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--http", action="store_true")
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--batch", type=int, default=1, help="frames of one request, with --alone")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.batch < 1 or (options.batch > 1 and not options.alone):
        parser.error("--batch wants at least one frame, and --alone")
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    result = over_http(options) if options.http else measure(options)
    print(json.dumps(result, indent=1))
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")


def over_http(options: argparse.Namespace) -> dict[str, object]:
    from benchmarks.http_ingest import measure_http  # noqa: PLC0415 - which needs `scene` of this file

    count = 200 if options.alone else int(options.seconds * options.rate)
    scenes = {
        f"radar-{n}": scene(options.points, count, options.rate, seed=n) for n in range(options.sensors)
    }
    return measure_http(options, scenes)


def measure(options: argparse.Namespace) -> dict[str, object]:
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data_dir=Path(folder), disk_free_min_share=0.0)
        database = open_database(settings.rows_url)
        migrate.upgrade(database)
        ids = [f"radar-{n}" for n in range(options.sensors)]
        with session_scope(database) as writer:
            for sensor_id in [*ids, "warm-up"]:
                config = SensorConfig(sensor_id=sensor_id, rate_hz=options.rate)
                create_sensor(writer, config, now_us=wall_clock_us())
        host = EmbeddedHost(database, settings)
        host.start()
        count = int(options.seconds * options.rate)
        scenes = {s: scene(options.points, count, options.rate, seed) for seed, s in enumerate(ids)}
        warm_up(host, scene(options.points, 40, 20.0, 99))
        measured = Measured()

        async def run() -> None:
            await asyncio.gather(*(post(host, s, scenes[s], options.rate, measured) for s in ids))

        begun_s, cpu_s = time.perf_counter(), time.process_time()
        asyncio.run(run())
        spent_s, cpu_s = time.perf_counter() - begun_s, time.process_time() - cpu_s
        host.stop()
        database.dispose()
    return {
        "sensors": options.sensors,
        "rate_hz": options.rate,
        "points": options.points,
        "frames_per_s": round(len(measured.durable_s) / spent_s, 1),
        "cpu_cores": round(cpu_s / spent_s, 2),
        "refused": measured.refused,
        "durable_ms": percentiles_ms(measured.durable_s),
        "readable_ms": percentiles_ms(measured.readable_s),
    }


if __name__ == "__main__":
    main()
