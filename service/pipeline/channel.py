"""One sensor in the host: its door, where its fold stands, and how both are found again after a restart.

The two halves may live in two processes: the doorway always in that of the API, the channel in that of the
tracker that the sensor belongs to.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Generic

from sqlalchemy import Engine

from service.errors import SnapshotUnreadable
from service.formats.sensor import SensorConfig
from service.pipeline import fold_snapshot
from service.pipeline.clocks import ClockWatch
from service.pipeline.codec import logged_bytes
from service.pipeline.fold import start
from service.pipeline.fold_state import Folded, FoldState, S, Tracker
from service.pipeline.log import FrameLog
from service.pipeline.order import OrderState, admit, flush
from service.pipeline.records import ControlRecord, DamagedRecord, FrameRecord
from service.storage.database import session_scope
from service.storage.rows import Rows, merge_rows
from service.storage.shards import Shard, Snapshot, begin_epoch, load_shard, save_snapshot
from service.tracking.model import Frame

FIRST_START = "first start"
_READ_RECORDS = 500  # at a time while the log's tail is looked through


@dataclass(frozen=True, slots=True)
class Restart:
    """A new epoch that the fold began and the database does not know yet."""

    first_position: int
    reason: str
    time_us: int


@dataclass(frozen=True, slots=True)
class Reopening:
    """The wish to find a sensor's state again, or to begin an epoch behind what the log dropped."""

    config: SensorConfig  # the newest
    anew: str | None  # why an epoch begins in any case


@dataclass(slots=True)
class Doorway:
    """One sensor's door: written by the event loop, and by whoever configures the sensor."""

    sensor_id: str
    config: SensorConfig
    door: OrderState  # what the order will be once every logged record is folded
    durable_door: OrderState  # the same for the records known to be durable
    # Of what is durable and not folded: position, receive time, and `logged_bytes` before it.
    waiting: deque[tuple[int, int, int]]
    logged_bytes: int = 0  # of frames, since the opening; what waited then included
    folded: int = 0  # newest position that the tracker told
    door_failures: int = 0  # submissions that the log refused
    clock: ClockWatch = field(default_factory=ClockWatch)
    set_aside: frozenset[int] = frozenset()  # digests of frames over which a tracker died

    def pass_folded(self, position: int) -> None:
        """Take in that records up to a position are folded; from the tracker's thread."""
        self.folded = max(position, self.folded)
        while self.waiting and self.waiting[0][0] <= position:
            self.waiting.popleft()

    def expect(self, position: int, received_us: int, frames: Iterable[Frame]) -> None:
        """Take in that frames are durable, the last one at `position`; from the event loop."""
        before = self.logged_bytes
        self.logged_bytes += sum(map(logged_bytes, frames))
        if position > self.folded:  # else the tracker was quicker
            self.waiting.append((position, received_us, before))

    @property
    def waiting_bytes(self) -> int:
        """What the log holds of frames that are not folded."""
        try:
            return self.logged_bytes - self.waiting[0][2]
        except IndexError:
            return 0

    def waiting_since_before(self, time_us: int) -> int | None:
        """Return the newest position that was received before a time and waits, None when none does."""
        found = None
        for position, received_us, _ in tuple(self.waiting):
            if received_us >= time_us:
                break
            found = position
        return found

    def oldest_waiting_us(self) -> int | None:
        """Return when the oldest frame was received that is durable and not folded, None when none waits."""
        folded = self.folded
        return next(
            (received_us for position, received_us, _ in tuple(self.waiting) if position > folded), None
        )


@dataclass(frozen=True, slots=True)
class Standing:
    """Where the fold of one sensor stands, as others are told."""

    sensor_id: str
    epoch: int
    folded_position: int
    stored_position: int
    received_us: int | None = None  # host's time of the newest folded frame
    stored_us: int | None = None  # when rows were stored last
    unstored_frames: int = 0  # folded, and not stored yet
    failure: str | None = None  # why frames are not tracked any more

    def failed(self, failure: str) -> Standing:
        """Return where the sensor stands once it is not tracked any more."""
        return Standing(
            self.sensor_id, self.epoch, self.folded_position, self.stored_position, failure=failure
        )


@dataclass(slots=True)
class Channel(Generic[S]):
    """One sensor's place in the tracker, which alone touches it."""

    sensor_id: str
    state: FoldState[S]
    shard: Shard
    snapshot_position: int
    snapshot_at_s: float  # monotonic
    heard_us: int  # host's time of the newest arrival that was folded, or of the opening
    opened_position: int  # end of the log at the opening: what lies before was heard by an earlier run
    rows: list[Rows] = field(default_factory=list)
    restarts: list[Restart] = field(default_factory=list)
    frames_since_snapshot: int = 0
    flushed_s: float = 0.0  # monotonic, of the newest flush that it was due for
    tick: Future[list[int]] | None = None  # being appended
    received_us: int | None = None  # of the newest folded frame
    newest: Folded | None = None  # frame or tick
    newest_frame: Folded | None = None
    unstored_received_us: list[int] = field(default_factory=list)  # of frames folded since the last flush
    stored_us: int | None = None
    failure: str | None = None
    read_again_s: float = 0.0  # monotonic: the log could not be read, and is not before; 0: it could
    leaving: bool = False
    reopening: Reopening | None = None
    skipped: int = 0  # records that were left out when its epoch was begun on purpose
    number: int = 0  # by which a tracker names it in its place: the sensor's ordinal

    def take_rows(self) -> Rows:
        """Return what was collected since the last flush, each track's newest summary only."""
        return merge_rows(self.rows)

    def standing(self) -> Standing:
        """Return where the sensor stands."""
        return Standing(
            self.sensor_id,
            self.state.epoch,
            self.state.position,
            self.shard.cursor,
            self.received_us,
            self.stored_us,
            len(self.unstored_received_us),
            self.failure,
        )


def open_channel(  # noqa: PLR0913 - what a restart needs
    database: Engine,
    log: FrameLog,
    config: SensorConfig,
    tracker: Tracker[S],
    *,
    now_us: int,
    now_s: float,
    anew: str | None = None,
) -> Channel[S]:
    """Find a sensor's state again, or begin an epoch; `anew`: why one begins in any case.

    Raises NotFound when the sensor is not registered, Unavailable when the log or the database is.
    """
    sensor_id = config.sensor_id
    with session_scope(database) as connection:
        shard = load_shard(connection, sensor_id)
    found: FoldState[S] | str = FIRST_START
    skipped = 0
    if shard is not None and anew is not None:
        skipped = max(0, _kept(log, sensor_id) - 1 - shard.cursor)
        found = f"{anew}; {_skipped(shard.cursor + 1, skipped)}"
    elif shard is not None:
        found = _resume(log, shard, config, tracker)
    if shard is None or isinstance(found, str):
        state, shard = _begin(database, log, shard, config, tracker, reason=str(found), now_us=now_us)
    else:
        state = found
    log.reserve(sensor_id, shard.cursor)
    position = 0 if shard.snapshot is None else shard.snapshot.position
    # A log that is full takes no frame, so no further snapshot would come to let anything go.
    log.release(sensor_id, min(position, state.position))
    last = log.last_position(sensor_id)
    return Channel(sensor_id, state, shard, position, now_s, now_us, last, skipped=skipped)


def _skipped(first: int, count: int) -> str:
    if not count:
        return "no record was left out"
    return f"{count} records were left out, at positions {first} to {first + count - 1}"


def _kept(log: FrameLog, sensor_id: str) -> int:
    """Return the oldest position that can still be read, or the next one to be given."""
    return log.first_position(sensor_id) or log.last_position(sensor_id) + 1


def open_doorway(log: FrameLog, config: SensorConfig, state: FoldState[S], *, now_us: int) -> Doorway:
    """Return the door of a sensor whose fold stands at `state`; the log holds its configuration then.

    Raises Unavailable when the log is.
    """
    sensor_id = config.sensor_id
    order, logged, waiting, waiting_bytes = _look_through(log, state)
    if logged != config.canonical_json() or log.last_position(sensor_id) < state.epoch_first_position:
        log.append(sensor_id, [ControlRecord(config.canonical_json(), now_us)])
        order, _ = flush(order)
    return Doorway(sensor_id, config, order, order, waiting, waiting_bytes, state.position)


def _resume(log: FrameLog, shard: Shard, config: SensorConfig, tracker: Tracker[S]) -> FoldState[S] | str:
    """Return the state to go on from, or why there is none."""
    last, kept = log.last_position(shard.sensor_id), _kept(log, shard.sensor_id)
    if last < shard.cursor:
        return f"the log ends at position {last}, rows are stored up to {shard.cursor}"
    reason = "no snapshot is stored"
    if shard.snapshot is not None:
        try:
            state = fold_snapshot.load(shard.snapshot.state, tracker)
        except SnapshotUnreadable as error:
            reason = str(error)
        else:
            if state.epoch == shard.epoch and kept <= state.position + 1:
                return state
            reason = f"the log begins at position {kept}, the snapshot is of {state.position}"
    # Only the first epoch begins with a control record, so only it can be folded again without a snapshot.
    if shard.epoch == 1 and kept <= shard.epoch_first_position:
        return start(shard.sensor_id, 1, config, tracker, first_position=shard.epoch_first_position)
    return reason


def _begin(  # noqa: PLR0913 - what an epoch needs
    database: Engine,
    log: FrameLog,
    shard: Shard | None,
    config: SensorConfig,
    tracker: Tracker[S],
    *,
    reason: str,
    now_us: int,
) -> tuple[FoldState[S], Shard]:
    """Open the next epoch behind what is stored, with its empty state as its first snapshot."""
    sensor_id = config.sensor_id
    last = log.last_position(sensor_id)
    after = last if shard is None else max(shard.cursor, _kept(log, sensor_id) - 1)
    with session_scope(database) as connection:
        opened = begin_epoch(
            connection, sensor_id, first_position=after + 1, reason=reason, time_us=now_us, now_us=now_us
        )
        state = start(sensor_id, opened.epoch, config, tracker, first_position=after + 1)
        snapshot = Snapshot(after, fold_snapshot.dump(state))
        save_snapshot(connection, opened, snapshot, now_us=now_us)
    return state, Shard(sensor_id, opened.epoch, after + 1, after, snapshot)


def _look_through(
    log: FrameLog, state: FoldState[S]
) -> tuple[OrderState, str, deque[tuple[int, int, int]], int]:
    """Return order and configuration at the log's end, without tracking what lies before, and what waits."""
    order, config, position = state.order, state.config, state.position
    waiting: deque[tuple[int, int, int]] = deque()
    waiting_bytes = 0
    while records := log.read(state.sensor_id, position, _READ_RECORDS):
        for position, record in records:  # the last one is where the next read begins
            match record:
                case FrameRecord():
                    order, _ = admit(order, record.frame)
                    waiting.append((position, record.received_us, waiting_bytes))
                    waiting_bytes += logged_bytes(record.frame)
                case ControlRecord():
                    order, _ = flush(order)
                    config = record.config
                case DamagedRecord():
                    pass
                case _:
                    order, _ = flush(order)
    return order, config, waiting, waiting_bytes
