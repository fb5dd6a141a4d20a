"""Run the real service in a process of its own for a benchmark, and talk to it by bare connections.

    python benchmarks/real_server.py DATA_DIR [--idle-tracker]     (started by the benchmarks)

A bare keep-alive connection costs a fifth of an HTTP library's time, so that the load does not slow down what
it measures.
"""

from __future__ import annotations

import asyncio
import os
import platform
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402
import orjson  # noqa: E402

from benchmarks.commit import commit  # noqa: E402
from benchmarks.process_tree import cpu_by_role, resident_mb  # noqa: E402

START_S = 240.0  # compiling kernels on a busy machine
HOST = "127.0.0.1"
JSON = "Content-Type: application/json\r\n"


@dataclass(frozen=True, slots=True)
class RealServer:
    """A running service."""

    port: int
    process: subprocess.Popen[str]

    def cpu_s(self) -> float:
        """Processor time that it used, with the processes that it started."""
        return sum(self.cpu_by_role().values())

    def cpu_by_role(self) -> dict[str, float]:
        """The same of the serving process and of its trackers."""
        return cpu_by_role(self.process.pid)

    def resident_bytes(self) -> int:
        """Memory that it holds, with the processes that it started."""
        return round(resident_mb(self.process.pid) * 2**20)


class Client:
    """One keep-alive connection."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._reader: asyncio.StreamReader | None = None
        self._writer: asyncio.StreamWriter | None = None

    async def ask(self, method: str, path: str, body: bytes = b"", headers: str = "") -> tuple[int, bytes]:
        """Send one request and return status and body; opens a connection that the server closed again."""
        for attempt in (1, 2):
            if self._reader is None or self._writer is None:
                self._reader, self._writer = await asyncio.open_connection(HOST, self._port)
            place = f"{method} {path} HTTP/1.1\r\nHost: {HOST}:{self._port}\r\n"
            head = f"{place}{headers}Content-Length: {len(body)}\r\n\r\n"
            try:
                self._writer.write(head.encode("latin-1") + body)
                await self._writer.drain()
                return await self._reply()
            except (ConnectionError, asyncio.IncompleteReadError):
                self.close()
                if attempt == 2:
                    raise
        raise AssertionError

    async def _reply(self) -> tuple[int, bytes]:
        assert self._reader is not None
        head = (await self._reader.readuntil(b"\r\n\r\n")).lower()
        status = int(head[9:12])
        length = head.partition(b"content-length:")[2].partition(b"\r\n")[0].strip()
        body = await self._reader.readexactly(int(length)) if length else b""
        if b"connection: close" in head:
            self.close()
        return status, body

    async def stream(self, path: str) -> asyncio.StreamReader:
        """Begin a request whose reply has no end, and return the connection behind its head."""
        reader, self._writer = await asyncio.open_connection(HOST, self._port, limit=2**20)
        self._writer.write(f"GET {path} HTTP/1.1\r\nHost: {HOST}:{self._port}\r\n\r\n".encode())
        head = await reader.readuntil(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 200"), head
        return reader

    def close(self) -> None:
        """Let go of the connection."""
        if self._writer is not None:
            self._writer.close()
        self._reader = self._writer = None


@contextmanager
def real_server(folder: Path, *, idle_tracker: bool = False, **settings: object) -> Iterator[RealServer]:
    """Start the service on a free port, and end it."""
    wanted = {"disk_free_min_share": 0.0, "log_level": "warning", "port": 0} | settings
    cache = {"NUMBA_CACHE_DIR": str(ROOT / ".cache/numba")}  # where scripts/setup puts compiled kernels
    environment = (
        cache | os.environ | {f"WAYSIDE_{name.upper()}": str(value) for name, value in wanted.items()}
    )
    command = [sys.executable, __file__, str(folder), *(["--idle-tracker"] if idle_tracker else [])]
    process = subprocess.Popen(  # noqa: S603 - our own file
        command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("http"), f"the service did not start: {line!r}"
        yield RealServer(int(line.rpartition(":")[2]), process)
    finally:
        process.terminate()
        process.wait(60)
        if process.stdout is not None:
            process.stdout.close()


def wire(frame_number: int, sensor_id: str, detections: bytes, time_us: int) -> bytes:
    """Return a columnar frame as its sensor would post it."""
    stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(time_us // 1_000_000))
    head = (
        f'{{"sensor_id":"{sensor_id}","timestamp":"{stamp}.{time_us % 1_000_000:06d}Z","frame":{frame_number}'
    )
    return head.encode() + b',"detections":' + detections + b"}"


async def register(port: int, sensor_ids: list[str], rate_hz: float) -> None:
    """Register sensors at the running service."""
    client = Client(port)
    for sensor_id in sensor_ids:
        body = orjson.dumps({"sensor_id": sensor_id, "rate_hz": rate_hz})
        status, reply = await client.ask(
            "POST", "/api/v1/sensors", body, "Content-Type: application/json\r\n"
        )
        assert status == 201, reply
    client.close()


def product_us(repeats: int = 20) -> float:
    """Median time of one numpy product of two 6 x 6 matrices: the unit of a busy machine."""
    a = np.eye(6)
    taken = []
    for _ in range(repeats):
        begun_s = time.perf_counter()
        for _ in range(1000):
            np.matmul(a, a)
        taken.append(time.perf_counter() - begun_s)
    return round(1e3 * float(np.median(taken)), 3)


def circumstances() -> dict[str, object]:
    """Return what else decides the numbers."""
    return {
        "commit": commit(),
        "python": platform.python_version(),
        "processors": os.cpu_count(),
        "load_average": round(os.getloadavg()[0], 1),
        "numpy_6x6_product_us": product_us(),
    }


def percentiles_ms(values: list[float]) -> dict[str, float]:
    """Return the percentiles of times in seconds, in milliseconds."""
    return {f"p{q}": round(1e3 * float(np.percentile(values, q)), 1) for q in (50, 95, 99)} if values else {}


def _serve() -> None:
    """Be the server process: what `wayside serve` runs; an idle tracker never gets a sensor to fold."""
    from service.api.server import run  # noqa: PLC0415
    from service.pipeline.tracker_thread import TrackerThread  # noqa: PLC0415
    from service.settings import Settings  # noqa: PLC0415
    from service.telemetry import set_up_logging  # noqa: PLC0415
    from service.warmup import warm_up  # noqa: PLC0415

    idle = "--idle-tracker" in sys.argv
    if idle:
        TrackerThread.add = lambda *_: None  # type: ignore[method-assign]
    settings = Settings(data_dir=Path(sys.argv[1]), **({"tracker_processes": 0} if idle else {}))
    set_up_logging(settings.log_level, "json")
    run(
        settings,
        prepare=lambda _: None if idle else warm_up(lambda *_: None),
        on_ready=lambda address: print(address, flush=True),
    )


if __name__ == "__main__":
    _serve()
