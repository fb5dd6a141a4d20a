"""Make short recordings of a few vehicles, and tell whether two histories are the same."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from service.formats.sensor import CountLine, SensorConfig
from service.pipeline.fold import start, step
from service.pipeline.fold_state import FoldOutput
from service.pipeline.records import FrameRecord, Record
from service.storage.rows import Rows
from service.tracking.model import Frame
from tests.pipeline import simple_tracker

START_US = 1_747_029_600_000_000
PERIOD_US = 50_000
CONFIG = SensorConfig(
    sensor_id="radar-1", count_lines=(CountLine(line_id="C45", p0=(0.0, 45.0), p1=(14.0, 45.0)),)
)


def frame(sequence: int | None, time_us: int, *, boot_id: str | None = None, vehicles: int = 2) -> Frame:
    """A frame of vehicles that drive away side by side, one point each."""
    t_s = (time_us - START_US) / 1e6
    x, y = 4.0 + 6.0 * np.arange(vehicles), 30.0 + 10.0 * t_s + 7.0 * np.arange(vehicles)
    return Frame(
        sensor_id="radar-1",
        time_us=time_us,
        sequence=sequence,
        boot_id=boot_id,
        range_m=np.hypot(x, y).astype(np.float32),
        azimuth_rad=np.arctan2(x, y).astype(np.float32),
        radial_velocity_mps=np.full(vehicles, 10.0, dtype=np.float32),
        snr_db=np.full(vehicles, 20.0, dtype=np.float32),
    )


def recording(count: int, *, first: int = 1, start_us: int = START_US, vehicles: int = 2) -> list[Frame]:
    """Consecutive frames, numbered from `first`."""
    return [frame(first + i, start_us + i * PERIOD_US, vehicles=vehicles) for i in range(count)]


def pausing_recording() -> list[Frame]:
    """A recording with a gap in its numbers, a repeat, a swap and a long pause."""
    first = recording(40)
    later = recording(40, first=41, start_us=first[-1].time_us + 4_300_000)
    frames = [*first[:10], *first[11:20], first[21], first[20], *first[22:], *later]
    return [*frames[:5], frames[3], *frames[5:]]


def records(frames: Iterable[Frame]) -> list[Record]:
    return [FrameRecord(item, received_us=0) for item in frames]


def fold_records(
    log: Sequence[Record], state=None, tracker=simple_tracker
) -> tuple[object, list[FoldOutput]]:
    """Fold records one after the other, from a fresh state unless one is given."""
    state = state or start("radar-1", 1, CONFIG, tracker)
    outputs = []
    for position, record in enumerate(log, start=state.position + 1):
        state, output = step(state, position, record, tracker)
        outputs.append(output)
    return state, outputs


def all_rows(outputs: Iterable[FoldOutput]) -> Rows:
    """The rows of the outputs as a database would have them in the end, without their log positions."""
    outputs = list(outputs)
    tracks = {row.key: dataclasses.replace(row, as_of=0) for out in outputs for row in out.rows.tracks}
    blocks = {(row.key, row.second): row for out in outputs for row in out.rows.blocks}
    assert len(blocks) == sum(len(out.rows.blocks) for out in outputs), "a block was emitted twice"
    return Rows(
        blocks=tuple(blocks[key] for key in sorted(blocks, key=repr)),
        tracks=tuple(tracks[key] for key in sorted(tracks, key=repr)),
        events=tuple(dataclasses.replace(row, as_of=0) for out in outputs for row in out.rows.events),
        lane_changes=tuple(row for out in outputs for row in out.rows.lane_changes),
        lane_maps=tuple(row for out in outputs for row in out.rows.lane_maps),
        **{name: _newest(outputs, name) for name in ("crossings", "minutes", "cells")},
    )


def _newest(outputs: Sequence[FoldOutput], name: str) -> tuple[object, ...]:
    """The newest of the rows that are given out again and again, by their keys."""
    rows = {row.key: dataclasses.replace(row, as_of=0) for out in outputs for row in getattr(out.rows, name)}
    return tuple(rows[key] for key in sorted(rows))


def history(outputs: Iterable[FoldOutput]) -> list[tuple[object, ...]]:
    """Each folded frame and tick to the bit, without log positions."""
    return [
        (item.number, item.boot, item.time_us, item.frame is None, item.report, *_bits(item.estimates))
        for out in outputs
        for item in out.folded
    ]


def _bits(estimates: object) -> list[bytes]:
    return [getattr(estimates, item.name).tobytes() for item in dataclasses.fields(estimates)]
