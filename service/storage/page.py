"""One page of a long list and the opaque cursor that continues it (keyset paging).

The cursor holds the sort key of the last item given, so rows that come or go meanwhile neither repeat nor
hide others.
"""

from __future__ import annotations

import base64
import binascii
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from service.errors import InvalidInput

LIMIT_MAX: Final = 10_000  # items of one page; whoever wants more at once streams

_INTEGER_BITS: Final = 63  # what a BIGINT column can be compared with

Key = tuple[str | int, ...]  # the sort key of an item
Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Page(Generic[Item]):
    """Items in a stable order; `next_cursor` is None at the end of the list."""

    items: tuple[Item, ...]
    next_cursor: str | None


def cut(found: Sequence[Item], limit: int, key: Callable[[Item], Key]) -> Page[Item]:
    """Return the page of the first `limit` items found, where `limit + 1` were asked of the database."""
    items = tuple(found[:limit])
    return Page(items, write_cursor(key(items[-1])) if len(found) > limit else None)


def check_limit(limit: int) -> int:
    """Return the limit if a page may have it; raises InvalidInput otherwise."""
    if not 1 <= limit <= LIMIT_MAX:
        raise InvalidInput.at("/limit", f"want 1 to {LIMIT_MAX}, got {limit}")
    return limit


def write_cursor(key: Key) -> str:
    """Return the sort key as text that is safe in a URL."""
    return base64.urlsafe_b64encode(json.dumps(key, separators=(",", ":")).encode()).decode().rstrip("=")


def read_cursor(text: str, *kinds: type[str | int]) -> Key:
    """Return the sort key of a cursor; raises InvalidInput when it is not one of this list."""
    try:
        padded = text.encode("ascii") + b"=" * (-len(text) % 4)
        key = json.loads(base64.b64decode(padded, altchars=b"-_", validate=True))
    except (UnicodeError, binascii.Error, ValueError) as error:
        raise InvalidInput.at("/cursor", "is not a cursor that this service gave") from error
    if not isinstance(key, list) or [type(part) for part in key] != list(kinds) or not _comparable(key):
        raise InvalidInput.at("/cursor", "is not a cursor of this list")
    return tuple(key)


def _comparable(key: list[str | int]) -> bool:
    # PostgreSQL refuses text with a zero byte and integers beyond 64 bits; no key of ours has either
    return all(
        "\0" not in part if isinstance(part, str) else part.bit_length() <= _INTEGER_BITS for part in key
    )
