"""The states of a time window, frame by frame, as exports and the time machine want them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from sqlalchemy import Connection, Engine, func, select

from service.formats.tracks import StoredStates
from service.storage.database import connection as reading
from service.storage.samples import unpack_array
from service.storage.sites import ordinal_of
from service.storage.tables import track_states

STREAM_SECONDS: Final = 10  # of one read: 12,000 samples of 60 tracks at 20 Hz, about 0.3 MB

_US_PER_S: Final = 1_000_000
_US_PER_MS: Final = 1000


@dataclass(frozen=True, slots=True)
class StateFrame:
    """What is stored of one frame; `formats.tracks.stored_line` makes its line of tracks.jsonl."""

    sensor_id: str
    epoch: int
    frame: int
    time_us: int  # to the millisecond
    states: StoredStates


def stream_states(engine: Engine, sensor_id: str, start_us: int, end_us: int) -> Iterator[StateFrame]:
    """Yield the frames of a sensor in [start_us, end_us) that have states, by time; raises NotFound at once.

    Takes the engine for the reason given at `tracks.stream_tracks`.
    """
    with reading(engine) as connection:
        ordinal = ordinal_of(connection, sensor_id)
    return _stream(engine, (sensor_id, ordinal), start_us, end_us)


def _stream(engine: Engine, sensor: tuple[str, int], start_us: int, end_us: int) -> Iterator[StateFrame]:
    _, ordinal = sensor
    second, end = start_us // _US_PER_S, -(-end_us // _US_PER_S)
    while second < end:
        with reading(engine) as connection:
            first = _next_second(connection, ordinal, second, end)
            if first is None:
                return
            second = min(first + STREAM_SECONDS, end)
            frames = _frames(connection, sensor, first, second)
        yield from (frame for frame in frames if start_us <= frame.time_us < end_us)


def _next_second(connection: Connection, ordinal: int, second: int, end: int) -> int | None:
    c = track_states.c
    found: int | None = connection.scalar(
        select(func.min(c.second)).where(c.sensor == ordinal, c.second >= second, c.second < end)
    )
    return found


def _frames(connection: Connection, sensor: tuple[str, int], second: int, end: int) -> list[StateFrame]:
    """Return the frames whose time lies in the seconds [second, end)."""
    sensor_id, ordinal = sensor
    c = track_states.c
    rows = connection.execute(
        select(c.second, c.epoch, c.number, c.first_frame, c.samples).where(
            c.sensor == ordinal, c.second >= second, c.second < end
        )
    ).all()
    blocks = [unpack_array(row.samples) for row in rows]
    if not blocks:
        return []
    lengths = [len(block) for block in blocks]
    heads = np.array([(r.second, r.epoch, r.number, r.first_frame) for r in rows], np.int64).repeat(
        lengths, axis=0
    )
    samples = np.concatenate(blocks)
    time_us = heads[:, 0] * _US_PER_S + samples["time_offset_ms"].astype(np.int64) * _US_PER_MS
    frame = heads[:, 3] + samples["frame_offset"]
    epoch, number = heads[:, 1], heads[:, 2]
    order = np.lexsort((number, frame, epoch, time_us))
    identity = np.stack((epoch, time_us, frame), axis=1)[order]
    changes = np.flatnonzero((identity[1:] != identity[:-1]).any(axis=1)) + 1
    return [
        StateFrame(
            sensor_id=sensor_id,
            epoch=int(epoch[order[a]]),
            frame=int(frame[order[a]]),
            time_us=int(time_us[order[a]]),
            states=StoredStates(number[order[a:b]], samples[order[a:b]]),
        )
        for a, b in pairwise((0, *changes.tolist(), len(order)))
    ]
