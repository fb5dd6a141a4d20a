"""Measure live delivery: streams and long polls on a real server that ten sensors post to, an export beside.

    python benchmarks/delivery.py [--sensors 10] [--streams 200] [--polls 50] [--rows 1000000] [--seconds 20]
                                  [--json OUT.json]

Three phases: posts alone; with the readers; with the readers while a sensor's stored states are exported.
Ten sensors post 100 points at 20 Hz; a stream carries five views a second, a long poll asks five times a
second; the streams are open before the posts begin, and the polls are not in step. Readers and export run in
processes of their own. "delay" is from the host's receipt of the frame to the reader.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import os
import sys
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402
import orjson  # noqa: E402

from benchmarks.http_ingest import detections, path  # noqa: E402
from benchmarks.ingest import scene  # noqa: E402
from benchmarks.process_tree import cores  # noqa: E402
from benchmarks.real_server import (  # noqa: E402
    JSON,
    Client,
    RealServer,
    circumstances,
    percentiles_ms,
    real_server,
    register,
    wire,
)
from service.formats.rfc3339 import parse_time_us  # noqa: E402
from service.formats.sensor import SensorConfig  # noqa: E402
from service.storage import migrate  # noqa: E402
from service.storage.database import open_database, session_scope  # noqa: E402
from service.storage.rows import STATE_SAMPLE, StateBlock, TrackKey  # noqa: E402
from service.storage.shards import begin_epoch  # noqa: E402
from service.storage.sites import create_sensor  # noqa: E402
from service.storage.tracks import save_blocks  # noqa: E402

RATE_HZ = 20.0
VIEWS_HZ = 5.0
BLOCK = 20  # states of a track's second
TRACKS = 30
ARCHIVE = "archive"  # the sensor whose states are exported
BAR_MS = 50.0
START_S = 120.0  # for a process of readers to start, on a busy machine


def fill(folder: Path, rows: int) -> int:
    """Store so many states of 30 tracks at 20 Hz, and return how many there are."""
    engine = open_database(f"sqlite:///{folder / 'rows.sqlite'}")
    migrate.upgrade(engine)
    samples = np.zeros(BLOCK, STATE_SAMPLE)
    samples["frame_offset"] = np.arange(BLOCK)
    samples["time_offset_ms"] = np.arange(BLOCK) * 50
    rng = np.random.default_rng(1)
    for name in ("x_m", "y_m", "vx_mps", "vy_mps"):
        samples[name] = rng.normal(0, 30, BLOCK)
    data, first_s = samples.tobytes(), 1_747_000_000
    seconds = rows // (BLOCK * TRACKS)
    with session_scope(engine) as writer:
        create_sensor(writer, SensorConfig(sensor_id=ARCHIVE), now_us=1)
        begin_epoch(writer, ARCHIVE, first_position=1, reason="benchmark", time_us=1, now_us=1)
        for second in range(seconds):
            blocks = [
                StateBlock(TrackKey(ARCHIVE, 1, number), first_s + second, BLOCK * second, data)
                for number in range(1, TRACKS + 1)
            ]
            save_blocks(writer, blocks, now_us=time.time_ns() // 1000)
    engine.dispose()
    return seconds * BLOCK * TRACKS


def run_readers(port: int, options: argparse.Namespace, line: Connection) -> None:
    line.send(("readers", asyncio.run(_readers(port, options, line))))


async def _readers(port: int, options: argparse.Namespace, line: Connection) -> dict[str, object]:
    """Open the streams, say so, and read from the word on; nobody is in step with another."""
    names = [f"radar-{n}" for n in range(options.sensors)]
    seconds = options.seconds
    streams = []
    for k in range(options.streams):
        client = Client(port)
        streams.append((client, await client.stream(f"/api/v1/sensors/{names[k % len(names)]}/live/stream")))
    line.send(("ready", {}))
    await asyncio.to_thread(line.recv)
    until_s = time.monotonic() + seconds
    found = await asyncio.gather(
        *(_stream(client, reader, until_s) for client, reader in streams),
        *(
            _poll(port, names[k % len(names)], until_s, k / options.polls / VIEWS_HZ)
            for k in range(options.polls)
        ),
    )
    streamed, polled = found[: options.streams], found[options.streams :]
    return {
        "streams": _summary(streamed, seconds),
        "polls": _summary(polled, seconds),
        "missed_notices": sum(one["missed"] for one in streamed),
    }


def _summary(found: list[dict[str, object]], seconds: float) -> dict[str, object]:
    delays = [delay for one in found for delay in one["delays_s"]]  # type: ignore[attr-defined]
    rates = sorted(len(one["delays_s"]) / seconds for one in found)  # type: ignore[arg-type]
    if not rates:
        return {}
    return {
        "views_per_s": round(sum(rates), 1),
        "slowest_reader_hz": round(rates[0], 2),
        "delay_ms": percentiles_ms(delays),
    }


def _delay_s(body: bytes) -> float:
    at = body.index(b'"received_at":"') + 15
    return time.time() - parse_time_us(body[at : at + 24].decode()) / 1e6


async def _stream(client: Client, reader: asyncio.StreamReader, until_s: float) -> dict[str, object]:
    delays, missed = [], 0
    while (left_s := until_s - time.monotonic()) > 0:
        try:
            event = await asyncio.wait_for(reader.readuntil(b"\n\n"), left_s)
        except TimeoutError:
            break
        if b"event: live" in event and b'"received_at":"' in event:
            delays.append(_delay_s(event))
        missed += b"event: missed" in event
    client.close()
    return {"delays_s": delays, "missed": missed}


async def _poll(port: int, name: str, until_s: float, shift_s: float) -> dict[str, object]:
    client, version, delays = Client(port), 0, []
    await asyncio.sleep(shift_s)
    while (begun_s := time.monotonic()) < until_s:
        _, body = await client.ask("GET", f"/api/v1/sensors/{name}/live?after={version}&wait=5")
        version = orjson.loads(body)["version"]
        if b'"received_at":"' in body:
            delays.append(_delay_s(body))
        await asyncio.sleep(max(0.0, begun_s + 1 / VIEWS_HZ - time.monotonic()))
    client.close()
    return {"delays_s": delays, "missed": 0}


def run_export(port: int, options: argparse.Namespace, line: Connection) -> None:
    line.send(("ready", {}))
    line.recv()
    line.send(("export", asyncio.run(_export(port, options.seconds))))


async def _export(port: int, seconds: float) -> dict[str, object]:
    client = Client(port)
    reader = await client.stream(f"/api/v1/sensors/{ARCHIVE}/states")
    begun_s, lines, size = time.monotonic(), 0, 0
    while data := await reader.read(2**18):
        lines += data.count(b"\n{")
        size += len(data)
        if data.endswith(b"0\r\n\r\n"):
            break
    client.close()
    spent_s = time.monotonic() - begun_s
    return {
        "frames": lines,
        "megabytes": round(size / 1e6, 1),
        "seconds": round(spent_s, 1),
        "within": spent_s < seconds,
    }


async def post(port: int, bodies: dict[str, list[bytes]], first: int, seconds: float) -> dict[str, object]:
    """Post at the sensors' rate, and return what the replies took from when each was due."""
    reply_s: list[float] = []
    statuses: dict[int, int] = {}

    async def one(name: str, made: list[bytes], shift_s: float) -> None:
        client, begin_s = Client(port), time.monotonic() + shift_s
        for k in range(int(seconds * RATE_HZ)):
            due_s = begin_s + k / RATE_HZ
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))
            body = wire(first + k, name, made[k % len(made)], time.time_ns() // 1000)
            status, _ = await client.ask("POST", path(name), body, JSON)
            reply_s.append(time.monotonic() - due_s)
            statuses[status] = statuses.get(status, 0) + 1
        client.close()

    await asyncio.gather(*(one(n, b, k / RATE_HZ / len(bodies)) for k, (n, b) in enumerate(bodies.items())))
    return {"statuses": statuses, "reply_ms": percentiles_ms(reply_s)}


def phase(
    server: RealServer, options: argparse.Namespace, bodies: dict[str, list[bytes]], number: int
) -> dict[str, object]:
    """Run one of the three phases."""
    lines, beside = [], []
    for run in (run_readers, run_export)[:number]:
        ours, theirs = multiprocessing.Pipe()  # a queue needs shared memory, which not every machine has
        beside.append(multiprocessing.Process(target=run, args=(server.port, options, theirs)))
        lines.append(ours)
        beside[-1].start()
    for line in lines:
        if not line.poll(START_S):  # importing takes seconds
            raise RuntimeError("a reader did not start")
        line.recv()
    for line in lines:
        line.send("go")
    begun_s, cpu_s = time.monotonic(), server.cpu_by_role()
    found = asyncio.run(post(server.port, bodies, 1 + 1_000_000 * (number + 1), options.seconds))
    busy = cores(cpu_s, server.cpu_by_role(), time.monotonic() - begun_s)
    for line in lines:
        name, result = line.recv() if line.poll(options.seconds + 120) else ("lost", {})
        found[name] = result
    for process in beside:
        process.join()
    return {**found, "server_cores": busy}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sensors", type=int, default=10)
    parser.add_argument("--points", type=int, default=100)
    parser.add_argument("--streams", type=int, default=200)
    parser.add_argument("--polls", type=int, default=50)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    multiprocessing.set_start_method("fork")  # no thread runs yet, and importing all anew takes long
    result = measure(options)
    print(json.dumps(result, indent=1))
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")


def measure(options: argparse.Namespace) -> dict[str, object]:
    count = int(10 * RATE_HZ)
    names = [f"radar-{n}" for n in range(options.sensors)]
    bodies = {
        name: [detections(frame) for frame in scene(options.points, count, RATE_HZ, seed)]
        for seed, name in enumerate(names)
    }
    with tempfile.TemporaryDirectory() as folder:
        rows = fill(Path(folder), options.rows)
        with real_server(Path(folder), stream_rate_hz=VIEWS_HZ) as server:
            asyncio.run(register(server.port, names, RATE_HZ))
            asyncio.run(post(server.port, bodies, 1, 3.0))
            phases = [phase(server, options, bodies, number) for number in range(3)]
    named = dict(zip(("posts", "posts_and_readers", "posts_readers_and_export"), phases, strict=True))
    return {
        "sensors": options.sensors,
        "rate_hz": RATE_HZ,
        "points": options.points,
        "streams": options.streams,
        "polls": options.polls,
        "exported_states": rows,
        "bar_reply_p99_ms": BAR_MS,
        **named,
    } | circumstances()


if __name__ == "__main__":
    main()
