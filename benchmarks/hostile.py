"""Send hostile requests to a real server: nothing may break or grow, and nothing refused may be stored.

    python benchmarks/hostile.py [--requests 100000] [--seed 1] [--connections 8] [--json OUT.json]

Bodies are drawn by a seeded generator (`hostile`): noise, cut and mutated frames, wrong types and lengths,
deep and empty containers, bombs, wrong encodings, times far off, junk in batches, and junk for the other
routes. A mutation can leave a frame right; so the frames in the log are counted against the replies, and each
is looked at.
"""

from __future__ import annotations

import argparse
import asyncio
import gzip
import json
import os
import random
import sqlite3
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402
import orjson  # noqa: E402

from benchmarks.real_server import JSON, Client, circumstances, real_server, register, wire  # noqa: E402
from service.api.compression import zstd  # noqa: E402
from service.formats.detections import RANGE_LIMIT_M, SNR_LIMIT_DB, VELOCITY_LIMIT_MPS  # noqa: E402
from service.pipeline.codec import decode_record  # noqa: E402
from service.pipeline.records import FrameRecord  # noqa: E402

SENSOR = "radar-0"
FRAME_PATH = f"/api/v1/sensors/{SENSOR}/frames"
BATCH_PATH = f"{FRAME_PATH}:batch"
NDJSON = "Content-Type: application/x-ndjson\r\n"
BODY_LIMIT_BYTES = 2 * 2**20  # of the server here, so that bombs cost little time
WARM_UP_SHARE = 0.1  # of the requests, before memory is looked at for the first time
GROWTH_BAR = 0.10
_BOMB = bytes(8 * BODY_LIMIT_BYTES)
_GZIP_BOMB, _ZSTD_BOMB = gzip.compress(_BOMB, 9), zstd.compress(_BOMB)
_ODD = (None, True, "", "NaN", "1e999", -1, 1e308, 10**40, [], {}, [1], {"a": 1}, "\u0000", "x" * 300, 0.1)


@dataclass(frozen=True, slots=True)
class Request:
    kind: str
    method: str
    path: str
    headers: str
    body: bytes


def good_frame(rng: random.Random) -> dict[str, object]:
    """A frame that the service takes, near now."""
    count = rng.randrange(12)
    columns = {
        "range_m": [round(rng.uniform(20, 140), 2) for _ in range(count)],
        "azimuth_deg": [round(rng.uniform(-30, 30), 2) for _ in range(count)],
        "radial_velocity_mps": [round(rng.uniform(-30, 30), 2) for _ in range(count)],
    }
    text = wire(rng.randrange(2**40), SENSOR, orjson.dumps(columns), time.time_ns() // 1000)
    made: dict[str, object] = orjson.loads(text)
    return made


def _noise(rng: random.Random) -> bytes:
    return rng.randbytes(rng.randrange(200))


def _cut(rng: random.Random) -> bytes:
    body = orjson.dumps(good_frame(rng))
    return body[: rng.randrange(len(body))]


def _flipped(rng: random.Random) -> bytes:
    body = bytearray(orjson.dumps(good_frame(rng)))
    for _ in range(rng.randrange(1, 6)):
        body[rng.randrange(len(body))] = rng.randrange(256)
    return bytes(body)


def _odd_member(rng: random.Random) -> bytes:
    frame = good_frame(rng)
    place = frame["detections"] if rng.random() < 0.5 else frame
    assert isinstance(place, dict)
    place[rng.choice([*place, "x_m", "frame", "boot_id", "more"])] = rng.choice(_ODD)
    return json.dumps(frame).encode()


def _odd_value(rng: random.Random) -> bytes:
    frame = good_frame(rng)
    columns = frame["detections"]
    assert isinstance(columns, dict)
    column = columns[rng.choice(list(columns))]
    column.insert(rng.randrange(len(column) + 1), rng.choice(_ODD))  # also makes it longer than the others
    return json.dumps(frame).encode()


def _nonsense_numbers(rng: random.Random) -> bytes:
    body = orjson.dumps(good_frame(rng))
    word = rng.choice(
        [b"NaN", b"Infinity", b"-Infinity", b"1e999", b"9" * 5000, b"0x10", b"01", b"1.", b"+1"]
    )
    return body.replace(b'"frame":', b'"frame":' + word + b',"f":', 1)


def _twice(rng: random.Random) -> bytes:
    body = orjson.dumps(good_frame(rng))
    return body[:-1] + b',"' + rng.choice([b"frame", b"timestamp", b"detections", b"\\u0066rame"]) + b'":1}'


def _containers(rng: random.Random) -> bytes:
    depth = rng.choice([10, 33, 500, 1025, 30_000])
    opened, closed = rng.choice([(b"[", b"]"), (b'{"a":', b"}")])
    return rng.choice(
        [
            opened * depth + b"1" + closed * depth,
            b"[" + b"[]," * depth + b"[]]",
            opened * depth,
            b"{}" * depth,
        ]
    )


def _far_off(rng: random.Random) -> bytes:
    frame = good_frame(rng)
    frame["timestamp"] = rng.choice(
        ["2999-01-01T00:00:00Z", "1969-12-31T23:59:59Z", "2025-13-01T00:00:00Z", "9999-12-31T23:59:60Z",
         "2025-01-01T00:00:00", "0000-01-01T00:00:00Z", "2025-01-01T00:00:00.0000001Z",
         "١٩٩٩-01-01T00:00:00Z"]
    )  # fmt: skip
    return orjson.dumps(frame)


BODIES: dict[str, Callable[[random.Random], bytes]] = {
    "noise": _noise,
    "cut": _cut,
    "flipped": _flipped,
    "odd member": _odd_member,
    "odd value": _odd_value,
    "nonsense numbers": _nonsense_numbers,
    "member twice": _twice,
    "containers": _containers,
    "far off": _far_off,
}


def hostile(rng: random.Random) -> Request:
    """Draw one hostile request."""
    kind = rng.choice(list(BODIES))
    body = BODIES[kind](rng)
    way = rng.random()
    if way < 0.55:
        return Request(kind, "POST", FRAME_PATH, JSON, body)
    if way < 0.75:
        return _batch(rng, kind, body)
    if way < 0.88:
        return _encoded(rng, body)
    return _elsewhere(rng, kind, body)


def _batch(rng: random.Random, kind: str, body: bytes) -> Request:
    others = [BODIES[rng.choice(list(BODIES))](rng) for _ in range(rng.randrange(4))]
    bodies = [body, *others]
    rng.shuffle(bodies)
    if rng.random() < 0.5:
        return Request(f"{kind}, array", "POST", BATCH_PATH, JSON, b"[" + b",".join(bodies) + b"]")
    return Request(f"{kind}, NDJSON", "POST", BATCH_PATH, NDJSON, b"\n".join(bodies))


def _encoded(rng: random.Random, body: bytes) -> Request:
    path = rng.choice([FRAME_PATH, BATCH_PATH])
    draw = rng.random()
    if draw < 0.05:
        name, bomb = rng.choice([("gzip", _GZIP_BOMB), ("zstd", _ZSTD_BOMB)])
        return Request(f"bomb, {name}", "POST", path, f"Content-Encoding: {name}\r\n{JSON}", bomb)
    name = rng.choice(["gzip", "zstd", "br", "gzip, gzip", "identity", "\xff"])
    packers = {"gzip": partial(gzip.compress, mtime=0), "zstd": zstd.compress}  # without the time of day
    packed = packers.get(name, bytes)(body)
    if draw < 0.3 and packed:
        packed = packed[: rng.randrange(len(packed))]
    return Request(f"encoded, {name}", "POST", path, f"Content-Encoding: {name}\r\n{JSON}", packed)


def _elsewhere(rng: random.Random, kind: str, body: bytes) -> Request:
    method, path = rng.choice(
        [("POST", "/api/v1/sites"), ("POST", "/api/v1/sensors"), ("POST", "/api/v1/keys"),
         ("PATCH", f"/api/v1/sensors/{SENSOR}"), ("POST", "/api/v1/sensors/nobody/frames"),
         ("PUT", FRAME_PATH), ("POST", "/api/v1/sensors/%00/frames"), ("POST", "/api/v1/nothing"),
         ("POST", "/api/v1/session"), ("POST", f"/api/v1/sensors/{SENSOR}:purge"),
         ("DELETE", "/api/v1/keys/x")]
    )  # fmt: skip
    kinds = [
        "application/json",
        "text/plain",
        "application/x-www-form-urlencoded",
        "application/merge-patch+json",
        "/",
    ]
    headers = f"Content-Type: {rng.choice(kinds)}\r\n"
    if rng.random() < 0.3:
        headers += f"Idempotency-Key: {rng.choice(['a', '%22', '', 'x' * 400])}\r\n"
    return Request(f"{kind}, {method} {path}", method, path, headers, body)


@dataclass(frozen=True, slots=True)
class Tally:
    statuses: Counter[int]
    failures: list[str]  # requests that were answered 5xx
    logged: int  # frames that the replies call accepted, late, duplicate or conflict


async def send_all(port: int, requests: int, seed: int, connections: int) -> Tally:
    """Send so many hostile requests and count what came back."""
    rng = random.Random(seed)  # noqa: S311 - seeded, to be repeated
    tally = Tally(Counter(), [], 0)
    left, logged = [requests], [0]

    async def one() -> None:
        client = Client(port)
        while left[0] > 0:
            left[0] -= 1
            request = hostile(rng)
            status, reply = await client.ask(request.method, request.path, request.body, request.headers)
            tally.statuses[status] += 1
            if status >= 500:
                tally.failures.append(f"{status} {request.kind}: {request.body[:200]!r} {reply[:300]!r}")
            logged[0] += _logged(request, status, reply)
        client.close()

    await asyncio.gather(*(one() for _ in range(connections)))
    return Tally(tally.statuses, tally.failures, logged[0])


def _logged(request: Request, status: int, reply: bytes) -> int:
    if request.path == BATCH_PATH and status == 202:
        found = orjson.loads(reply)
        return sum(found[name] for name in ("accepted", "late", "duplicate", "conflict"))
    return int(request.path == FRAME_PATH and request.method == "POST" and status in {200, 202, 409})


def look_at_log(folder: Path) -> tuple[int, int]:
    """Return how many frames the log holds, and how many have a value that no frame may have."""
    frames = wrong = 0
    for path in sorted((folder / "log").glob("segment-*.sqlite")):
        with sqlite3.connect(path) as connection:
            for (body,) in connection.execute("SELECT body FROM record"):
                record = decode_record(body)
                if isinstance(record, FrameRecord):
                    frames += 1
                    wrong += not _sound(record)
        connection.close()
    return frames, wrong


def _sound(record: FrameRecord) -> bool:
    frame = record.frame
    known = [column[~np.isnan(column)] for column in (frame.radial_velocity_mps, frame.snr_db)]
    return bool(
        np.isfinite(frame.range_m).all()
        and ((frame.range_m >= 0) & (frame.range_m <= 2 * RANGE_LIMIT_M)).all()
        and (np.abs(frame.azimuth_rad) <= np.pi + 1e-6).all()
        and (np.abs(known[0]) <= VELOCITY_LIMIT_MPS).all()
        and (np.abs(known[1]) <= SNR_LIMIT_DB).all()
        and 0 <= frame.time_us <= record.received_us + 61_000_000
    )


def measure(requests: int, seed: int, connections: int, *, idle_tracker: bool = False) -> dict[str, object]:
    """Run all of it on a server of its own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        limits = {"body_limit_bytes": BODY_LIMIT_BYTES, "rate_limit_admin": "none"}
        with real_server(folder, idle_tracker=idle_tracker, **limits) as server:
            asyncio.run(register(server.port, [SENSOR], 20.0))
            begun_s = time.perf_counter()
            first = asyncio.run(send_all(server.port, int(WARM_UP_SHARE * requests), seed, connections))
            before = server.resident_bytes()
            rest = asyncio.run(
                send_all(server.port, requests - first.statuses.total(), seed + 1, connections)
            )
            after, spent_s = server.resident_bytes(), time.perf_counter() - begun_s
            alive = server.process.poll() is None
        stored, wrong = look_at_log(folder)
    statuses = first.statuses + rest.statuses
    return {
        "requests": statuses.total(),
        "seed": seed,
        "seconds": round(spent_s, 1),
        "statuses": {str(status): statuses[status] for status in sorted(statuses)},
        "answered_5xx": len(first.failures) + len(rest.failures),
        "failures": (first.failures + rest.failures)[:20],
        "server_alive": alive,
        "frames_called_logged": first.logged + rest.logged,
        "frames_in_log": stored,
        "frames_in_log_with_wrong_values": wrong,
        "resident_mb_before": round(before / 1e6, 1),
        "resident_mb_after": round(after / 1e6, 1),
        "growth": round(after / before - 1, 4),
        "growth_bar": GROWTH_BAR,
    } | circumstances()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--requests", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--connections", type=int, default=8)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    result = measure(options.requests, options.seed, options.connections)
    print(json.dumps(result, indent=1))
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
