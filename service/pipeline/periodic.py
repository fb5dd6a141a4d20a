"""A thread that does one thing again and again until it is told to stop."""

from __future__ import annotations

import threading
from collections.abc import Callable

import structlog

from service.errors import WaysideError

_log = structlog.get_logger(__name__)


class Periodic:
    """Calls `act` at once, then each time `interval_s` after it returned.

    What `act` raises is logged and it is called again after the interval: a fault that passes, such as a
    database that is away, must not end the work for good.
    """

    def __init__(self, name: str, interval_s: float, act: Callable[[], None]) -> None:
        self._interval_s = interval_s
        self._act = act
        self._stopped = threading.Event()
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
            except Exception:  # noqa: BLE001 - told with its trace, and tried again
                _log.exception("put off by a fault of the program", thread=self._thread.name)
            self._stopped.wait(self._interval_s)
