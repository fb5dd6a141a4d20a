"""Faults other than a cut, each on a data directory of its own: full disk, damaged files, clocks, signals."""

from __future__ import annotations

import signal
import sqlite3
import tempfile
from collections.abc import Callable, Collection, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from service.chaos import child, process
from service.chaos.evidence import Evidence, gather
from service.chaos.process import Running
from service.chaos.served import (
    FULL,
    HTTP_ACCEPTED,
    HTTP_UNAVAILABLE,
    NEARLY_FULL,
    post,
    post_all,
    serve,
    serving,
)
from service.chaos.suite import Reference, run
from service.chaos.workload import HOUR_US, START_US, Batch
from service.errors import StorageError
from service.storage.shards import RESTARTED

Faults = list[str]


@dataclass(frozen=True, slots=True)
class Incident:
    """One fault, what must follow, and what was wrong with what did."""

    name: str
    wanted: str
    faults: tuple[str, ...]

    @property
    def sound(self) -> bool:
        """Whether all went as it must."""
        return not self.faults


def incidents(reference: Reference, folder: Path, only: Collection[str] = ()) -> Iterator[Incident]:
    """Cause each fault and yield what came of it."""
    for name, wanted, cause in _ALL:
        if (only and name not in only) or (not reference.watched and cause is _disk_full):
            continue
        with tempfile.TemporaryDirectory(dir=folder, prefix="wayside-chaos-") as data_dir:
            yield Incident(name, wanted, tuple(cause(Path(data_dir), reference)))


def _terminated(data_dir: Path, reference: Reference) -> Faults:
    with serving(data_dir) as (running, client):
        post_all(client, reference.work)
        code = _stop(running)
    faults = [] if code == 0 else [f"exit code {code}"]
    return faults + gather(data_dir).differences(reference.evidence)


def _second_process(data_dir: Path, reference: Reference) -> Faults:
    half = len(reference.work) // 2
    with serving(data_dir) as (running, client):
        post_all(client, reference.work[:half])
        second = process.start(lambda say: serve(say, data_dir)).end()
        post_all(client, reference.work[half:])
        _stop(running)
    told = [str(message.get("refused", "")) for message in second.said]
    faults = [] if any("another process" in text for text in told) else [f"it said {told}"]
    return faults + gather(data_dir).differences(reference.evidence)


def _disk_full(data_dir: Path, reference: Reference) -> Faults:
    return _refused_for_a_while(data_dir, reference, FULL)


def _disk_nearly_full(data_dir: Path, reference: Reference) -> Faults:
    return _refused_for_a_while(data_dir, reference, NEARLY_FULL)


def _refused_for_a_while(data_dir: Path, reference: Reference, state: str) -> Faults:
    """Post with the disk full at a third of the work: refused with Retry-After, and later taken."""
    third = len(reference.work) // 3
    faults: Faults = []
    with serving(data_dir) as (running, client):
        post_all(client, reference.work[:third])
        (data_dir / state).touch()
        reply = post(client, reference.work[third])
        while reply.status_code == HTTP_ACCEPTED and third < 2 * len(reference.work) // 3:
            third += 1  # the room is looked at now and then only
            reply = post(client, reference.work[third])
        if reply.status_code != HTTP_UNAVAILABLE or int(reply.headers.get("Retry-After", "0")) < 1:
            faults.append(f"{reply.status_code} with Retry-After {reply.headers.get('Retry-After')}")
        (data_dir / state).unlink()
        post_all(client, reference.work[third:])
        _stop(running)
    return faults + gather(data_dir).differences(reference.evidence)


def _clock_set_back(data_dir: Path, reference: Reference) -> Faults:
    work = reference.work
    half, later = 2 * len(work) // 5, len(work) // 2  # before the sensors' own clocks are set back
    for first, end, clock_us in (
        (0, half, START_US),
        (half, later, START_US - HOUR_US),
        (later, len(work), START_US),
    ):
        _run_at(data_dir, work[:end], first, clock_us)
    return gather(data_dir).differences(reference.evidence)


def _run_at(data_dir: Path, work: list[Batch], first: int, time_us: int) -> None:
    process.start(lambda say: child.post(say, data_dir, work, first, clock_us=lambda: time_us)).end()


def _snapshot_unreadable(data_dir: Path, reference: Reference) -> Faults:
    half = len(reference.work) // 2
    run(data_dir, reference.work[:half], 0)
    with closing(sqlite3.connect(data_dir / "rows.sqlite")) as database, database:
        database.execute("UPDATE snapshots SET state = substr(state, 1, length(state) / 2)")
    run(data_dir, reference.work, half)
    if not gather(data_dir).differences(reference.evidence):
        return []
    return _begun_anew(data_dir, reference, [])


def _segment_truncated(data_dir: Path, reference: Reference) -> Faults:
    half = len(reference.work) // 2
    run(data_dir, reference.work[:half], 0)
    newest = max((data_dir / "log").glob("segment-*.sqlite"))
    with closing(sqlite3.connect(newest)) as log:
        hit = [row[0] for row in log.execute("SELECT DISTINCT sensor FROM record")]
    with newest.open("r+b") as file:
        file.truncate(newest.stat().st_size // 2)
    run(data_dir, reference.work, half)
    return _begun_anew(data_dir, reference, hit)


def _begun_anew(data_dir: Path, reference: Reference, hit: list[str]) -> Faults:
    """Say what is wrong with a history that had to begin anew for some radars: each epoch must be told of."""
    found = gather(data_dir)
    faults = []
    for sensor_id, epoch in reference.evidence.epochs.items():
        if sensor_id in hit and found.epochs[sensor_id] <= epoch:
            faults.append(f"{sensor_id} has no new epoch")
        if found.events[sensor_id].count(RESTARTED) != found.epochs[sensor_id] - 1:
            faults.append(f"{sensor_id} has {found.events[sensor_id]} in epoch {found.epochs[sensor_id]}")
    if not _later_rows(found):
        faults.append("nothing is tracked after the restart")
    return faults


def _later_rows(found: Evidence) -> bool:
    newest = max(found.epochs.values())
    return any(newest in row[:3] for row in found.rows["tracks"])


def _stop(running: Running) -> int:
    """Tell a server to stop in order; return its exit code."""
    running.send(signal.SIGTERM)
    ended = running.end()
    if ended.signal is not None:
        raise StorageError(f"the server ended by signal {ended.signal}")
    return ended.code


_EQUAL = "rows and states as without it"
_ALL: tuple[tuple[str, str, Callable[[Path, Reference], Faults]], ...] = (
    ("SIGTERM right after the last post", f"all is folded and stored; {_EQUAL}", _terminated),
    ("second process on the same files", f"it is refused; {_EQUAL}", _second_process),
    ("disk full", f"503 with Retry-After, then it goes on by itself; {_EQUAL}", _disk_full),
    ("disk below 5 %", f"503 with Retry-After, then it goes on by itself; {_EQUAL}", _disk_nearly_full),
    ("host's clock an hour back for a while", _EQUAL, _clock_set_back),
    ("snapshot unreadable", "folded again from the log, or a new epoch with its event", _snapshot_unreadable),
    ("newest log file truncated", "a new epoch with its event", _segment_truncated),
)
