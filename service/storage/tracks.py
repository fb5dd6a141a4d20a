"""Tracks and their states: write them again without effect, read them by time."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from sqlalchemy import Connection, Engine, RowMapping, Select, func, select, tuple_, update

from service.errors import NotFound
from service.storage.database import connection as reading
from service.storage.database import insert_or_advance, insert_or_ignore
from service.storage.page import Page, check_limit, cut, read_cursor
from service.storage.rows import StateBlock, TrackKey, TrackSummary
from service.storage.samples import pack, unpack
from service.storage.sites import ordinal_of
from service.storage.tables import sensors, track_states, tracks

US_PER_S: Final = 1_000_000
US_PER_DAY: Final = 86_400 * US_PER_S

STREAM_TRACKS: Final = 1000  # tracks of one read of a stream

_NUMBER_DIGITS: Final = 15  # more digits are no counter of ours, and would not fit the column

# The birth of a track does not change, and cursors and retention rely on it.
_KEPT: Final = frozenset({"first_time_us", "stored_day"})
_BY_TIME: Final = (tracks.c.first_time_us, tracks.c.sensor, tracks.c.epoch, tracks.c.number)


@dataclass(frozen=True, slots=True)
class TrackQuery:
    """Which tracks: those seen at some time in [start_us, end_us), of one sensor or all."""

    sensor_id: str | None = None
    start_us: int | None = None
    end_us: int | None = None


def parse_track_id(text: str) -> TrackKey:
    """Return the key of a public track id; raises NotFound when no track can have it."""
    sensor_id, *counters = text.rsplit("-", 2)
    if len(counters) == 2 and sensor_id and all(_is_counter(part) for part in counters):  # noqa: PLR2004
        return TrackKey(sensor_id, int(counters[0]), int(counters[1]))
    raise NotFound(f"no track {text}")


def save_blocks(connection: Connection, blocks: Sequence[StateBlock], *, now_us: int) -> None:
    """Write one-second state blocks; a block already stored is left as it is, so a replay adds nothing."""
    if not blocks:
        return
    ordinals = _ordinals(connection, {block.key.sensor_id for block in blocks})
    connection.execute(
        insert_or_ignore(connection, "track_states"),
        [
            {
                "sensor": ordinals[block.key.sensor_id],
                "second": block.second,
                "epoch": block.key.epoch,
                "number": block.key.number,
                "first_frame": block.first_frame,
                "stored_day": now_us // US_PER_DAY,
                "samples": pack(block.samples),
            }
            for block in blocks
        ],
    )


def save_summaries(connection: Connection, summaries: Sequence[TrackSummary], *, now_us: int) -> None:
    """Write what is known of tracks; a stored summary gives way only to one with a later `as_of`."""
    if not summaries:
        return
    ordinals = _ordinals(connection, {summary.key.sensor_id for summary in summaries})
    rows = []
    longest = dict.fromkeys(ordinals.values(), 0)
    for summary in summaries:
        ordinal = ordinals[summary.key.sensor_id]
        row = {name: getattr(summary, name) for name in _SUMMARY_FIELDS}
        rows.append(
            {
                "sensor": ordinal,
                "epoch": summary.key.epoch,
                "number": summary.key.number,
                "stored_day": now_us // US_PER_DAY,
                **row,
            }
        )
        longest[ordinal] = max(longest[ordinal], summary.last_time_us - summary.first_time_us)
    connection.execute(insert_or_advance(connection, "tracks", _KEPT), rows)
    for ordinal, duration_us in longest.items():
        connection.execute(
            update(sensors)
            .where(sensors.c.ordinal == ordinal, sensors.c.longest_track_us < duration_us)
            .values(longest_track_us=duration_us)
        )


def read_track(connection: Connection, key: TrackKey) -> TrackSummary:
    """Return one track; raises NotFound."""
    query = _summaries().where(
        sensors.c.sensor_id == key.sensor_id, tracks.c.epoch == key.epoch, tracks.c.number == key.number
    )
    row = connection.execute(query).mappings().one_or_none()
    if row is None:
        raise NotFound(f"no track {key}")
    return _summary(row)


def list_tracks(
    connection: Connection, query: TrackQuery, *, cursor: str | None = None, limit: int = 100
) -> Page[TrackSummary]:
    """Return tracks by the time of their first state, then sensor, epoch and number.

    Raises NotFound for an unknown sensor, InvalidInput for a bad cursor or limit.
    """
    statement = _summaries().order_by(*_BY_TIME).limit(check_limit(limit) + 1)
    longest_us = select(func.max(sensors.c.longest_track_us))
    if query.sensor_id is not None:
        ordinal = ordinal_of(connection, query.sensor_id)
        statement = statement.where(tracks.c.sensor == ordinal)
        longest_us = longest_us.where(sensors.c.ordinal == ordinal)
    if query.start_us is not None:
        # The first condition says what is wanted; the second, implied by it, lets the index do the work.
        earliest_us = query.start_us - (connection.scalar(longest_us) or 0)
        statement = statement.where(
            tracks.c.last_time_us >= query.start_us, tracks.c.first_time_us >= earliest_us
        )
    if query.end_us is not None:
        statement = statement.where(tracks.c.first_time_us < query.end_us)
    if cursor is not None:
        first_time_us, sensor_id, epoch, number = read_cursor(cursor, int, str, int, int)
        after = (first_time_us, ordinal_of(connection, str(sensor_id)), epoch, number)
        statement = statement.where(tuple_(*_BY_TIME) > after)
    found = [_summary(row) for row in connection.execute(statement).mappings()]
    return cut(found, limit, _track_position)


def stream_tracks(engine: Engine, query: TrackQuery) -> Iterator[TrackSummary]:
    """Yield all tracks of the query in the order of `list_tracks`.

    Takes the engine: each part is read in a transaction of its own, since one held open for a slow client
    would keep the database from tidying up behind it.
    """
    cursor: str | None = None
    while True:
        with reading(engine) as connection:
            page = list_tracks(connection, query, cursor=cursor, limit=STREAM_TRACKS)
        yield from page.items
        cursor = page.next_cursor
        if cursor is None:
            return


def list_blocks(
    connection: Connection, key: TrackKey, *, cursor: str | None = None, limit: int = 600
) -> Page[StateBlock]:
    """Return the state blocks of one track by second, at most `limit` seconds of them; raises NotFound."""
    track = read_track(connection, key)
    ordinal = ordinal_of(connection, key.sensor_id)
    c = track_states.c
    statement = (
        select(c.second, c.first_frame, c.samples)
        .where(c.sensor == ordinal, c.epoch == key.epoch, c.number == key.number)
        # The key of the table begins with the second: the track's own span is the range to look at.
        .where(c.second.between(track.first_time_us // US_PER_S, track.last_time_us // US_PER_S))
        .order_by(c.second)
        .limit(check_limit(limit) + 1)
    )
    if cursor is not None:
        statement = statement.where(c.second > read_cursor(cursor, int)[0])
    found = [
        StateBlock(key, row.second, row.first_frame, unpack(row.samples))
        for row in connection.execute(statement)
    ]
    return cut(found, limit, lambda block: (block.second,))


_SUMMARY_FIELDS: Final = tuple(f.name for f in dataclasses.fields(TrackSummary) if f.name != "key")


def _summaries() -> Select[tuple[object, ...]]:
    columns = [tracks.c[name] for name in _SUMMARY_FIELDS]
    return select(sensors.c.sensor_id, tracks.c.epoch, tracks.c.number, *columns).join_from(tracks, sensors)


def _summary(row: RowMapping) -> TrackSummary:
    fields = dict(row)
    key = TrackKey(fields.pop("sensor_id"), fields.pop("epoch"), fields.pop("number"))
    return TrackSummary(key=key, **fields)


def _track_position(track: TrackSummary) -> tuple[str | int, ...]:
    return track.first_time_us, track.key.sensor_id, track.key.epoch, track.key.number


def _ordinals(connection: Connection, sensor_ids: set[str]) -> dict[str, int]:
    return {sensor_id: ordinal_of(connection, sensor_id) for sensor_id in sorted(sensor_ids)}


def _is_counter(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) <= _NUMBER_DIGITS and str(int(text)) == text
