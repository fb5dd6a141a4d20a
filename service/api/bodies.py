"""Read request bodies with a limit that holds before and after decompression."""

from __future__ import annotations

import zlib

from fastapi import Request

from service.api.problems import HttpProblem

JSON_TYPES = frozenset({"", "application/json"})  # a client that names no type is taken to mean JSON
NDJSON_TYPES = frozenset({"application/x-ndjson", "application/jsonl", "application/jsonlines"})

_GZIP_WINDOW = 16 + zlib.MAX_WBITS  # zlib: expect a gzip header


async def read_body(request: Request, limit_bytes: int) -> bytes:
    """Return the body, decompressed; raises HttpProblem 413 as soon as it outgrows the limit, 415 or 400."""
    encoding = request.headers.get("content-encoding", "identity").strip().lower()
    if encoding not in {"identity", "gzip", "x-gzip"}:
        raise HttpProblem(
            "unsupported-media-type",
            f"want Content-Encoding gzip or none, got {encoding!r}",
            {"Accept-Encoding": "gzip"},
        )
    declared = request.headers.get("content-length", "")
    if declared.isdigit() and int(declared) > limit_bytes:
        raise _too_large(limit_bytes)
    inflater = None if encoding == "identity" else _Inflater(limit_bytes)
    parts: list[bytes] = []
    received = 0
    async for chunk in request.stream():
        received += len(chunk)
        if received > limit_bytes:
            raise _too_large(limit_bytes)
        parts.append(chunk if inflater is None else inflater.feed(chunk))
    if inflater is not None:
        inflater.finish()
    return b"".join(parts)


def media_type(request: Request) -> str:
    """Return the media type of the body without its parameters, in lower case."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


def is_ndjson(request: Request) -> bool:
    """Return whether the body is NDJSON (else JSON); raises HttpProblem 415 when it is neither."""
    kind = media_type(request)
    if kind in NDJSON_TYPES:
        return True
    if kind in JSON_TYPES or kind.endswith("+json"):
        return False
    raise HttpProblem(
        "unsupported-media-type", f"want application/json or application/x-ndjson, got {kind!r}"
    )


class _Inflater:
    """Decompresses gzip (also several members one after the other) and never holds more than the limit."""

    def __init__(self, limit_bytes: int) -> None:
        self._limit_bytes = limit_bytes
        self._given = 0
        self._inner = zlib.decompressobj(_GZIP_WINDOW)
        self._begun = False

    def feed(self, chunk: bytes) -> bytes:
        """Return what the chunk adds."""
        parts: list[bytes] = []
        while chunk:
            if self._inner.eof:
                self._inner = zlib.decompressobj(_GZIP_WINDOW)
            self._begun = True
            try:
                part = self._inner.decompress(chunk, self._limit_bytes - self._given + 1)
            except zlib.error as error:
                raise HttpProblem("bad-request", f"the gzip data are damaged: {error}") from None
            self._given += len(part)
            if self._given > self._limit_bytes:
                raise _too_large(self._limit_bytes)
            parts.append(part)
            chunk = self._inner.unused_data if self._inner.eof else self._inner.unconsumed_tail
        return b"".join(parts)

    def finish(self) -> None:
        """Raise HttpProblem when the data stop in the middle of a member."""
        if self._begun and not self._inner.eof:
            raise HttpProblem("bad-request", "the gzip data are truncated")


def _too_large(limit_bytes: int) -> HttpProblem:
    return HttpProblem("too-large", f"the body has more than {limit_bytes} bytes")
