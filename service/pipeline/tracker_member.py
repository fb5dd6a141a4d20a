"""One tracker process and the sensors that it has, as the serving process remembers them."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from dataclasses import dataclass, field

from service.formats.sensor import SensorConfig
from service.pipeline.channel import Standing
from service.pipeline.line import Line
from service.pipeline.place import Place
from service.telemetry import Samples


@dataclass(slots=True)
class Member:
    """A sensor of a process."""

    config: SensorConfig  # for an epoch that begins without a state
    standing: Standing
    number: int  # by which its process names it
    leaving: bool = False
    anew: str | None = None  # why its next epoch begins, until its process was told


@dataclass(frozen=True, slots=True)
class ProcessHealth:
    """Where one tracker process stands."""

    running: bool
    pid: int | None
    restarts: int
    sensors: int


@dataclass(slots=True)
class Process:
    """One tracker process and all that outlives it."""

    index: int
    memory: int | None  # descriptor of what it shares with us, None after the end
    place: Place
    members: dict[str, Member] = field(default_factory=dict)
    guard: threading.RLock = field(default_factory=threading.RLock)  # over members, line, unsent news
    line: Line | None = None
    lifeline: int | None = None
    pid: int | None = None
    news: dict[str, int] = field(default_factory=dict)  # not sent yet
    restarts: int = 0
    before: Samples = field(default_factory=list)  # counted by the processes that ended
    counted: Samples = field(default_factory=list)  # by the one that runs
    damaged_before: int = 0
    damaged: int = 0
    done: bool = False  # it said that everything is stored
    thread: threading.Thread | None = None


def let_go(process: Process) -> None:
    """Close the connection to a process that ended."""
    if process.line is not None:
        process.line.close()
    if process.lifeline is not None:
        with suppress(OSError):
            os.close(process.lifeline)
    process.line = process.lifeline = None
