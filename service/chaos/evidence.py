"""What a data directory holds in the end, in a form in which two runs can be compared."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sqlalchemy import Select, Table, select

from service.chaos.child import settings
from service.pipeline import fold_snapshot
from service.storage.database import connection, open_database
from service.storage.tables import events, metadata, sensors, shards, snapshots
from service.tracking import tracker

_STANDING = {shards.name, snapshots.name}  # where the fold stands: compared by epoch and digest
_TABLES = tuple(t for t in metadata.sorted_tables if "sensor" in t.columns and t.name not in _STANDING)
# A frame that is posted again is logged again, so that positions differ and nothing else does.
_NOT_COMPARED = {"as_of", "stored_day"}


@dataclass(frozen=True, slots=True)
class Evidence:
    """Rows of each table, and epoch and digest of the state of each sensor."""

    rows: dict[str, list[tuple[object, ...]]]
    epochs: dict[str, int]
    digests: dict[str, str]
    events: dict[str, list[str]]  # sensor -> kinds

    def differences(self, other: Evidence) -> list[str]:
        """Say in words what differs; nothing when all is equal."""
        found = [
            f"{name}: {len(mine)} rows, {len(other.rows[name])} in the uninterrupted run"
            if len(mine) != len(other.rows[name])
            else f"{name}: {sum(a != b for a, b in zip(mine, other.rows[name], strict=True))} rows differ"
            for name, mine in self.rows.items()
            if mine != other.rows[name]
        ]
        for sensor_id, epoch in other.epochs.items():
            if self.epochs.get(sensor_id) != epoch:
                found.append(f"{sensor_id} is in epoch {self.epochs.get(sensor_id)}, not {epoch}")
            if self.digests.get(sensor_id) != other.digests[sensor_id]:
                found.append(f"the state of {sensor_id} differs")
        return found


def gather(data_dir: Path) -> Evidence:
    """Read what a run left; nothing may be using the directory."""
    engine = open_database(settings(data_dir).rows_url)
    try:
        with connection(engine) as reader:
            names = {row.ordinal: row.sensor_id for row in reader.execute(select(sensors))}
            rows = {table.name: [tuple(row) for row in reader.execute(_in_order(table))] for table in _TABLES}
            epochs = {names[row.sensor]: row.epoch for row in reader.execute(select(shards))}
            states = {names[row.sensor]: row.state for row in reader.execute(select(snapshots))}
            kinds: dict[str, list[str]] = {name: [] for name in names.values()}
            for row in reader.execute(select(events).order_by(*events.primary_key)):
                kinds[names[row.sensor]].append(row.kind)
    finally:
        engine.dispose()
    return Evidence(rows, epochs, {name: _digest(state) for name, state in states.items()}, kinds)


def _in_order(table: Table) -> Select[Any]:
    columns = [column for column in table.columns if column.name not in _NOT_COMPARED]
    return select(*columns).order_by(*table.primary_key)


def _digest(state: bytes) -> str:
    """Name the state of a fold, but for its place in the log."""
    loaded = replace(fold_snapshot.load(state, tracker), position=0, epoch_first_position=0)
    return hashlib.blake2b(fold_snapshot.dump(loaded), digest_size=16).hexdigest()
