"""Limit how often one key may ask, and how often one address may guess keys.

Counts are kept in memory by the library `limits`, in fixed windows. Replies carry the header fields of
draft-ietf-httpapi-ratelimit-headers-10: `RateLimit-Policy: "read";q=200;w=1`, `RateLimit: "read";r=199;t=1`.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from limits import RateLimitItem, parse
from limits.storage import MemoryStorage
from limits.strategies import FixedWindowRateLimiter

from service.api.problems import HttpProblem
from service.settings import Settings

GUESSES = "guesses"  # keys that are not valid, by the address they come from

Headers = dict[str, str]


@dataclass(frozen=True, slots=True)
class _Limit:
    item: RateLimitItem
    policy: str


class RateLimits:
    """The limits of one process, by the scope that a request needs."""

    def __init__(self, settings: Settings) -> None:
        """Read the limits of the settings; None is no limit."""
        self._limiter = FixedWindowRateLimiter(MemoryStorage())
        wanted = {
            "ingest": settings.rate_limit_ingest,
            "read": settings.rate_limit_read,
            "admin": settings.rate_limit_admin,
            GUESSES: settings.rate_limit_guesses,
        }
        self._limits = {name: _limit(name, text) for name, text in wanted.items() if text is not None}

    def count(self, name: str, key_id: str) -> Headers:
        """Count one request of a key and return the header fields to tell it; raises HttpProblem 429."""
        limit = self._limits.get(name)
        if limit is None:
            return {}
        granted = self._limiter.hit(limit.item, name, key_id)
        left = self._limiter.get_window_stats(limit.item, name, key_id)
        wait_s = max(math.ceil(left.reset_time - time.time()), 1)
        headers = {
            "RateLimit-Policy": limit.policy,
            "RateLimit": f'"{name}";r={left.remaining};t={wait_s}',
        }
        if not granted:
            raise _refusal(f"this key may ask {limit.item} for what needs the scope {name}", wait_s, headers)
        return headers

    def count_guess(self, address: str) -> None:
        """Count one key that is not valid; raises HttpProblem 429 for too many from one address.

        Valid keys from there stay welcome: many callers may share the address of a proxy.
        """
        limit = self._limits.get(GUESSES)
        if limit is not None and not self._limiter.hit(limit.item, GUESSES, address):
            stats = self._limiter.get_window_stats(limit.item, GUESSES, address)
            wait_s = max(math.ceil(stats.reset_time - time.time()), 1)
            raise _refusal("too many keys that are not valid came from this address", wait_s, {})


def _limit(name: str, text: str) -> _Limit:
    item = parse(text)
    return _Limit(item, f'"{name}";q={item.amount};w={item.get_expiry()}')


def _refusal(detail: str, wait_s: int, headers: Headers) -> HttpProblem:
    return HttpProblem("too-many-requests", detail, {**headers, "Retry-After": str(wait_s)})
