"""Cut the power, or kill the process, at a chosen moment of its work on the files.

The moments are told from SQLite's statements (a frame goes into the log, a snapshot into the database, ...)
and from the writes and syncs below them, so that a cut can fall before, inside or after a transaction, and
the same plan cuts at the same place again.
"""

from __future__ import annotations

import mmap
import os
import random
import signal
import sqlite3
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Any

from service.chaos.disk import Disk, Operation, available
from service.pipeline.segments import Segment


class Phase(StrEnum):
    """What the process is doing when it is cut."""

    BATCH = "batch"  # frames go into the log
    REPLY = "reply"  # frames are in the log, and their sender has not heard so
    FLUSH = "flush"  # rows and cursor go into the database
    SNAPSHOT = "snapshot"  # the state goes in, in the same transaction
    SEGMENT = "segment change"  # the log begins a new file
    DROP = "segment drop"  # the log lets its oldest file go
    MIGRATION = "migration"  # tables are made
    OPENING = "opening"  # an earlier cut is being recovered from
    ANY = "any write"


class Kind(StrEnum):
    """What the cut is."""

    KILL = "kill -9"  # the machine lives on: what was written stays
    POWER = "power cut"  # nothing that was not synced is left
    TORN = "torn power cut"  # some of what was not synced is left, in no order
    GROUP = "kill -9 of service and trackers"  # where trackers are processes: all of them at once
    TRACKER = "kill -9 of one tracker"  # the service goes on, and starts another


@dataclass(frozen=True, slots=True)
class Plan:
    """Where one run is cut."""

    phase: Phase
    occurrence: int  # which moment of that phase, from 1
    delay: int  # operations on the disk after that moment; -1: at the moment itself
    kind: Kind
    seed: int  # of what a torn cut leaves, and which tracker is killed
    processes: int = 0  # that track


_STATEMENTS = (
    ("INSERT INTO record", Phase.BATCH),
    ("UPDATE shards SET cursor", Phase.FLUSH),
    ("INSERT INTO snapshots", Phase.SNAPSHOT),
    ("CREATE TABLE IF NOT EXISTS record", Phase.SEGMENT),
)
_OF_TRACKERS = frozenset({Phase.FLUSH, Phase.SNAPSHOT})  # which write the database
_connect = sqlite3.connect
_SCHEMA = ("CREATE ", "INSERT INTO alembic_version", "ALTER TABLE", "DROP ")


class Cutter:
    """Watches this process's files, and ends it where the plan says; without a plan it only counts."""

    def __init__(self, plan: Plan | None) -> None:
        self._plan = plan
        self._guard = threading.RLock()
        self._left: int | None = None  # operations until the cut, once the moment has come
        self.seen: Counter[str] = Counter()
        self.disk: Disk | None = None
        self.migrating = False
        self.trackers: Callable[[], Sequence[int]] = tuple  # ids of the processes that run
        self._group: int | None = None
        self._in_tracker = False
        self._done = mmap.mmap(-1, 1)  # shared with the processes that are forked from this one

    def lead_group(self) -> None:
        """Become the leader of a group of processes of its own, all of which a cut may end."""
        os.setpgid(0, 0)
        self._group = os.getpid()

    def enter_tracker(self) -> None:
        """Take in that this is a tracker process now; it counts from here on."""
        self._in_tracker = True
        self._left = None
        self.seen.clear()
        if self.disk is not None:
            self.disk.enter_fork()

    @property
    def done(self) -> bool:
        """Whether the cut was made, here or in a process forked from this one."""
        return self._done[0] != 0

    def install(self) -> None:
        """Begin to watch; connections that are open already are not seen."""
        if available():
            self.disk = Disk(self._operation)
            self.disk.install()
        for module in (sqlite3, sqlite3.dbapi2):  # of this process, which ends with the run
            module.connect = self._connect  # type: ignore[attr-defined]
        sys.addaudithook(self._hear)
        append = Segment.append

        def append_and_reply(segment: Segment, rows: Iterable[tuple[str, int, bytes]]) -> None:
            append(segment, rows)
            self._moment(Phase.REPLY)

        Segment.append = append_and_reply  # type: ignore[method-assign,assignment]

    def _connect(self, path: str, *args: Any, **options: Any) -> sqlite3.Connection:  # noqa: ANN401 - as sqlite3's
        connection: sqlite3.Connection = _connect(path, *args, **options)
        connection.set_trace_callback(partial(self._statement, str(path)))
        return connection

    def _hear(self, event: str, arguments: tuple[object, ...]) -> None:
        """Follow Python's audit events: files that are removed."""
        if event == "os.remove" and str(arguments[0]).endswith(".sqlite"):
            self._moment(Phase.DROP)

    def _statement(self, path: str, text: str) -> None:
        text, in_log = text.lstrip(), "segment-" in path
        if self.migrating and not in_log and text.startswith(_SCHEMA):
            self._moment(Phase.MIGRATION)
        for begin, phase in _STATEMENTS:
            if text.startswith(begin) and in_log == (phase in {Phase.BATCH, Phase.SEGMENT}):
                self._moment(phase)

    def _operation(self, operation: Operation) -> bool:
        with self._guard:
            if self._left is not None:
                self._left -= 1
                if self._left < 0:
                    self.cut()
        self._moment(Phase.ANY)
        self.seen[operation.kind] += 1
        return True

    def _moment(self, phase: Phase) -> None:
        with self._guard:
            self.seen[phase] += 1
            plan = self._plan
            wanted = Phase.ANY if plan is not None and plan.phase is Phase.OPENING else plan and plan.phase
            if (
                plan is None
                or self._left is not None
                or phase is not wanted
                or not self._is_here(plan, wanted)
            ):
                return
            if self.seen[phase] == plan.occurrence:
                if plan.delay < 0 or phase is Phase.REPLY:
                    self.cut()
                self._left = plan.delay

    def _is_here(self, plan: Plan, phase: Phase) -> bool:
        """Return whether it is this process whose moments are meant."""
        if self.done or not plan.processes:
            return not self.done
        tracker = phase in _OF_TRACKERS or (phase is Phase.ANY and plan.kind is Kind.TRACKER)
        return self._in_tracker == tracker

    def cut(self) -> None:
        """End this process as the plan says; returns only where it is another one that ends."""
        self._left = None
        if self.done:  # by another process, at its moment
            return
        self._done[0] = 1
        if self._plan is not None and self._plan.kind is Kind.GROUP and self._group is not None:
            os.killpg(self._group, signal.SIGKILL)
        if self._plan is not None and self._plan.kind is Kind.TRACKER and not self._in_tracker:
            pids = self.trackers()
            if pids:
                os.kill(pids[self._plan.seed % len(pids)], signal.SIGKILL)
            else:
                self._done[0] = 0  # none runs at this moment
            return
        if self._plan is not None and self.disk is not None and self._plan.kind in {Kind.POWER, Kind.TORN}:
            torn = self._plan.kind is Kind.TORN
            self.disk.lose(random.Random(self._plan.seed) if torn else None)  # noqa: S311 - no secret
        os.kill(os.getpid(), signal.SIGKILL)
        signal.pause()
