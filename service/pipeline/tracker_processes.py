"""The tracker processes as the serving process sees them: it tells them of records and hears of tracks.

Each process has sensors of its own, as long as the service runs. One that ends by itself is started again
with the same sensors; it goes on from the snapshots in the database, as after a restart of the whole service.
One that hangs is killed. A record over which that happens again and again is set aside.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from contextlib import suppress
from dataclasses import replace
from typing import Any, Protocol

import orjson
import structlog

from service.errors import StorageError, WaysideError
from service.formats.sensor import SensorConfig
from service.pipeline.blame import BlameBook
from service.pipeline.channel import Channel, Standing
from service.pipeline.folding import DRAIN_S
from service.pipeline.line import Kind, Line, LineClosed
from service.pipeline.live import LiveEntry
from service.pipeline.live_wire import decode_entry
from service.pipeline.log import FrameLog
from service.pipeline.nursery import Nursery
from service.pipeline.place import Stall, open_place, shared_memory
from service.pipeline.records import TickRecord
from service.pipeline.tracker_member import Member, Process, ProcessHealth, let_go
from service.pipeline.tracker_process import WORK
from service.telemetry import Samples, Telemetry, added

LISTEN_S = 0.2  # longest wait before what is left to send is tried again
CALM_S = 30.0  # a process that lived as long is started again at once, others after a growing pause
PAUSE_S, PAUSE_MOST_S = 0.1, 10.0
HUNG_S = 60.0  # without a sign of life: longer than any wait for the database, or a flush
STOP_S = 2 * DRAIN_S  # for a process to fold, and to store what it folded

_log = structlog.get_logger(__name__)


class Owner(Protocol):
    """Who has the sensors' doors and the readers."""

    def show(self, entry: LiveEntry, *, frame: bool) -> None:
        """Take a newer view of a sensor."""
        ...

    def gone(self, sensor_id: str) -> None:
        """Take in that a sensor was let go."""
        ...

    def folded(self, sensor_id: str, position: int) -> None:
        """Take in how far a sensor is folded."""
        ...


class TrackerProcesses:
    """A number of tracker processes that share the sensors."""

    def __init__(  # noqa: PLR0913, PLR0917 - its collaborators
        self,
        nursery: Nursery,
        count: int,
        log: FrameLog,
        owner: Owner,
        telemetry: Telemetry,
        blames: BlameBook,
    ) -> None:
        self._nursery = nursery
        self._frame_log = log
        self._owner = owner
        self._telemetry = telemetry
        memories = [shared_memory() for _ in range(count)]
        self._processes = [
            Process(index, memory, open_place(memory)) for index, memory in enumerate(memories)
        ]
        self._blames = blames
        self._of: dict[str, Process] = {}  # replaced, never changed
        self._adding = threading.Lock()
        self._stopping = threading.Event()

    # ------------------------------------------------------------- from other threads

    def start(self) -> None:
        """Start the processes, with the sensors that were added so far."""
        for process in self._processes:
            self._begin(process)
            process.thread = threading.Thread(
                target=self._look_after, args=(process,), name=f"wayside-tracker-{process.index}", daemon=True
            )
            process.thread.start()

    def stop(self) -> None:
        """Have what is logged folded while there is time, and stored, and wait for the processes' end."""
        for process in self._processes:
            with process.guard:
                self._stopping.set()
                self._send_news(process)
                if process.line is not None:
                    process.line.send(Kind.STOP)
        deadline_s = time.monotonic() + STOP_S
        for process in self._processes:
            if process.thread is not None:
                process.thread.join(max(0.0, deadline_s - time.monotonic()))
            if not process.done:
                _log.warning("a tracker process did not end in order", process=process.index)
            with process.guard:
                let_go(process)
                if process.memory is not None:
                    os.close(process.memory)
                process.memory = None

    def add(self, channel: Channel[Any], config: SensorConfig) -> None:
        """Give a sensor to the process that has the fewest; its state is found again there."""
        with self._adding:
            process = min(self._processes, key=lambda one: (len(one.members), one.index))
            self._of = {**self._of, channel.sensor_id: process}
        with process.guard:
            member = process.members[channel.sensor_id] = Member(config, channel.standing(), channel.number)
            self._send_member(process, member)

    def leave(self, sensor_id: str) -> None:
        """Let a sensor go once all that is logged of it is folded and stored."""
        process = self._of.get(sensor_id)
        if process is None:
            return
        with process.guard:
            member = process.members.get(sensor_id)
            if member is not None:
                member.leaving = True
                if process.line is not None:
                    process.line.send(Kind.LEAVE, sensor_id.encode())

    def restart(self, config: SensorConfig, anew: str | None) -> None:
        """Track a sensor that failed once more; `anew`: why its next epoch begins."""
        process = self._of.get(config.sensor_id)
        if process is None:
            return
        with process.guard:
            member = process.members.get(config.sensor_id)
            if member is None:
                return
            member.config, member.anew = config, anew
            member.standing = replace(member.standing, failure=None)
            self._send_member(process, member)

    def reconfigure(self, config: SensorConfig) -> None:
        """Take in a new configuration; the tracker hears of it by the log."""
        process = self._of.get(config.sensor_id)
        member = None if process is None else process.members.get(config.sensor_id)
        if member is not None:
            member.config = config

    def news(self, positions: dict[str, int]) -> None:
        """Tell the processes of new records; never waits."""
        for process in self._processes:
            mine = {name: last for name, last in positions.items() if self._of.get(name) is process}
            if mine:
                with process.guard:
                    process.news.update(mine)
                    self._send_news(process)

    def standing(self, sensor_id: str) -> Standing | None:
        """Return where a sensor stands as far as it was told, None for one that is not here."""
        process = self._of.get(sensor_id)
        member = None if process is None else process.members.get(sensor_id)
        return None if member is None else member.standing

    @property
    def alive(self) -> bool:
        """Whether every process runs."""
        return all(process.line is not None for process in self._processes)

    def health(self) -> tuple[ProcessHealth, ...]:
        """Return where each process stands."""
        return tuple(
            ProcessHealth(one.line is not None, one.pid, one.restarts, len(one.members))
            for one in self._processes
        )

    def samples(self) -> list[Samples]:
        """Return what the processes counted, for the metrics."""
        return [added(process.before, process.counted) for process in self._processes]

    @property
    def damaged_records(self) -> int:
        """Records that the processes left out as damaged."""
        return sum(process.damaged_before + process.damaged for process in self._processes)

    # ------------------------------------------------------------- one process

    def _begin(self, process: Process) -> None:
        """Start the process and tell it of its sensors; raises StorageError when none can be started."""
        if process.memory is None:
            raise StorageError("the tracker processes were stopped")
        process.place.end()
        ours, theirs = socket.socketpair()
        reading, writing = os.pipe()
        try:
            place = {"place": str(self._blames.place_path(process.index))}
            pid = self._nursery.start(WORK, [theirs.fileno(), reading, process.memory], place)
        except StorageError:
            ours.close()
            os.close(writing)
            raise
        finally:
            theirs.close()
            os.close(reading)
        with process.guard:
            process.line, process.lifeline, process.pid = Line(ours), writing, pid
            for member in process.members.values():
                self._send_member(process, member)
            if self._stopping.is_set():
                process.line.send(Kind.STOP)

    def _send_member(self, process: Process, member: Member) -> None:
        if process.line is None:
            return
        sensor_id = member.config.sensor_id
        blame = self._blames.of(sensor_id)
        ends = self._frame_log.first_position(sensor_id), self._frame_log.last_position(sensor_id)
        known = {
            "config": member.config.canonical_json(),
            "first": ends[0],
            "last": ends[1],
            "number": member.number,
            "set_aside": blame.set_aside,
            "digests": blame.digests,
            "anew": member.anew,
        }
        if blame.hopeless:
            member.standing = member.standing.failed(str(blame.failure))
        else:
            process.line.send(Kind.ADD, orjson.dumps(known))
            member.anew = None
        if member.leaving:
            process.line.send(Kind.LEAVE, sensor_id.encode())

    @staticmethod
    def _send_news(process: Process) -> None:
        """Send what is new unless older messages still wait: then it goes with the next."""
        if process.news and process.line is not None and process.line.clear:
            news, process.news = process.news, {}
            process.line.send(Kind.NEWS, orjson.dumps(news))

    def _look_after(self, process: Process) -> None:
        """Hear the process out, and start it again when it ends before its time."""
        pause_s = PAUSE_S
        while True:
            begun_s = time.monotonic()
            try:
                self._listen(process)
            except LineClosed:
                pass
            except Exception:  # noqa: BLE001 - the edge of a thread; the process is begun anew
                _log.exception("a tracker process is not understood", process=process.index)
            with process.guard:
                let_go(process)
            if process.done:
                return
            self._blame(process)
            pause_s = PAUSE_S if time.monotonic() - begun_s > CALM_S else min(2 * pause_s, PAUSE_MOST_S)
            _log.error("a tracker process ended", process=process.index, pid=process.pid, again_s=pause_s)
            if self._stopping.wait(pause_s) or not self._begin_again(process):
                return

    def _blame(self, process: Process) -> None:
        """Count the death against the record that was being folded, if there was one."""
        number, position, _ = process.place.read()
        with process.guard:
            member = next((one for one in process.members.values() if one.number == number), None)
        if member is not None:
            self._blames.died_at(member.config.sensor_id, position)
        self._blames.clear_place(process.index)

    def _begin_again(self, process: Process) -> bool:
        process.before, process.counted = added(process.before, process.counted), []
        process.damaged_before, process.damaged = process.damaged_before + process.damaged, 0
        process.restarts += 1
        self._telemetry.process_restarts.labels(str(process.index)).inc()
        try:
            self._begin(process)
        except StorageError:
            _log.exception("no tracker process can be started; restart the service")
            return False
        return True

    def _listen(self, process: Process) -> None:
        line = process.line
        assert line is not None  # noqa: S101 - it was just begun
        stall = Stall(process.place, HUNG_S, time.monotonic())
        while True:
            line.wait(LISTEN_S)
            heard = False
            for kind, body in line.receive():
                heard = True
                self._hear(process, kind, body)
            if stall.over(time.monotonic(), heard=heard) and not self._stopping.is_set():
                self._kill(process)
            line.push()
            with process.guard:
                self._send_news(process)

    @staticmethod
    def _kill(process: Process) -> None:
        """End a process that hangs; the line, still open, says that the number is still its own."""
        _log.error("a tracker process hangs", process=process.index, pid=process.pid)
        if process.pid is not None:
            with suppress(ProcessLookupError):
                os.kill(process.pid, signal.SIGKILL)

    def _hear(self, process: Process, kind: Kind, body: bytes) -> None:
        match kind:
            case Kind.VIEW:
                entry, frame = decode_entry(body)
                self._owner.show(entry, frame=frame)
            case Kind.REPORT:
                self._take_report(process, orjson.loads(body))
            case Kind.TICK:
                self._append_tick(process, *orjson.loads(body))
            case Kind.RELEASE:
                self._frame_log.release(*orjson.loads(body))
            case Kind.GONE:
                self._forget(process, body.decode())
            case Kind.DONE:
                process.done = True
            case _:
                _log.debug("a tracker process is ready", process=process.index, pid=process.pid)

    def _take_report(self, process: Process, report: dict[str, Any]) -> None:
        process.counted = [(family, name, labels, value) for family, name, labels, value in report["metrics"]]
        process.damaged = report["damaged_records"]
        with process.guard:
            for values in report["standings"]:
                standing = Standing(*values)
                member = process.members.get(standing.sensor_id)
                if member is not None:
                    member.standing = standing
                    self._owner.folded(standing.sensor_id, standing.folded_position)
            for sensor_id, failure in report["failures"].items():
                member = process.members.get(sensor_id)
                if member is not None:
                    member.standing = member.standing.failed(failure)

    def _append_tick(self, process: Process, sensor_id: str, time_us: int) -> None:
        try:
            self._frame_log.append_later(sensor_id, [TickRecord(time_us)])
        except WaysideError as error:
            _log.debug("tick put off", sensor_id=sensor_id, reason=str(error))
            if process.line is not None:
                process.line.send(Kind.REFUSED, sensor_id.encode())

    def _forget(self, process: Process, sensor_id: str) -> None:
        with process.guard:
            process.members.pop(sensor_id, None)
        with self._adding:
            self._of = {name: one for name, one in self._of.items() if name != sensor_id}
        self._frame_log.release(sensor_id, self._frame_log.last_position(sensor_id))
        self._owner.gone(sensor_id)
