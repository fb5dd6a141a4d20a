"""The thread that keeps the database small and looks now and then since when rows are kept."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import structlog
from sqlalchemy import Engine

from service.pipeline.periodic import Periodic
from service.settings import Settings
from service.storage.database import connection as reading
from service.storage.oldest import oldest_rows
from service.storage.upkeep import Retention, keep_up

LOOK_S = 60.0  # between two looks at the oldest rows: their ages are told in days

_log = structlog.get_logger(__name__)


def retention_of(settings: Settings) -> Retention:
    """Return how long rows stay."""
    return Retention(
        settings.states_days,
        settings.tracks_days,
        settings.events_days,
        settings.counts_days,
        settings.lane_maps_days,
        settings.audit_days,
    )


class Keeping:
    """Upkeep at the start and each hour, a look at the oldest rows each minute."""

    def __init__(self, database: Engine, settings: Settings, clock_us: Callable[[], int]) -> None:
        self._database = database
        self._retention = retention_of(settings)
        self._interval_s = settings.upkeep_interval_s
        self._clock_us = clock_us
        self._thread = Periodic("upkeep", min(LOOK_S, self._interval_s), self._look)
        self._kept_up_s: float | None = None  # monotonic
        self.oldest_us: Mapping[
            str, int
        ] = {}  # since when rows of each kind are kept; replaced, never changed

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End after the transaction that runs."""
        self._thread.stop()

    def _look(self) -> None:
        self._keep_up_if_due()
        with reading(self._database) as connection:
            self.oldest_us = oldest_rows(connection)

    def _keep_up_if_due(self) -> None:
        now_s = time.monotonic()
        if self._kept_up_s is not None and now_s - self._kept_up_s < self._interval_s:
            return
        self._kept_up_s = now_s
        expired = keep_up(self._database, self._retention, now_us=self._clock_us())
        _log.debug("upkeep done", state_blocks=expired.state_blocks, tracks=expired.tracks)
