"""Decompress request bodies (gzip, zstd) and never hold more than a limit, whatever the data claim.

zstd comes from the standard library (Python 3.14 and newer) or its backport. A decoder of RFC 9659 need not
take windows above 8 MB, so a small body cannot ask for a large buffer.
"""

from __future__ import annotations

import sys
import zlib
from typing import Protocol

from service.api.problems import HttpProblem

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

ENCODINGS = frozenset({"gzip", "x-gzip", "zstd"})
MEMBERS_MAX = 100  # gzip members or zstd frames of one body; each costs a fresh decoder

_GZIP_WINDOW = 16 + zlib.MAX_WBITS  # zlib: expect a gzip header
_ZSTD_WINDOW_LOG = 23  # 8 MB


class _Decoder(Protocol):
    """What `zlib.decompressobj` (wrapped below) and `zstd.ZstdDecompressor` have in common."""

    @property
    def eof(self) -> bool: ...
    @property
    def unused_data(self) -> bytes: ...
    def decompress(self, data: bytes, max_length: int) -> bytes: ...


def inflate(body: bytes, encoding: str, limit_bytes: int) -> bytes:
    """Return the body as it was before gzip or zstd, also when it is several members one after the other.

    Raises HttpProblem 413 when it has more than `limit_bytes`, and 400 when it is damaged or truncated.
    """
    name = "zstd" if encoding == "zstd" else "gzip"
    parts: list[bytes] = []
    given = 0
    for _ in range(MEMBERS_MAX):
        if not body:
            return b"".join(parts)
        decoder = _zstd() if name == "zstd" else _gzip()
        try:
            part = decoder.decompress(body, limit_bytes - given + 1)
        except (zlib.error, zstd.ZstdError) as error:
            raise HttpProblem("bad-request", f"the {name} data are damaged: {error}") from None
        given += len(part)
        if given > limit_bytes:
            raise too_large(limit_bytes)
        parts.append(part)
        if not decoder.eof:
            raise HttpProblem("bad-request", f"the {name} data are truncated")
        body = decoder.unused_data
    if body:
        raise HttpProblem("bad-request", f"the {name} data have more than {MEMBERS_MAX} members")
    return b"".join(parts)


def too_large(limit_bytes: int) -> HttpProblem:
    """Return the refusal of a body above the limit, before or after decompression."""
    return HttpProblem("too-large", f"the body has more than {limit_bytes} bytes")


def _gzip() -> _Decoder:
    return zlib.decompressobj(_GZIP_WINDOW)


def _zstd() -> _Decoder:
    return zstd.ZstdDecompressor(options={zstd.DecompressionParameter.window_log_max: _ZSTD_WINDOW_LOG})
