"""Fold recorded frames as the host would: the same fold, with ticks at gaps and at the end.

from service import track

recording = track("frames.jsonl.gz", "site.json")
for scan in recording:
    print(scan.number, scan.estimates.x_m, scan.estimates.y_m)
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numpy as np
from pydantic import ValidationError

from service.errors import FieldError, InvalidFrame, InvalidInput
from service.formats.json_frames import parse_frame, read_frames
from service.formats.sensor import SensorConfig
from service.formats.tracks import frame_line
from service.pipeline.fold import TICK_US, start, step
from service.pipeline.fold_state import MAX_TICKS, Folded, FoldOutput, FoldState, Tracker
from service.pipeline.order import Fate
from service.pipeline.records import FrameRecord, TickRecord
from service.storage.rows import EventRow, Rows, StateBlock, TrackSummary, merge_rows
from service.tracking import tracker as default_tracker
from service.tracking.model import F64, I64, Frame

Site = str | Path | Mapping[str, object] | SensorConfig
FrameSource = str | Path | Sequence[str | Path] | Iterable[Frame] | Iterable[Mapping[str, object]]


def fold_frames(
    frames: Iterable[Frame],
    config: SensorConfig,
    *,
    epoch: int = 1,
    tracker: Tracker[Any] | ModuleType = default_tracker,
    at_end: Callable[[FoldState[Any]], None] | None = None,
) -> Iterator[FoldOutput]:
    """Yield what each frame leads to, in their order, and last what time alone leads to after them.

    at_end: is given the state when all is folded.
    Raises InvalidInput when a parameter of the configuration is wrong.
    """
    engine: Tracker[Any] = cast("Any", tracker)
    state = start(config.sensor_id, epoch, config, engine)
    position = 0
    for position, frame in enumerate(frames, start=1):
        state, output = step(state, position, FrameRecord(frame, received_us=frame.time_us), engine)
        yield output
    newest_us = state.order.newest_us
    if newest_us is not None:
        end = TickRecord(newest_us + (MAX_TICKS + 1) * TICK_US)
        state, output = step(state, position + 1, end, engine)
        yield output
    if at_end is not None:
        at_end(state)


@dataclass(frozen=True, slots=True)
class Trajectory:
    """The states of one track, frame by frame: (N,) each."""

    number: int
    time_s: F64  # since the first frame of the recording
    frame: I64
    x_m: F64
    y_m: F64
    vx_mps: F64
    vy_mps: F64

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True, slots=True)
class Recording:
    """What was found in recorded frames. Iterating gives the frames, in order of time."""

    sensor_id: str
    parameters_digest: str
    scans: tuple[Folded, ...]  # one a folded frame
    rows: Rows = field(repr=False)
    fates: Mapping[Fate, int]
    missing: int  # frame numbers that never came

    def __iter__(self) -> Iterator[Folded]:
        return iter(self.scans)

    def __len__(self) -> int:
        return len(self.scans)

    @property
    def summaries(self) -> tuple[TrackSummary, ...]:
        """What is known of each track, in order of number."""
        return tuple(sorted(self.rows.tracks, key=lambda row: (row.key.epoch, row.key.number)))

    @property
    def blocks(self) -> tuple[StateBlock, ...]:
        """The one-second state blocks, as the database would keep them."""
        return self.rows.blocks

    @property
    def events(self) -> tuple[EventRow, ...]:
        """What happened at the sensor."""
        return self.rows.events

    def trajectory(self, number: int) -> Trajectory:
        """Return the states of one track (empty when there is none of that number)."""
        columns = ("x_m", "y_m", "vx_mps", "vy_mps")
        found: list[tuple[float, ...]] = []
        for scan in self.scans:
            for i in np.flatnonzero(scan.estimates.number == number):
                time_s = (scan.time_us - self.scans[0].time_us) / 1e6
                found.append((time_s, scan.number, *(getattr(scan.estimates, name)[i] for name in columns)))
        table = np.array(found, dtype=np.float64).reshape(-1, 2 + len(columns)).T
        return Trajectory(number, table[0], table[1].astype(np.int64), *table[2:])

    def lines(self) -> Iterator[bytes]:
        """Yield tracks.jsonl line by line, without line breaks."""
        for scan in self.scans:
            yield frame_line(self.sensor_id, scan.epoch, scan.number, scan.time_us, scan.estimates)


def track(
    frames: FrameSource,
    site: Site | None = None,
    *,
    filter: str | None = None,  # noqa: A002 - the name of the setting
    settings: Mapping[str, object] | None = None,
    tracker: Tracker[Any] | ModuleType = default_tracker,
) -> Recording:
    """Track recorded frames and return what was found.

    frames: path of a JSON-lines file (gzip or not), several of them, or frames (`Frame` or as on the wire).
    site: path or content of a SITE.json, or a SensorConfig; the defaults without one.
    filter: name of the filter; settings: dotted parameters, such as {"clustering.window_frames": 6}.
    Raises InvalidInput or InvalidFrame naming what is wrong, OSError when a file cannot be read.
    """
    config = _configured(read_site(site), filter, settings or {})
    parameters = config.tracker_parameters()
    outputs = list(fold_frames(_frames(frames, config), config, tracker=tracker))
    fates: dict[Fate, int] = {}
    for output in outputs[:-1]:
        fates[output.fate] = fates.get(output.fate, 0) + 1
    return Recording(
        sensor_id=config.sensor_id,
        parameters_digest=parameters.digest(),
        scans=tuple(scan for output in outputs for scan in output.frames),
        rows=merge_rows(output.rows for output in outputs),
        fates=fates,
        missing=sum(output.missing for output in outputs),
    )


def read_site(site: Site | None) -> SensorConfig:
    """Return the configuration that a SITE.json or its content holds; raises InvalidInput with each fault."""
    if site is None:
        return SensorConfig()
    if isinstance(site, SensorConfig):
        return site
    try:
        content = site if isinstance(site, Mapping) else json.loads(Path(site).read_text(encoding="utf-8"))
        return SensorConfig.model_validate(content)
    except ValidationError as error:
        faults = [FieldError("/" + "/".join(map(str, item["loc"])), item["msg"]) for item in error.errors()]
        raise InvalidInput(f"{faults[0].pointer}: {faults[0].reason}", faults) from None
    except json.JSONDecodeError as error:
        raise InvalidInput(f"{site} is not JSON: {error}") from None


def _configured(
    config: SensorConfig, filter_name: str | None, settings: Mapping[str, object]
) -> SensorConfig:
    overrides = {**config.parameters, **{key: str(value) for key, value in settings.items()}}
    return config.model_copy(update={"filter": filter_name or config.filter, "parameters": overrides})


def _frames(frames: FrameSource, config: SensorConfig) -> Iterator[Frame]:
    """Yield the frames of whatever they were given as."""
    if isinstance(frames, str | Path):
        yield from read_frames([Path(frames)], config)
        return
    rest = iter(frames)
    first = next(rest, None)
    if isinstance(first, str | Path):
        yield from read_frames([Path(str(path)) for path in chain([first], rest)], config)
        return
    for item in chain([] if first is None else [first], rest):
        if isinstance(item, Frame):
            yield item
        elif isinstance(item, Mapping):
            yield parse_frame(dict(item), config)
        else:
            raise InvalidFrame(f"want frames or paths of files with frames, got {type(item).__name__}")
