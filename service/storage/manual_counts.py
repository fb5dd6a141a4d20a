"""Counts by hand: keep them, and hold each against the volume that was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from sqlalchemy import Connection, delete, select

from service.storage.counts import read_crossings, read_received
from service.storage.sites import ordinal_of
from service.storage.tables import manual_counts
from service.traffic.count_check import Check, check
from service.traffic.flow import Group, covered

MOST_CHECKS: Final = 10_000  # of one reply: a hundred days of quarters of an hour

_US_PER_S: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class ManualCount:
    """How many vehicles somebody counted in one interval."""

    group: Group
    start_us: int
    interval_s: int
    counted: int

    @property
    def end_us(self) -> int:
        """Return the end of the interval."""
        return self.start_us + self.interval_s * _US_PER_S


@dataclass(frozen=True, slots=True)
class Checked:
    """A count by hand, and how the measured volume compares; None where nothing was received."""

    count: ManualCount
    coverage: float
    check: Check | None


def save_manual_counts(
    connection: Connection, sensor_id: str, counts: Sequence[ManualCount], *, now_us: int
) -> None:
    """Write counts by hand; one of the same interval and group is replaced. Raises NotFound."""
    ordinal = ordinal_of(connection, sensor_id)
    rows = {tuple(key.values()): key | {"counted": n} for key, n in (_row(ordinal, c) for c in counts)}
    for row in rows.values():
        key = [manual_counts.c[name] == row[name] for name in manual_counts.primary_key.columns.keys()]  # noqa: SIM118
        connection.execute(delete(manual_counts).where(*key))
    if rows:
        connection.execute(manual_counts.insert(), [row | {"updated_us": now_us} for row in rows.values()])


def check_counts(connection: Connection, sensor_id: str, start_us: int, end_us: int) -> list[Checked]:
    """Return the counts by hand that begin in [start_us, end_us), each held against the measured volume.

    Raises NotFound.
    """
    c = manual_counts.c
    rows = connection.execute(
        select(manual_counts)
        .where(c.sensor == ordinal_of(connection, sensor_id), c.start_us >= start_us, c.start_us < end_us)
        .order_by(c.start_us, c.line_id, c.lane, c.direction, c.length_class)
        .limit(MOST_CHECKS)
    )
    counts = [
        ManualCount(
            Group(r.line_id, r.lane or None, r.direction or None, r.length_class or None),
            r.start_us,
            r.interval_s,
            r.counted,
        )
        for r in rows
    ]
    return compare(connection, sensor_id, counts)


def compare(connection: Connection, sensor_id: str, counts: Sequence[ManualCount]) -> list[Checked]:
    """Return each count by hand with the measured volume beside it; raises NotFound."""
    if not counts:
        return []
    first_us, last_us = min(c.start_us for c in counts), max(c.end_us for c in counts)
    crossings = read_crossings(connection, sensor_id, first_us, last_us)
    received = read_received(connection, sensor_id, first_us, last_us)
    found = []
    for count in counts:
        coverage, _ = covered(received, np.array([count.start_us, count.end_us], np.int64))
        inside = (crossings.time_us >= count.start_us) & (crossings.time_us < count.end_us)
        measured = int(np.count_nonzero(count.group.holds(crossings) & inside))
        known = check(count.counted, measured, count.interval_s) if coverage[0] > 0 else None
        found.append(Checked(count, float(coverage[0]), known))
    return found


def _row(ordinal: int, count: ManualCount) -> tuple[dict[str, object], int]:
    group = count.group
    key = {
        "sensor": ordinal,
        "start_us": count.start_us,
        "interval_s": count.interval_s,
        "line_id": group.line_id,
        "lane": group.lane or 0,
        "direction": group.direction or 0,
        "length_class": group.length_class or "",
    }
    return key, count.counted
