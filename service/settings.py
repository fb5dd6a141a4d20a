"""Everything that can be set from outside: `WAYSIDE_<NAME>` in the environment or in a file `.env`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import limits
from pydantic import AfterValidator, ByteSize, Field
from pydantic_settings import BaseSettings, SettingsConfigDict

PositiveBytes = Annotated[ByteSize, Field(gt=0)]
PositiveSeconds = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Days = Annotated[int, Field(ge=1, le=36_500)]


def _rate(text: str | None) -> str | None:
    if text is None or text == "none":
        return None
    try:
        limits.parse(text)
    except ValueError:
        raise ValueError(f'want a rate such as "200/second" or "none", got {text!r}') from None
    return text


Rate = Annotated[str | None, AfterValidator(_rate)]
TRACKERS_MOST = 4  # unless more are asked for: each costs tens of megabytes, sensors or not


class Settings(BaseSettings):
    """The settings of one process, with their defaults. Sizes accept units, such as "2GiB"."""

    model_config = SettingsConfigDict(env_prefix="WAYSIDE_", env_file=".env", extra="ignore", frozen=True)

    data_dir: Path = Path("data")  # the log, and the database unless `database_url` names another
    database_url: str | None = None  # sqlite:///path or postgresql://...

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65_535)] = 8321  # 0: any free one
    # Names that the Host header may hold besides those of the loopback; elsewhere than there, none means any.
    allowed_hosts: tuple[str, ...] = ()
    body_limit_bytes: PositiveBytes = ByteSize(16 * 2**20)  # of one request, after decompression
    clock_ahead_limit_s: PositiveSeconds = 60.0  # frames further ahead of the host's clock are refused

    stream_rate_hz: Annotated[float, Field(gt=0, le=50)] = (
        10.0  # views a second that a live stream carries at most
    )

    # How often one key may ask for what needs a scope: "200/second", "10 per minute", or "none" for no limit.
    rate_limit_ingest: Rate = "5000/second"
    rate_limit_read: Rate = "500/second"
    rate_limit_admin: Rate = "300/minute"
    rate_limit_guesses: Rate = "30/minute"  # keys that are not valid, by address

    log_limit_bytes: PositiveBytes = ByteSize(2 * 2**30)  # of all sensors together; the oldest segments go
    log_segment_bytes: PositiveBytes = ByteSize(256 * 2**20)
    untracked_hours: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 24.0  # of a sensor that failed
    disk_free_min_share: Annotated[float, Field(ge=0, lt=1)] = 0.05  # below it frames get 503

    # Processes that track beside the serving one; 0: in the serving process itself. None: one a processor,
    # four at most, and 0 on a machine with one processor.
    tracker_processes: Annotated[int, Field(ge=0, le=64)] | None = None

    flush_interval_s: PositiveSeconds = 1.0  # rows and cursor together
    snapshot_interval_s: PositiveSeconds = 10.0  # state, whichever of the two comes first
    snapshot_frames: Annotated[int, Field(ge=1)] = 200

    # Retention counts from the day on which a row was stored, not from the time it speaks of.
    states_days: Days = 7
    tracks_days: Days = 400
    events_days: Days = 400
    counts_days: Days = 400
    lane_maps_days: Days = 400  # the one in force, and those that counts and changes name, stay
    audit_days: Days = 400
    upkeep_interval_s: PositiveSeconds = 3600.0

    log_level: Literal["debug", "info", "warning", "error"] = "info"
    log_format: Literal["auto", "console", "json"] = "auto"  # auto: console on a terminal, else JSON

    @property
    def tracker_process_count(self) -> int:
        """How many tracker processes there are."""
        if self.tracker_processes is not None:
            return self.tracker_processes
        affinity = getattr(os, "sched_getaffinity", None)  # Linux only
        processors = len(affinity(0)) if affinity is not None else os.cpu_count() or 1
        return min(processors, TRACKERS_MOST) if processors > 1 else 0

    @property
    def rows_url(self) -> str:
        """The address of the database: the one set, else a SQLite file in the data directory."""
        return self.database_url or f"sqlite:///{self.data_dir / 'rows.sqlite'}"

    @property
    def log_dir(self) -> Path:
        """Where the embedded log keeps its segments."""
        return self.data_dir / "log"
