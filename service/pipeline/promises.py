"""Tell callers in event loops what became of their records: one call to each loop for a whole commit."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass


@dataclass(slots=True)
class Promise:
    """What a caller in an event loop waits for; all of one commit are told by one call to their loop.

    Waking the loop for each took a tenth of the time of a frame.
    """

    loop: asyncio.AbstractEventLoop
    future: asyncio.Future[list[int]]
    positions: list[int] | None = None
    error: BaseException | None = None

    def set_result(self, positions: list[int]) -> None:
        """Remember where the records stand."""
        self.positions = positions

    def set_exception(self, error: BaseException) -> None:
        """Remember why they were not written."""
        self.error = error

    def done(self) -> bool:
        """Return whether the outcome is known."""
        return self.positions is not None or self.error is not None


def tell(promises: Sequence[Promise]) -> None:
    """Give each caller its outcome, from any thread."""
    by_loop: dict[asyncio.AbstractEventLoop, list[Promise]] = defaultdict(list)
    for promise in promises:
        by_loop[promise.loop].append(promise)
    for loop, its in by_loop.items():
        with suppress(RuntimeError):  # the loop is closed: nobody waits any more
            loop.call_soon_threadsafe(_settle, its)


def _settle(promises: Sequence[Promise]) -> None:
    for promise in promises:
        if promise.future.done():  # the caller went away
            continue
        if promise.error is not None:
            promise.future.set_exception(promise.error)
        else:
            promise.future.set_result(promise.positions or [])
