"""Read request bodies with limits that hold before and after decompression, in time and for all together."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager

from anyio import to_thread
from starlette.requests import ClientDisconnect, Request

from service.api.compression import ENCODINGS, inflate, too_large
from service.api.headers import header
from service.api.problems import HttpProblem
from service.errors import Unavailable

JSON_TYPES = frozenset({"", "application/json"})  # a client that names no type is taken to mean JSON
NDJSON_TYPES = frozenset({"application/x-ndjson", "application/jsonl", "application/jsonlines"})

BODY_TIME_S = 30.0  # for a whole body to arrive; slower ones would hold their memory for ever
HELD_BODIES = 8  # of the largest size, that may be in work at once
INLINE_BYTES = 4096  # a larger compressed body is inflated in a thread: up to 4 MB come out of so many


class BodyRoom:
    """Counts the bytes of bodies in work, so that many large ones at once cannot fill the memory."""

    def __init__(self, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes  # of one body, before and after decompression
        self._room_bytes = HELD_BODIES * limit_bytes
        self._held_bytes = 0

    @contextmanager
    def hold(self) -> Iterator[Held]:
        """Give back at the end what was taken for one request."""
        held = Held(self)
        try:
            yield held
        finally:
            self._held_bytes -= held.bytes

    def take(self, count: int) -> None:
        """Take room for so many bytes; raises Unavailable when there is none."""
        if self._held_bytes + count > self._room_bytes:
            raise Unavailable(f"bodies of {self._held_bytes} bytes are in work; try again", 1.0)
        self._held_bytes += count


class Held:
    """What one request holds of the room."""

    __slots__ = ("_room", "bytes")

    def __init__(self, room: BodyRoom) -> None:
        self._room = room
        self.bytes = 0

    def add(self, count: int) -> None:
        """Take more; raises Unavailable."""
        self._room.take(count)
        self.bytes += count


async def read_body(request: Request, limit_bytes: int, held: Held | None = None) -> bytes:
    """Return the body, decompressed.

    Raises HttpProblem 413 as soon as it outgrows the limit, 415, 408 or 400, and Unavailable when bodies of
    other requests leave no room.
    """
    encoding = (header(request.scope, b"content-encoding") or "identity").strip().lower()
    if encoding != "identity" and encoding not in ENCODINGS:
        raise HttpProblem(
            "unsupported-media-type",
            f"want Content-Encoding gzip, zstd or none, got {encoding[:100]!r}",
            {"Accept-Encoding": "gzip, zstd"},
        )
    declared = header(request.scope, b"content-length") or ""
    if declared.isdigit() and int(declared) > limit_bytes:
        raise too_large(limit_bytes)
    try:
        async with asyncio.timeout(BODY_TIME_S):
            body = await _arrived(request, limit_bytes, held)
    except TimeoutError:
        raise HttpProblem("too-slow", f"the body did not arrive within {BODY_TIME_S:.0f} s") from None
    if encoding == "identity":
        return body
    if len(body) <= INLINE_BYTES:
        plain = inflate(body, encoding, limit_bytes)
    else:
        plain = await to_thread.run_sync(inflate, body, encoding, limit_bytes)
    if held is not None:
        held.add(len(plain))
    return plain


async def _arrived(request: Request, limit_bytes: int, held: Held | None) -> bytes:
    parts: list[bytes] = []
    received = 0
    more = True
    while more:
        message = await request.receive()
        if message["type"] == "http.disconnect":
            raise ClientDisconnect
        chunk, more = message.get("body", b""), message.get("more_body", False)
        received += len(chunk)
        if received > limit_bytes:
            raise too_large(limit_bytes)
        if held is not None:
            held.add(len(chunk))
        if chunk:
            parts.append(chunk)
    return parts[0] if len(parts) == 1 else b"".join(parts)


def media_type(request: Request) -> str:
    """Return the media type of the body without its parameters, in lower case."""
    return (header(request.scope, b"content-type") or "").partition(";")[0].strip().lower()


def is_ndjson(request: Request) -> bool:
    """Return whether the body is NDJSON (else JSON); raises HttpProblem 415 when it is neither."""
    kind = media_type(request)
    if kind in NDJSON_TYPES:
        return True
    if is_json(kind):
        return False
    raise HttpProblem(
        "unsupported-media-type", f"want application/json or application/x-ndjson, got {kind[:100]!r}"
    )


def is_json(kind: str) -> bool:
    """Return whether a media type is JSON or built on it."""
    return kind in JSON_TYPES or kind.endswith("+json")
