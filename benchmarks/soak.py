"""Soak a real service: is anything lost or doubled, and do memory and latency stay where they were?

    python benchmarks/soak.py [--minutes 3] [--sensors 10] [--rate 20] [--vehicles 30] [--points 140]
        [--warm 15] [--trackers N] [--json OUT.json]

Starts `wayside serve` in a process of its own on a temporary folder and a free port, and posts to it over
HTTP from this process, one frame a request, each sensor at its rate and with traffic that never ends: thirty
vehicles give 140 points a frame. Two sensors are watched by long polling: "readable" is the time from the
first byte of a frame's post to the reply that holds its tracks. Everything is stored. Wall times are those of
the machine as busy as it was; the numpy product of the same run says how busy.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import httpx  # noqa: E402
import numpy as np  # noqa: E402
import orjson  # noqa: E402

from benchmarks.process_tree import cores, cpu_by_role, resident_mb  # noqa: E402

LOOP_S = 55.0  # of the traffic: at 10, 12 and 14 m/s every vehicle is then where it was
STRETCH_M = 110.0
WATCHED = 2
COUNTS_S = 1.0  # until the trackers have told what they counted
START_PATIENCE_S = 300.0  # kernels may have to be compiled
BARS = {"readable_p95_ms": 100.0, "readable_p99_ms": 200.0, "drift": 0.05, "lost": 0, "doubled": 0}
Options = argparse.Namespace
FRAME_FATE = re.compile(r'wayside_frames_total\{fate="(\w+)",sensor_id="[^"]*"\} ([\d.e+]+)')
SUM = re.compile(r"wayside_(fold|flush)_seconds_sum ([\d.e+-]+)")
STAGE = re.compile(r'wayside_stage_seconds_(sum|count)\{stage="(\w+)"\} ([\d.e+-]+)')


@dataclass
class Window:
    """A minute."""

    readable_s: list[float] = field(default_factory=list)
    durable_s: list[float] = field(default_factory=list)
    resident_mb: float = 0.0

    def row(self) -> dict[str, float]:
        return {
            **percentiles_ms("readable", self.readable_s),
            **percentiles_ms("durable", self.durable_s),
            "resident_mb": round(self.resident_mb, 1),
        }


@dataclass
class Run:
    """What is measured while the service runs."""

    windows: list[Window] = field(default_factory=lambda: [Window()])
    posted: int = 0
    refused: int = 0
    measuring: bool = False


def percentiles_ms(name: str, values: list[float]) -> dict[str, float]:
    if not values:
        return {}
    return {f"{name}_p{q}_ms": round(1e3 * float(np.percentile(values, q)), 1) for q in (50, 95, 99)}


def numpy_product_us() -> float:
    """Return the time of one 6x6 product, by which machines and moments can be compared."""
    a = np.random.default_rng(1).normal(size=(6, 6))
    took = []
    for _ in range(50):
        begun = time.perf_counter()
        for _ in range(200):
            a @ a
        took.append((time.perf_counter() - begun) / 200)
    return 1e6 * float(np.median(took))


def detections(vehicles: int, points: int, rate_hz: float, seed: int) -> list[bytes]:
    """Return the detections of one loop of traffic, as JSON; vehicles on three lanes at steady speeds."""
    rng = np.random.default_rng(seed)
    lane = np.arange(vehicles) % 3
    x0, speed = 3.5 * lane - 3.5, 10.0 + 2.0 * lane  # one speed a lane: nobody drives into another
    y0 = STRETCH_M * (np.arange(vehicles) // 3) / max(1, -(-vehicles // 3)) + 3.0 * lane
    of = np.arange(points) % vehicles  # the vehicle of each point
    made = []
    for k in range(round(LOOP_S * rate_hz)):
        y = 25.0 + ((y0 + speed * k / rate_hz) % STRETCH_M)[of]
        x = x0[of] + rng.uniform(-0.8, 0.8, len(y))
        y = y + rng.uniform(-2.0, 2.0, len(y))
        r = np.hypot(x, y)
        columns = {
            "range_m": r.round(2).tolist(),
            "azimuth_deg": np.degrees(np.arctan2(x, y)).round(2).tolist(),
            "radial_velocity_mps": (speed[of] * y / r).round(2).tolist(),
            "snr_db": rng.uniform(15, 28, len(y)).round(1).tolist(),
        }
        made.append(orjson.dumps(columns))
    return made


# ------------------------------------------------------------- HTTP, as little of it as possible


Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def request(streams: Streams, data: bytes) -> tuple[int, bytes]:
    """Send a request on a kept connection, and return status and body of its reply."""
    reader, writer = streams
    writer.write(data)
    head = await reader.readuntil(b"\r\n\r\n")
    length = int(re.search(rb"content-length: (\d+)", head, re.IGNORECASE).group(1))  # type: ignore[union-attr]
    return int(head[9:12]), await reader.readexactly(length)


async def post(
    run: Run, port: int, sensor_id: str, loop_frames: list[bytes], options: argparse.Namespace
) -> None:
    """Post one sensor's frames at its rate until the time is up."""
    streams = await asyncio.open_connection("127.0.0.1", port)
    head = f"POST /api/v1/sensors/{sensor_id}/frames HTTP/1.1\r\nHost: 127.0.0.1\r\n".encode()
    head += b"Content-Type: application/json\r\nContent-Length: "
    phase = int(sensor_id.split("-")[1]) * 97
    begun = time.perf_counter() + phase % 10 / 10 / options.rate
    count = round((60 * options.minutes + options.warm) * options.rate)
    for k in range(count):
        await asyncio.sleep(max(0.0, begun + k / options.rate - time.perf_counter()))
        stamp = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        body = b'{"timestamp":"%s","frame":%d,"detections":%s}' % (
            stamp.encode(), k + 1, loop_frames[(k + phase) % len(loop_frames)],
        )  # fmt: skip
        sent_s = time.perf_counter()
        options.sent[sensor_id][k + 1] = sent_s
        while True:
            status, _ = await request(streams, head + b"%d\r\n\r\n" % len(body) + body)
            if status == 202:
                break
            run.refused += 1
            await asyncio.sleep(0.05)
        run.posted += 1
        if run.measuring:
            run.windows[-1].durable_s.append(time.perf_counter() - sent_s)
    streams[1].close()


async def watch(run: Run, port: int, sensor_id: str, sent: dict[int, float]) -> None:
    """Follow one sensor by long polling and note when each frame's tracks could be read."""
    streams = await asyncio.open_connection("127.0.0.1", port)
    path, version, seen = f"/api/v1/sensors/{sensor_id}/live", 0, 0
    while True:
        line = f"GET {path}?after={version}&wait=10 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
        _, body = await request(streams, line.encode())
        now_s = time.perf_counter()
        found = orjson.loads(body)
        version, frame = found["version"], found["frame"] or 0
        if run.measuring:
            run.windows[-1].readable_s += [now_s - sent[n] for n in range(seen + 1, frame + 1) if n in sent]
        for n in range(seen + 1, frame + 1):
            sent.pop(n, None)
        seen = max(seen, frame)


async def keep_time(run: Run, pid: int, warm_s: float) -> None:
    """Begin a window each minute."""
    await asyncio.sleep(warm_s)
    run.measuring = True
    while True:
        for _ in range(12):
            await asyncio.sleep(5.0)
            run.windows[-1].resident_mb = resident_mb(pid)
        run.windows.append(Window())


# ------------------------------------------------------------- the service


@contextmanager
def serving(folder: Path, trackers: int | None) -> Iterator[tuple[subprocess.Popen[str], int]]:
    command = [sys.executable, "-m", "service.cli.main", "serve", "--port", "0", "--data-dir", str(folder)]
    environment = {**os.environ, "WAYSIDE_LOG_LEVEL": "warning"}
    if trackers is not None:
        environment["WAYSIDE_TRACKER_PROCESSES"] = str(trackers)
    process = subprocess.Popen(  # noqa: S603 - our own command
        command, cwd=ROOT, env=environment, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stderr is not None
        for line in process.stderr:
            address = re.search(r"http://127\.0\.0\.1:(\d+)", line)
            if address is not None:
                break
        else:
            raise SystemExit("the service did not start")
        # A full pipe would stop the service at its next warning.
        threading.Thread(target=process.stderr.read, daemon=True).start()
        yield process, int(address.group(1))
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=60)


def soak(options: argparse.Namespace) -> dict[str, object]:
    """Run once and return the result."""
    ids = [f"radar-{n}" for n in range(options.sensors)]
    options.sent = {sensor_id: {} for sensor_id in ids}
    loop_frames = detections(options.vehicles, options.points, options.rate, seed=1)
    run, before_us = Run(), numpy_product_us()
    with (
        tempfile.TemporaryDirectory(prefix="wayside-soak-") as name,
        serving(Path(name), options.trackers) as (process, port),
    ):
        url = f"http://127.0.0.1:{port}"
        for sensor_id in ids:
            body = {"sensor_id": sensor_id, "rate_hz": options.rate}
            httpx.post(f"{url}/api/v1/sensors", json=body).raise_for_status()
        begun_s, begun_cpu_s = time.perf_counter(), cpu_by_role(process.pid)
        asyncio.run(load(run, process.pid, port, ids, loop_frames, options))
        spent_s = time.perf_counter() - begun_s
        busy = cores(begun_cpu_s, cpu_by_role(process.pid), spent_s)
        drained_s = drain(url)
        time.sleep(COUNTS_S)
        work_ms = {
            role: round(1e3 * (value - begun_cpu_s[role]) / max(run.posted, 1), 2)
            for role, value in cpu_by_role(process.pid).items()
        }
        metrics = httpx.get(f"{url}/metrics").text
        sizes = {p.name: p.stat().st_size for p in sorted(Path(name).rglob("*.sqlite*")) if p.is_file()}
    found = result(options, run, metrics, sizes, spent_s, busy, drained_s, before_us)
    return {**found, "processor_ms_per_frame": work_ms}


async def load(  # noqa: PLR0913, PLR0917
    run: Run, pid: int, port: int, ids: list[str], loop_frames: list[bytes], options: argparse.Namespace
) -> None:
    others = [asyncio.create_task(keep_time(run, pid, options.warm))]
    others += [asyncio.create_task(watch(run, port, s, options.sent[s])) for s in ids[:WATCHED]]
    await asyncio.gather(*(post(run, port, s, loop_frames, options) for s in ids))
    await asyncio.sleep(0.5)
    for task in others:
        task.cancel()


def drain(url: str) -> float:
    """Wait until all that was posted is tracked and stored; return how long that took."""
    begun_s = time.perf_counter()
    while time.perf_counter() - begun_s < 120:
        sensors = httpx.get(f"{url}/healthz").json()["sensors"]
        if not any(sensor["queue_depth"] for sensor in sensors):
            break
        time.sleep(0.05)
    return time.perf_counter() - begun_s


def result(  # noqa: PLR0913, PLR0917
    options: argparse.Namespace,
    run: Run,
    metrics: str,
    sizes: dict[str, int],
    spent_s: float,
    busy: dict[str, float],
    drained_s: float,
    before_us: float,
) -> dict[str, object]:
    fates: dict[str, int] = {}
    for fate, count in FRAME_FATE.findall(metrics):
        fates[fate] = fates.get(fate, 0) + int(float(count))
    sums = {name: float(value) for name, value in SUM.findall(metrics)}
    windows = [w for w in run.windows if len(w.readable_s) > 100]
    readable = [v for w in windows for v in w.readable_s]
    hours = options.sensors * spent_s / 3600
    log_bytes = sum(size for name, size in sizes.items() if name.startswith("segment"))
    rows_bytes = sum(size for name, size in sizes.items() if name.startswith("rows"))
    return {
        "sensors": options.sensors,
        "rate_hz": options.rate,
        "vehicles": options.vehicles,
        "points": options.points,
        "minutes": round(spent_s / 60, 2),
        "posted": run.posted,
        "refused_then_taken": run.refused,
        "fates": fates,
        "lost": run.posted - fates.get("tracked", 0),
        "doubled": fates.get("duplicate", 0) + fates.get("conflict", 0),
        **percentiles_ms("readable", readable),
        **percentiles_ms("durable", [v for w in windows for v in w.durable_s]),
        **drift(windows),
        "drained_s": round(drained_s, 2),
        "cores": {
            **busy,
            "fold": round(sums.get("fold", 0) / spent_s, 2),
            "flush": round(sums.get("flush", 0) / spent_s, 2),
        },
        "mean_ms_since_receipt": stages(metrics),
        "log_mb_per_sensor_hour": round(log_bytes / 1e6 / hours, 1),
        "rows_mb_per_sensor_hour": round(rows_bytes / 1e6 / hours, 1),
        "numpy_product_us": [round(before_us, 3), round(numpy_product_us(), 3)],
        "bars": BARS,
        "machine": {
            "cores": os.cpu_count(),
            "architecture": platform.machine(),
            "python": platform.python_version(),
            "load_1min": round(os.getloadavg()[0], 1),
        },
        "minutes_one_by_one": [w.row() for w in windows],
    }


def stages(metrics: str) -> dict[str, float]:
    """Return how long after its receipt a frame was logged, folded, readable, stored, in the mean."""
    found = {(what, stage): float(value) for what, stage, value in STAGE.findall(metrics)}
    return {
        stage: round(1e3 * found["sum", stage] / count, 2)
        for (what, stage), count in found.items()
        if what == "count" and count
    }


def drift(windows: list[Window]) -> dict[str, float]:
    """Compare the last ten minutes with the first ten (or the halves of a shorter run)."""
    part = min(10, len(windows) // 2)
    if part == 0:
        return {}
    first, last = windows[:part], windows[-part:]
    p95 = [float(np.percentile([v for w in part for v in w.readable_s], 95)) for part in (first, last)]
    memory = [max(w.resident_mb for w in part) for part in (first, last)]
    return {
        "readable_p95_drift": round(p95[1] / p95[0] - 1, 3),
        "resident_drift": round(memory[1] / memory[0] - 1, 3),
    }


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--sensors", type=int, default=10)
    parser.add_argument("--rate", type=float, default=20.0)
    parser.add_argument("--vehicles", type=int, default=30)
    parser.add_argument("--points", type=int, default=140, help="of a frame")
    parser.add_argument("--trackers", type=int, help="tracker processes; the service's default unless told")
    parser.add_argument("--warm", type=float, default=15.0, help="seconds that are not measured")
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


def main() -> None:
    options = parse()
    found = soak(options)
    print(json.dumps({k: v for k, v in found.items() if k != "minutes_one_by_one"}, indent=1))
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")
    if found["lost"] or found["doubled"]:
        sys.exit(1)


if __name__ == "__main__":
    main()
