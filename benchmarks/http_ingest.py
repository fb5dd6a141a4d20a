"""The part of `benchmarks/ingest.py --http`: frames posted to a real server process.

`--alone`: the tracker gets nothing to fold, and each connection posts as fast as it is answered, one frame a
request or as many as `--batch` says: the most that the door and the log take. Otherwise each sensor posts at
its rate whatever the answers take (a late post goes out at once and its wait counts), and "readable" is the
time from there until a long poll shows it.
"""

from __future__ import annotations

import argparse
import asyncio
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import orjson

from benchmarks.real_server import (
    JSON,
    Client,
    RealServer,
    circumstances,
    percentiles_ms,
    real_server,
    register,
    wire,
)
from service.formats.json_frames import frame_to_wire
from service.tracking.model import Frame

LATEST_S = 30.0  # for the last frame to become readable
COUNTS_S = 1.0  # until the trackers have told what they counted


@dataclass
class Posted:
    reply_s: list[float] = field(default_factory=list)
    readable_s: list[float] = field(default_factory=list)
    statuses: dict[int, int] = field(default_factory=dict)
    frames: int = 0  # accepted
    last_s: float = 0.0  # when the last reply came; what follows is the wait for the last tracks

    def count(self, status: int, spent_s: float, frames: int = 1) -> None:
        self.statuses[status] = self.statuses.get(status, 0) + 1
        self.frames += frames if status == 202 else 0
        self.reply_s.append(spent_s)
        self.last_s = time.perf_counter()


def measure_http(options: argparse.Namespace, scenes: dict[str, list[Frame]]) -> dict[str, object]:
    bodies = {name: [detections(frame) for frame in frames] for name, frames in scenes.items()}
    with (
        tempfile.TemporaryDirectory() as folder,
        real_server(Path(folder), idle_tracker=options.alone) as server,
    ):
        asyncio.run(register(server.port, list(bodies), options.rate))
        asyncio.run(_warm_up(server.port, bodies))
        before = asyncio.run(_tracked(server.port))
        begun_s, cpu_s = time.perf_counter(), server.cpu_s()
        posted = Posted()
        asyncio.run(_run(server, bodies, options, posted))
        spent_s, cpu_s = time.perf_counter() - begun_s, server.cpu_s() - cpu_s
        tracked = asyncio.run(_tracked(server.port)) - before
    return {
        "sensors": options.sensors,
        "rate_hz": None if options.alone else options.rate,
        "points": options.points,
        "frames_per_request": options.batch,
        "seconds": round(spent_s, 1),
        "tracker": "idle" if options.alone else "tracks",
        "accepted_per_s": round(posted.frames / (posted.last_s - begun_s), 1),
        "tracked_per_s": round(tracked / spent_s, 1),
        "statuses": posted.statuses,
        "reply_ms": percentiles_ms(posted.reply_s),
        "readable_ms": percentiles_ms(posted.readable_s),
        "server_cpu_us_per_frame": round(1e6 * cpu_s / posted.frames),
        "server_cores": round(cpu_s / spent_s, 2),
    } | circumstances()


def detections(frame: Frame) -> bytes:
    """The columns of a frame with two decimals, as radars send them."""
    columns = frame_to_wire(frame)["detections"]
    assert isinstance(columns, dict)
    return orjson.dumps({name: [round(value, 2) for value in column] for name, column in columns.items()})


async def _warm_up(port: int, bodies: dict[str, list[bytes]]) -> None:
    """Let every sensor have a few tracks, and the server its caches."""
    base_us = time.time_ns() // 1000 - 2_000_000
    client = Client(port)
    for name, made in bodies.items():
        for k, body in enumerate(made[:20]):
            await client.ask("POST", path(name), wire(k, name, body, base_us + 50_000 * k), JSON)
    client.close()


async def _run(
    server: RealServer, bodies: dict[str, list[bytes]], options: argparse.Namespace, posted: Posted
) -> None:
    if options.alone:
        until_s = time.perf_counter() + options.seconds
        await asyncio.gather(
            *(_as_fast(server.port, n, b, until_s, posted, options.batch) for n, b in bodies.items())
        )
    else:
        await asyncio.gather(*(_at_rate(server.port, n, b, options.rate, posted) for n, b in bodies.items()))


async def _as_fast(  # noqa: PLR0913, PLR0917 - what distinguishes one load from another
    port: int, name: str, bodies: list[bytes], until_s: float, posted: Posted, batch: int
) -> None:
    client, number = Client(port), 100
    while (begun_s := time.perf_counter()) < until_s:
        frames = []
        for _ in range(batch):
            number += 1
            frames.append(wire(number, name, bodies[number % len(bodies)], time.time_ns() // 1000))
        if batch == 1:
            status, _ = await client.ask("POST", path(name), frames[0], JSON)
            accepted = 1
        else:
            body = b"[" + b",".join(frames) + b"]"
            status, reply = await client.ask("POST", f"{path(name)}:batch", body, JSON)
            accepted = orjson.loads(reply)["accepted"] if status == 202 else 0
        posted.count(status, time.perf_counter() - begun_s, accepted)
    client.close()


async def _at_rate(port: int, name: str, bodies: list[bytes], rate_hz: float, posted: Posted) -> None:
    sent: dict[int, float] = {}
    last = 100 + len(bodies)
    reader = asyncio.ensure_future(_read(port, name, sent, last, posted))
    client, begin_s = Client(port), time.perf_counter()
    for k, body in enumerate(bodies):
        due_s = begin_s + k / rate_hz
        await asyncio.sleep(max(0.0, due_s - time.perf_counter()))
        number = 101 + k
        sent[number] = due_s
        status, _ = await client.ask(
            "POST", path(name), wire(number, name, body, time.time_ns() // 1000), JSON
        )
        posted.count(status, time.perf_counter() - due_s)
    client.close()
    await asyncio.wait_for(reader, LATEST_S)


async def _read(port: int, name: str, sent: dict[int, float], last: int, posted: Posted) -> None:
    client, version, seen = Client(port), 0, 100
    while seen < last:
        status, body = await client.ask("GET", f"/api/v1/sensors/{name}/live?after={version}&wait=25")
        view = orjson.loads(body)
        if status != 200:
            raise RuntimeError(str(view))
        now_s, version = time.perf_counter(), view["version"]
        number = view["frame"] or 0
        if number > seen:
            posted.readable_s += [now_s - sent[n] for n in range(seen + 1, number + 1) if n in sent]
            seen = number
    client.close()


async def _tracked(port: int) -> int:
    await asyncio.sleep(COUNTS_S)
    client = Client(port)
    _, text = await client.ask("GET", "/metrics")
    client.close()
    lines = [
        line for line in text.decode().splitlines() if line.startswith('wayside_frames_total{fate="tracked"')
    ]
    return sum(int(float(line.rpartition(" ")[2])) for line in lines)


def path(name: str) -> str:
    return f"/api/v1/sensors/{name}/frames"
