"""Store what the fold gave out: rows, cursor and snapshots of sensors in one transaction."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Generic

from sqlalchemy import Connection, Engine

from service.errors import StorageError
from service.pipeline import fold_snapshot
from service.pipeline.channel import Channel
from service.pipeline.fold_state import S
from service.storage.database import session_scope
from service.storage.rows import Rows
from service.storage.shards import Shard, Snapshot, begin_epoch, save_flush, save_snapshot


@dataclass(frozen=True, slots=True)
class Stored(Generic[S]):
    """One channel as it will be once the transaction is committed."""

    channel: Channel[S]
    shard: Shard
    parts: int  # of its collected rows that were written
    restarts: int
    frames: int
    snapshot_position: int | None


def store(
    database: Engine, channels: Collection[Channel[S]], snapshots: Collection[str], *, now_us: int
) -> list[Stored[S]]:
    """Write everything that the channels collected, with a snapshot of the sensors named.

    Nothing of it is kept when it fails. Raises Unavailable when the database is, StorageError when another
    process took a shard over.
    """
    with session_scope(database) as connection:
        return [
            _store_one(connection, channel, with_snapshot=channel.sensor_id in snapshots, now_us=now_us)
            for channel in channels
        ]


def settle(stored: Stored[S], *, now_us: int, now_s: float) -> None:
    """Take a committed transaction over into the channel."""
    channel = stored.channel
    channel.shard = stored.shard
    del channel.rows[: stored.parts]
    del channel.restarts[: stored.restarts]
    del channel.unstored_received_us[: stored.frames]
    channel.stored_us = now_us
    if stored.snapshot_position is not None:
        channel.snapshot_position = stored.snapshot_position
        channel.snapshot_at_s = now_s
        channel.frames_since_snapshot = 0


def _store_one(connection: Connection, channel: Channel[S], *, with_snapshot: bool, now_us: int) -> Stored[S]:
    shard, rows, position = channel.shard, channel.take_rows(), channel.state.position
    for restart in channel.restarts:
        # Rows carry their epoch themselves, so those of both sides of the restart go in below.
        shard = save_flush(connection, shard, restart.first_position - 1, Rows(), now_us=now_us)
        shard = begin_epoch(
            connection,
            channel.sensor_id,
            first_position=restart.first_position,
            reason=restart.reason,
            time_us=restart.time_us,
            now_us=now_us,
        )
    if shard.epoch != channel.state.epoch:
        raise StorageError(
            f"{channel.sensor_id} is in epoch {shard.epoch} of the database, in {channel.state.epoch} here"
        )
    shard = save_flush(connection, shard, position, rows, now_us=now_us)
    if with_snapshot or channel.restarts:
        snapshot = Snapshot(position, fold_snapshot.dump(channel.state))
        save_snapshot(connection, shard, snapshot, now_us=now_us)
        shard = replace(shard, snapshot=None)  # it is in the database; no need to keep its bytes here
    return Stored(
        channel,
        shard,
        len(channel.rows),
        len(channel.restarts),
        len(channel.unstored_received_us),
        position if with_snapshot or channel.restarts else None,
    )
