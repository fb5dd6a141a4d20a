"""Cut time into intervals: minutes of UTC, and days of a place, which have 23 or 25 hours twice a year."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Final, Literal, get_args
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np

from service.errors import InvalidInput
from service.tracking.model import I64

Interval = Literal["1min", "5min", "15min", "60min", "day"]
INTERVALS: Final[tuple[str, ...]] = get_args(Interval)
MOST_INTERVALS: Final = 50_000  # of one reply: 34 days of minutes

_MINUTE_US: Final = 60_000_000
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


def interval_edges_us(start_us: int, end_us: int, interval: Interval, time_zone: str) -> I64:
    """Return the edges (B + 1,) of the intervals that lie in or touch [start_us, end_us).

    Intervals of minutes begin at whole multiples in UTC; the time zone tells only where a day begins.
    Raises InvalidInput for an unknown time zone or too many intervals.
    """
    if interval == "day":
        return _days(start_us, end_us, time_zone)
    length_us = int(interval.removesuffix("min")) * _MINUTE_US
    first, last = start_us // length_us, -(-end_us // length_us)
    if last - first > MOST_INTERVALS:
        raise InvalidInput.at("/end", f"want at most {MOST_INTERVALS} intervals, got {last - first}")
    return np.arange(first, last + 1, dtype=np.int64) * length_us


def _days(start_us: int, end_us: int, time_zone: str) -> I64:
    try:
        zone = ZoneInfo(time_zone)
    except (ZoneInfoNotFoundError, ValueError) as error:
        raise InvalidInput.at(
            "/tz", f"want an IANA time zone such as Europe/Berlin, got {time_zone!r}"
        ) from error
    if end_us - start_us > MOST_INTERVALS * 86_400_000_000:
        raise InvalidInput.at("/end", f"want at most {MOST_INTERVALS} days")
    day = _local(start_us, zone).date()
    edges = [_midnight_us(day.isoformat(), zone)]
    while edges[-1] < end_us:
        day += timedelta(days=1)
        edges.append(_midnight_us(day.isoformat(), zone))
    return np.array(edges, dtype=np.int64)


def local_text(time_us: int, time_zone: str, pattern: str) -> str:
    """Return a time as written at a place."""
    return _local(time_us, ZoneInfo(time_zone)).strftime(pattern)


def _local(time_us: int, zone: ZoneInfo) -> datetime:
    return (_EPOCH + timedelta(microseconds=time_us)).astimezone(zone)


def _midnight_us(day: str, zone: ZoneInfo) -> int:
    """Return when a local day begins; where the clock skips midnight, the first moment after."""
    midnight = datetime.fromisoformat(day).replace(tzinfo=zone)
    return (midnight - _EPOCH) // timedelta(microseconds=1)
