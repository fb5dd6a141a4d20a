"""Choose the form of a reply from `?format=` or the Accept header."""

from __future__ import annotations

from collections.abc import Sequence

from fastapi import Request

from service.api.problems import HttpProblem
from service.errors import InvalidInput

MEDIA_TYPES = {
    "json": "application/json",
    "ndjson": "application/x-ndjson",
    "csv": "text/csv",
    "geojson": "application/geo+json",
    "parquet": "application/vnd.apache.parquet",
    "pems": "text/csv",  # only by `?format=`: CSV is offered before it
}


def choose_format(request: Request, wanted: str | None, offered: Sequence[str]) -> str:
    """Return the offered format that the client likes best; the first offered one when it does not care.

    Raises InvalidInput for an unknown `?format=`, HttpProblem 406 when nothing offered is acceptable.
    """
    if wanted is not None:
        if wanted not in offered:
            raise InvalidInput.at("/format", f"want one of {', '.join(offered)}, got {wanted!r}")
        return wanted
    accept = request.headers.get("accept", "").strip()
    if not accept:
        return offered[0]
    ranges = _ranges(accept)
    best = max(offered, key=lambda name: _quality(ranges, MEDIA_TYPES[name]))  # the first of equals
    if _quality(ranges, MEDIA_TYPES[best]) <= 0:
        types = ", ".join(MEDIA_TYPES[name] for name in offered)
        raise HttpProblem("not-acceptable", f"can give {types}; Accept was {accept[:200]!r}")
    return best


def _ranges(accept: str) -> list[tuple[str, float]]:
    ranges = []
    for item in accept.split(","):
        name, *parameters = (part.strip().lower() for part in item.split(";"))
        quality = next((p.partition("=")[2] for p in parameters if p.startswith("q=")), "1")
        try:
            ranges.append((name, float(quality)))
        except ValueError:
            ranges.append((name, 0.0))
    return ranges


def _quality(ranges: Sequence[tuple[str, float]], media_type: str) -> float:
    """Return the quality of a media type by the most specific range that covers it (RFC 9110, 12.5.1)."""
    for pattern in (media_type, f"{media_type.partition('/')[0]}/*", "*/*"):
        found = [quality for name, quality in ranges if name == pattern]
        if found:
            return max(found)
    return 0.0
