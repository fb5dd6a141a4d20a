"""A thread that does one thing again and again until it is told to stop."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable

import structlog

from service.errors import WaysideError

TRACE_AGAIN_S = 3600.0  # between two traces of one fault of the program that lasts
TELL_AGAIN_S = 60.0  # between two lines about it

_log = structlog.get_logger(__name__)


class Periodic:
    """Calls `act` at once, then each time `interval_s` after it returned.

    What `act` raises is logged and it is called again after the interval: a fault that passes, such as a
    database that is away, must not end the work for good. A fault of the program is logged with its trace
    when it is another than the last one or an hour has passed, else by a line each minute.
    """

    def __init__(self, name: str, interval_s: float, act: Callable[[], None]) -> None:
        self._interval_s = interval_s
        self._act = act
        self._stopped = threading.Event()
        self._fault: object = None  # what tells the last fault of the program from others
        self._traced_s = self._told_s = 0.0  # monotonic, when it was logged with its trace, and at all
        self._thread = threading.Thread(target=self._run, name=f"wayside-{name}", daemon=True)

    def start(self) -> None:
        """Begin; raises RuntimeError the second time."""
        self._thread.start()

    def stop(self) -> None:
        """End after the call that runs; does nothing where it never began."""
        self._stopped.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        while not self._stopped.is_set():
            try:
                self._act()
            except WaysideError as error:
                _log.warning("put off", thread=self._thread.name, reason=str(error))
            except Exception as error:  # noqa: BLE001 - told, and tried again
                self._tell(error)
            self._stopped.wait(self._interval_s)

    def _tell(self, error: Exception) -> None:
        """Log a fault of the program; two are the same when their type and the calls down to them are."""
        calls = traceback.walk_tb(error.__traceback__)
        fault = type(error), [(frame.f_code.co_filename, line) for frame, line in calls]
        now_s = time.monotonic()
        if fault != self._fault or now_s - self._traced_s >= TRACE_AGAIN_S:
            self._fault, self._traced_s, self._told_s = fault, now_s, now_s
            _log.error("put off by a fault of the program", thread=self._thread.name, exc_info=error)
        elif now_s - self._told_s >= TELL_AGAIN_S:
            self._told_s = now_s
            told = f"{type(error).__name__}: {error}"
            _log.error("still put off by a fault of the program", thread=self._thread.name, error=told)
