"""Count the frames of each minute and the time that they covered: what a count of it can be worth."""

from __future__ import annotations

from dataclasses import dataclass, replace

from service.traffic.records import MINUTE_US, Received


@dataclass(frozen=True, slots=True)
class Coverage:
    """The minutes that may still change, and the newest frame."""

    minutes: tuple[Received, ...]
    last_us: int | None
    told: bool  # everything known was given out


NOTHING_RECEIVED = Coverage((), None, told=True)


def receive(state: Coverage, time_us: int, rate_hz: float, blind_s: float) -> Coverage:
    """Return the coverage after one more frame.

    A frame stands for the time since the one before; after a blind stretch, and at first, for one period.
    """
    begin_us = max(time_us - round(1e6 / rate_hz), time_us // MINUTE_US * MINUTE_US)
    if state.last_us is not None and time_us - state.last_us <= blind_s * 1e6:
        begin_us = state.last_us
    expected = round(60 * rate_hz)
    newest = state.minutes[-1] if state.minutes else None
    if newest is not None and newest.minute == begin_us // MINUTE_US == time_us // MINUTE_US:
        observed_us = newest.observed_us + time_us - begin_us
        grown = Received(newest.minute, newest.frames + 1, newest.expected, observed_us)
        return Coverage((*state.minutes[:-1], grown), time_us, told=False)
    minutes = {part.minute: part for part in state.minutes}
    now = time_us // MINUTE_US
    for minute in range(begin_us // MINUTE_US, now + 1):
        share_us = min(time_us, (minute + 1) * MINUTE_US) - max(begin_us, minute * MINUTE_US)
        part = minutes.get(minute) or Received(minute, 0, expected, 0)
        frames = part.frames + (minute == now)
        minutes[minute] = replace(part, frames=frames, observed_us=part.observed_us + share_us)
    return Coverage(tuple(minutes[minute] for minute in sorted(minutes)), time_us, told=False)
