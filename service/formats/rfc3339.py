"""Turn RFC 3339 timestamps into integer microseconds since 1970-01-01T00:00:00Z and back, exactly."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_SECOND_US = 1_000_000
_LEAP_SECOND = 60
_LAST_MINUTE_OF_DAY = 23 * 60 + 59
_PATTERN = re.compile(
    r"(\d{4}-\d\d-\d\d)[Tt ](\d\d):(\d\d):(\d\d)(?:\.(\d{1,6}))?(?:[Zz]|([+-])([01]\d|2[0-3]):([0-5]\d))",
    re.ASCII,
)


def parse_time_us(text: str) -> int:
    """Return the instant of an RFC 3339 timestamp (any offset, at most six decimals) in microseconds.

    A leap second (23:59:60 UTC) is the first second of the next day, as in POSIX time.
    Raises ValueError, whose text says what is wrong, also for instants before 1970.
    """
    match = _PATTERN.fullmatch(text)
    if match is None:
        raise ValueError("want RFC 3339 with at most six decimals, such as 2025-05-12T06:00:00.050Z")
    day, hour, minute, second, fraction, sign, offset_hour, offset_minute = match.groups()
    leap = int(second) == _LEAP_SECOND
    try:
        local = datetime.fromisoformat(f"{day}T{hour}:{minute}:{'59' if leap else second}+00:00")
    except ValueError:
        raise ValueError(f"{text} is no date and time of the calendar") from None
    elapsed = local - _EPOCH
    seconds = elapsed.days * 86_400 + elapsed.seconds
    if sign is not None:
        offset_s = int(offset_hour) * 3600 + int(offset_minute) * 60
        seconds += -offset_s if sign == "+" else offset_s
    if leap:
        if seconds // 60 % (24 * 60) != _LAST_MINUTE_OF_DAY:
            raise ValueError(f"{text} has a leap second where there is none")
        seconds += 1
    if seconds < 0:
        raise ValueError(f"{text} is before 1970")
    return seconds * _SECOND_US + (int(fraction.ljust(6, "0")) if fraction else 0)


def format_time(time_us: int) -> str:
    """Return the time in UTC with `Z` and milliseconds; what is below a millisecond is cut off."""
    seconds, micros = divmod(time_us, _SECOND_US)
    return f"{_to_the_second(seconds)}.{micros // 1000:03d}Z"


def format_times(time_us: NDArray[np.int64]) -> list[str]:
    """Return each of the times (N,) as `format_time` does."""
    return list(np.datetime_as_string((time_us // 1000).astype("M8[ms]"), unit="ms", timezone="UTC").tolist())


def format_time_exact(time_us: int) -> str:
    """Return the time as `format_time` does, with six decimals where three would lose something."""
    seconds, micros = divmod(time_us, _SECOND_US)
    if micros % 1000 == 0:
        return f"{_to_the_second(seconds)}.{micros // 1000:03d}Z"
    return f"{_to_the_second(seconds)}.{micros:06d}Z"


def _to_the_second(seconds: int) -> str:
    return (_EPOCH + timedelta(seconds=seconds)).isoformat()[:19]
