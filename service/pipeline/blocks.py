"""Collect the estimates of the tracks into one-second state blocks and track summaries.

A block leaves when its second is over or its track has ended; a summary leaves when a track is confirmed,
with each block, and at the end. Distance is summed in steps of at least `ANCHOR_STEP_M`, so that the
jitter of a standing vehicle does not add up to a journey.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from service.formats.length_class import length_class
from service.storage.rows import STATE_SAMPLE, Rows, StateBlock, TrackKey, TrackSummary
from service.tracking.model import F64, I64, MOTION_SHIFT, U8, Bool, TrackEstimates

ANCHOR_STEP_M = 1.0
_SECOND_US = 1_000_000
_MS_US = 1_000


@dataclass(frozen=True, slots=True)
class OpenTracks:
    """What was seen so far of the tracks that are listed: (T,) each, by number."""

    number: I64
    first_us: I64
    last_us: I64
    first_frame: I64
    last_frame: I64
    states: I64
    hits: I64
    length_m: F64
    width_m: F64
    existence: F64
    first_x_m: F64
    first_y_m: F64
    last_x_m: F64
    last_y_m: F64
    anchor_x_m: F64  # where the distance was last added up
    anchor_y_m: F64
    distance_m: F64  # up to the anchor
    speed_sum_mps: F64
    speed_max_mps: F64

    def take(self, index: I64 | Bool) -> OpenTracks:
        """Return the tracks at `index` (integers or a mask)."""
        return OpenTracks(*(getattr(self, item.name)[index] for item in dataclasses.fields(self)))


@dataclass(frozen=True, slots=True)
class OpenBlocks:
    """The samples of the second that is not over yet: (S,) each, in order of time, then number."""

    second: int
    number: I64
    frame: I64
    sample: U8  # (S, 26) STATE_SAMPLE without its frame_offset


@dataclass(frozen=True, slots=True)
class Collected:
    """Open tracks and blocks of one sensor."""

    tracks: OpenTracks
    blocks: OpenBlocks


@dataclass(frozen=True, slots=True)
class Moment:
    """The record that is being folded: whose, and when."""

    sensor_id: str
    epoch: int
    position: int
    time_us: int


def _no_tracks() -> OpenTracks:
    i, f = np.zeros(0, dtype=np.int64), np.zeros(0)
    return OpenTracks(i, i, i, i, i, i, i, f, f, f, f, f, f, f, f, f, f, f, f)


_NO_TRACKS = _no_tracks()


def nothing_collected() -> Collected:
    """Return the state before the first frame."""
    return Collected(_NO_TRACKS, _no_blocks(0))


def collect_frame(
    state: Collected, moment: Moment, frame_number: int, estimates: TrackEstimates
) -> tuple[Collected, Rows]:
    """Return the state after one more frame and the rows that it completes."""
    before, ended = _aligned(state.tracks, moment.time_us, frame_number, estimates)
    tracks = _seen(before, moment.time_us, frame_number, estimates)
    blocks, closed = _close(state.blocks, moment, ended.number)
    blocks = _add_samples(blocks, moment.time_us, frame_number, estimates)
    due = tracks.first_frame == frame_number
    if closed:
        due |= np.isin(tracks.number, [block.key.number for block in closed])
    rows = Rows(tuple(closed), _summaries(ended, moment, ended=True) + _summaries(tracks, moment, due=due))
    return Collected(tracks, blocks), rows


def collect_tick(state: Collected, moment: Moment, estimates: TrackEstimates) -> tuple[Collected, Rows]:
    """Return the state after a tick: lost tracks end, a second that is over closes; no sample is added."""
    stay = np.isin(state.tracks.number, estimates.number)
    tracks, ended = state.tracks.take(stay), state.tracks.take(~stay)
    blocks, closed = _close(state.blocks, moment, ended.number)
    due = np.isin(tracks.number, [block.key.number for block in closed])
    rows = Rows(tuple(closed), _summaries(ended, moment, ended=True) + _summaries(tracks, moment, due=due))
    return Collected(tracks, blocks), rows


def end_all(state: Collected, moment: Moment) -> Rows:
    """Return the rows that end every open track."""
    _, closed = _close(state.blocks, moment, state.tracks.number)
    return Rows(tuple(closed), _summaries(state.tracks, moment, ended=True))


def _aligned(
    tracks: OpenTracks, time_us: int, frame_number: int, now: TrackEstimates
) -> tuple[OpenTracks, OpenTracks]:
    """Return what was seen before of each track listed now, and the tracks that are listed no more."""
    if np.array_equal(tracks.number, now.number):
        return tracks, _NO_TRACKS
    ended = tracks.take(~np.isin(tracks.number, now.number))
    where = np.searchsorted(tracks.number, now.number)
    known = np.zeros(len(now), dtype=np.bool_)
    inside = where < len(tracks.number)
    known[inside] = tracks.number[where[inside]] == now.number[inside]
    aligned = _newborn(time_us, frame_number, now)
    for item in dataclasses.fields(aligned):
        getattr(aligned, item.name)[known] = getattr(tracks, item.name)[where[known]]
    return aligned, ended


def _newborn(time_us: int, frame_number: int, now: TrackEstimates) -> OpenTracks:
    """Return tracks that begin where they are now, with no frame counted, in arrays of their own."""
    count = len(now)
    zero = np.zeros(count)
    time, frame = np.full(count, time_us, dtype=np.int64), np.full(count, frame_number, dtype=np.int64)
    x, y = now.x_m.astype(np.float64), now.y_m.astype(np.float64)
    return OpenTracks(
        number=now.number.copy(), first_us=time, last_us=time.copy(), first_frame=frame,
        last_frame=frame.copy(), states=np.zeros(count, dtype=np.int64), hits=now.hits.copy(),
        length_m=zero.copy(), width_m=zero.copy(), existence=zero.copy(), first_x_m=x, first_y_m=y,
        last_x_m=x.copy(), last_y_m=y.copy(), anchor_x_m=x.copy(), anchor_y_m=y.copy(),
        distance_m=zero.copy(), speed_sum_mps=zero.copy(), speed_max_mps=zero.copy(),
    )  # fmt: skip


def _seen(before: OpenTracks, time_us: int, frame_number: int, now: TrackEstimates) -> OpenTracks:
    """Return the tracks with this frame added."""
    x, y = now.x_m.astype(np.float64), now.y_m.astype(np.float64)
    speed = np.hypot(now.vx_mps.astype(np.float64), now.vy_mps.astype(np.float64))
    step = np.hypot(x - before.anchor_x_m, y - before.anchor_y_m)
    moved = step >= ANCHOR_STEP_M
    return OpenTracks(
        number=before.number,
        first_us=before.first_us,
        last_us=np.full(len(now), time_us, dtype=np.int64),
        first_frame=before.first_frame,
        last_frame=np.full(len(now), frame_number, dtype=np.int64),
        states=before.states + 1,
        hits=now.hits,
        length_m=now.length_m.astype(np.float64),
        width_m=now.width_m.astype(np.float64),
        existence=now.existence.astype(np.float64),
        first_x_m=before.first_x_m,
        first_y_m=before.first_y_m,
        last_x_m=x,
        last_y_m=y,
        anchor_x_m=np.where(moved, x, before.anchor_x_m),
        anchor_y_m=np.where(moved, y, before.anchor_y_m),
        distance_m=before.distance_m + np.where(moved, step, 0.0),
        speed_sum_mps=before.speed_sum_mps + speed,
        speed_max_mps=np.maximum(before.speed_max_mps, speed),
    )


def _no_blocks(second: int) -> OpenBlocks:
    empty = np.zeros(0, dtype=np.int64)
    return OpenBlocks(second, empty, empty, np.zeros((0, STATE_SAMPLE.itemsize), dtype=np.uint8))


def _add_samples(blocks: OpenBlocks, time_us: int, frame_number: int, now: TrackEstimates) -> OpenBlocks:
    samples = np.zeros(len(now), dtype=STATE_SAMPLE)
    for name in ("x_m", "y_m", "vx_mps", "vy_mps", "std_x_m", "std_y_m", "lane"):
        samples[name] = getattr(now, name)
    samples["status"] = now.status | now.motion << MOTION_SHIFT
    samples["time_offset_ms"] = (time_us - blocks.second * _SECOND_US) // _MS_US
    return OpenBlocks(
        blocks.second,
        np.concatenate([blocks.number, now.number]),
        np.concatenate([blocks.frame, np.full(len(now), frame_number, dtype=np.int64)]),
        np.concatenate([blocks.sample, samples.view(np.uint8).reshape(-1, STATE_SAMPLE.itemsize)]),
    )


def _close(blocks: OpenBlocks, moment: Moment, ended: I64) -> tuple[OpenBlocks, list[StateBlock]]:
    """Return what stays open now, and the blocks of the second that is over or of the ended tracks."""
    second = moment.time_us // _SECOND_US
    if second > blocks.second:
        return _no_blocks(second), _blocks(blocks, moment, np.unique(blocks.number))
    if len(ended) == 0:
        return blocks, []
    stay = ~np.isin(blocks.number, ended)
    rest = OpenBlocks(blocks.second, blocks.number[stay], blocks.frame[stay], blocks.sample[stay])
    return rest, _blocks(blocks, moment, np.intersect1d(blocks.number, ended))


def _blocks(blocks: OpenBlocks, moment: Moment, numbers: I64) -> list[StateBlock]:
    return [_block(blocks, moment, number) for number in numbers.tolist()]


def _block(blocks: OpenBlocks, moment: Moment, number: int) -> StateBlock:
    mine = blocks.number == number
    samples = blocks.sample[mine].view(STATE_SAMPLE).reshape(-1)
    frames = blocks.frame[mine]
    samples["frame_offset"] = frames - frames[0]
    key = TrackKey(moment.sensor_id, moment.epoch, number)
    return StateBlock(key, blocks.second, int(frames[0]), samples.tobytes())


def _summaries(
    tracks: OpenTracks, moment: Moment, *, due: Bool | None = None, ended: bool = False
) -> tuple[TrackSummary, ...]:
    """Return the summaries of the tracks that are due (None: all)."""
    wanted = range(len(tracks.number)) if due is None else np.flatnonzero(due).tolist()
    return tuple(_summary(tracks, i, moment, ended=ended) for i in wanted)


def _summary(tracks: OpenTracks, i: int, moment: Moment, *, ended: bool) -> TrackSummary:
    length_m, width_m = _known(tracks.length_m[i]), _known(tracks.width_m[i])
    states = int(tracks.states[i])
    last_step = np.hypot(tracks.last_x_m[i] - tracks.anchor_x_m[i], tracks.last_y_m[i] - tracks.anchor_y_m[i])
    return TrackSummary(
        key=TrackKey(moment.sensor_id, moment.epoch, int(tracks.number[i])),
        as_of=moment.position,
        ended=ended,
        first_time_us=int(tracks.first_us[i]),
        last_time_us=int(tracks.last_us[i]),
        first_frame=int(tracks.first_frame[i]),
        last_frame=int(tracks.last_frame[i]),
        states=states,
        hits=int(tracks.hits[i]),
        length_m=length_m,
        width_m=width_m,
        length_class=length_class(length_m),
        existence=float(tracks.existence[i]),
        first_x_m=float(tracks.first_x_m[i]),
        first_y_m=float(tracks.first_y_m[i]),
        last_x_m=float(tracks.last_x_m[i]),
        last_y_m=float(tracks.last_y_m[i]),
        distance_m=float(tracks.distance_m[i] + last_step),
        mean_speed_mps=float(tracks.speed_sum_mps[i] / states),
        max_speed_mps=float(tracks.speed_max_mps[i]),
    )


def _known(value: float) -> float | None:
    return None if math.isnan(value) else float(value)
