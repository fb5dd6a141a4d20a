"""What the host must find again after a restart: per sensor the epoch, the read position and the snapshot.

A shard is one sensor's share of the log. Its rows and its cursor are written in one transaction
(`save_flush`); a snapshot never runs ahead of the cursor, so that every row behind it is stored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from sqlalchemy import Connection, delete, select, update

from service.errors import StorageError
from service.storage.counts import save_counts
from service.storage.database import insert_or_ignore
from service.storage.events import save_events
from service.storage.lanes import save_lane_changes, save_lane_maps
from service.storage.rows import EventRow, Rows
from service.storage.sites import ordinal_of
from service.storage.tables import shards, snapshots
from service.storage.tracks import save_blocks, save_summaries

RESTARTED: Final = "tracker_restarted"
RESTART_NUMBER: Final = 0  # of the event that opens an epoch; the fold's own events count from 1


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A stored tracker state: every record up to `position` is folded into it."""

    position: int
    state: bytes


@dataclass(frozen=True, slots=True)
class Shard:
    """Where a sensor's fold stands."""

    sensor_id: str
    epoch: int
    epoch_first_position: int  # of the first record of this epoch; it may lie beyond the log's end
    cursor: int  # every row of the records up to here is stored; epoch_first_position - 1 at first
    snapshot: Snapshot | None  # of this epoch


def load_shard(connection: Connection, sensor_id: str) -> Shard | None:
    """Return where the sensor's fold stands, None before its first epoch; raises NotFound."""
    ordinal = ordinal_of(connection, sensor_id)
    row = connection.execute(select(shards).where(shards.c.sensor == ordinal)).one_or_none()
    if row is None:
        return None
    found = connection.execute(
        select(snapshots.c.position, snapshots.c.state).where(
            snapshots.c.sensor == ordinal, snapshots.c.epoch == row.epoch
        )
    ).one_or_none()
    snapshot = None if found is None else Snapshot(found.position, found.state)
    return Shard(sensor_id, row.epoch, row.epoch_first_position, row.cursor, snapshot)


def begin_epoch(  # noqa: PLR0913 - all by name
    connection: Connection, sensor_id: str, *, first_position: int, reason: str, time_us: int, now_us: int
) -> Shard:
    """Open the next epoch, to be folded from `first_position` with an empty state; the first is epoch 1.

    Any later one forgets the snapshot and stores the event `tracker_restarted` with its reason, at `time_us`.
    Raises NotFound.
    """
    ordinal = ordinal_of(connection, sensor_id)
    place = {"epoch_first_position": first_position, "cursor": first_position - 1}
    opened = connection.scalar(
        insert_or_ignore(connection, "shards")
        .values(sensor=ordinal, epoch=1, **place)
        .returning(shards.c.epoch)
    )
    if opened is not None:
        return Shard(sensor_id, opened, first_position, first_position - 1, None)
    epoch = connection.scalar(
        update(shards)
        .where(shards.c.sensor == ordinal)
        .values(epoch=shards.c.epoch + 1, **place)
        .returning(shards.c.epoch)
    )
    if epoch is None:
        raise StorageError(f"the shard of {sensor_id} vanished while its epoch was opened")
    connection.execute(delete(snapshots).where(snapshots.c.sensor == ordinal))
    event = EventRow(sensor_id, epoch, RESTART_NUMBER, first_position, RESTARTED, time_us, {"reason": reason})
    save_events(connection, [event], now_us=now_us)
    return Shard(sensor_id, epoch, first_position, first_position - 1, None)


def save_flush(connection: Connection, shard: Shard, position: int, rows: Rows, *, now_us: int) -> Shard:
    """Write rows and the position up to which they are complete, and return the shard as it stands then.

    After a restart records behind the cursor are folded again: their rows have no effect, the cursor stays.
    Raises StorageError when the stored cursor is not the shard's: another process took over, and the caller
    must roll back and let go.
    """
    ordinal = ordinal_of(connection, shard.sensor_id)
    cursor = max(position, shard.cursor)
    moved = connection.execute(
        update(shards)
        .where(shards.c.sensor == ordinal, shards.c.epoch == shard.epoch, shards.c.cursor == shard.cursor)
        .values(cursor=cursor)
    )
    if moved.rowcount != 1:
        raise StorageError(
            f"the cursor of {shard.sensor_id} is no longer {shard.cursor} in epoch {shard.epoch}: superseded"
        )
    save_blocks(connection, rows.blocks, now_us=now_us)
    save_summaries(connection, rows.tracks, now_us=now_us)
    save_events(connection, rows.events, now_us=now_us)
    save_lane_maps(connection, rows.lane_maps, now_us=now_us)
    save_lane_changes(connection, rows.lane_changes, now_us=now_us)
    save_counts(connection, rows.crossings, rows.minutes, rows.cells, now_us=now_us)
    return Shard(shard.sensor_id, shard.epoch, shard.epoch_first_position, cursor, shard.snapshot)


def save_snapshot(connection: Connection, shard: Shard, snapshot: Snapshot, *, now_us: int) -> None:
    """Replace the stored state of the shard.

    Raises StorageError when rows before the snapshot are not stored yet, or the shard was superseded.
    """
    ordinal = ordinal_of(connection, shard.sensor_id)
    # Locks the row (PostgreSQL), so that no other process opens an epoch in between.
    held = connection.execute(
        select(shards.c.cursor)
        .where(shards.c.sensor == ordinal, shards.c.epoch == shard.epoch)
        .with_for_update()
    ).one_or_none()
    if held is None or held.cursor < snapshot.position:
        raise StorageError(
            f"a snapshot of {shard.sensor_id} at {snapshot.position} in epoch {shard.epoch} does not fit "
            f"the stored cursor {None if held is None else held.cursor}"
        )
    connection.execute(delete(snapshots).where(snapshots.c.sensor == ordinal))
    connection.execute(
        snapshots.insert().values(
            sensor=ordinal,
            epoch=shard.epoch,
            position=snapshot.position,
            state=snapshot.state,
            stored_us=now_us,
        )
    )
