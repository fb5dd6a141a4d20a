"""Collect the estimates of the tracks into one-second state blocks and track summaries.

A block leaves when its second is over or its track has ended; a summary leaves when a track is confirmed,
with each block, and at the end. Distance is summed in steps of at least `ANCHOR_STEP_M`, so that the
jitter of a standing vehicle does not add up to a journey.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.formats.length_class import length_class
from service.storage.rows import STATE_SAMPLE, Rows, StateBlock, TrackKey, TrackSummary
from service.tracking.model import F64, I64, MOTION_SHIFT, U8, Bool, TrackEstimates
from service.traffic.vehicles import find

ANCHOR_STEP_M = 1.0
_SECOND_US = 1_000_000
_MS_US = 1_000


# rows of `OpenTracks.whole`
NUMBER, FIRST_US, LAST_US, FIRST_FRAME, LAST_FRAME, STATES, HITS, EARLIER_HITS = range(8)
# rows of `OpenTracks.real`; the anchor is where the distance was last added up
LENGTH, WIDTH, EXISTENCE, FIRST_X, FIRST_Y, LAST_X, LAST_Y, ANCHOR_X, ANCHOR_Y = range(9)
DISTANCE, SPEED_SUM, SPEED_MAX = range(9, 12)
_EXTENT = slice(LENGTH, EXISTENCE + 1)
_FIRST, _LAST, _ANCHOR = slice(FIRST_X, LAST_X), slice(LAST_X, ANCHOR_X), slice(ANCHOR_X, DISTANCE)


@dataclass(frozen=True, slots=True)
class OpenTracks:
    """What was seen so far of the T tracks that are listed, by number."""

    whole: I64  # (8, T) EARLIER_HITS: of the tracks that bore the number before
    real: F64  # (12, T) metres, m/s

    @property
    def number(self) -> I64:
        """Return the numbers of the tracks, (T,)."""
        return np.asarray(self.whole[NUMBER])

    def take(self, index: I64 | Bool) -> OpenTracks:
        """Return the tracks at `index` (integers or a mask)."""
        where = np.flatnonzero(index) if index.dtype == np.bool_ else index
        return OpenTracks(self.whole.take(where, axis=1), self.real.take(where, axis=1))


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
    resting: OpenTracks  # not listed now, but their numbers may be again
    blocks: OpenBlocks


@dataclass(frozen=True, slots=True)
class Moment:
    """The record that is being folded: whose, and when."""

    sensor_id: str
    epoch: int
    position: int
    time_us: int
    length_bounds_m: tuple[float, ...]  # of the length classes


_NO_TRACKS = OpenTracks(np.zeros((EARLIER_HITS + 1, 0), dtype=np.int64), np.zeros((SPEED_MAX + 1, 0)))


def nothing_collected() -> Collected:
    """Return the state before the first frame."""
    return Collected(_NO_TRACKS, _NO_TRACKS, _no_blocks(0))


def collect_frame(
    state: Collected, moment: Moment, frame_number: int, estimates: TrackEstimates, resting: I64
) -> tuple[Collected, Rows]:
    """Return the state after one more frame and the rows that it completes.

    resting (R,): numbers that are not listed now, but may be again: such a track has not ended.
    """
    before, rests, ended = _sorted_out(state, estimates.number, resting)
    tracks = _seen(
        _aligned(before, moment.time_us, frame_number, estimates), moment.time_us, frame_number, estimates
    )
    blocks, closed = _close(state.blocks, moment, ended.number)
    blocks = _add_samples(blocks, moment.time_us, frame_number, estimates)
    due = tracks.take((tracks.whole[FIRST_FRAME] == frame_number) | _told_of(tracks, closed))
    return Collected(tracks, rests, blocks), _rows(moment, closed, ended, due, rests)


def collect_tick(
    state: Collected, moment: Moment, estimates: TrackEstimates, resting: I64
) -> tuple[Collected, Rows]:
    """Return the state after a tick: lost tracks end, a second that is over closes; no sample is added."""
    tracks, rests, ended = _sorted_out(state, estimates.number, resting)
    blocks, closed = _close(state.blocks, moment, ended.number)
    due = tracks.take(_told_of(tracks, closed))
    return Collected(tracks, rests, blocks), _rows(moment, closed, ended, due, rests)


def end_all(state: Collected, moment: Moment) -> Rows:
    """Return the rows that end every open track."""
    tracks = _together(state.tracks, state.resting)
    _, closed = _close(state.blocks, moment, tracks.number)
    return Rows(tuple(closed), _summaries(tracks, moment, ended=True))


def _sorted_out(state: Collected, listed: I64, resting: I64) -> tuple[OpenTracks, OpenTracks, OpenTracks]:
    """Return of the open tracks those listed now, those that rest, and those that have ended."""
    if np.array_equal(state.tracks.number, listed) and np.isin(state.resting.number, resting).all():
        return state.tracks, state.resting, _NO_TRACKS
    tracks = _together(state.tracks, state.resting)
    here = np.isin(tracks.number, listed)
    rests = ~here & np.isin(tracks.number, resting)
    return tracks.take(here), _at_rest(tracks.take(rests)), tracks.take(~(here | rests))


def _at_rest(tracks: OpenTracks) -> OpenTracks:
    """Return the tracks with their hits put by: one that is listed again counts from one."""
    whole = tracks.whole.copy()
    whole[EARLIER_HITS] += whole[HITS]
    whole[HITS] = 0
    return OpenTracks(whole, tracks.real)


def _together(tracks: OpenTracks, others: OpenTracks) -> OpenTracks:
    """Return all tracks by number."""
    if not len(others.number):
        return tracks
    whole = np.concatenate([tracks.whole, others.whole], axis=1)
    real = np.concatenate([tracks.real, others.real], axis=1)
    return OpenTracks(whole, real).take(np.argsort(whole[NUMBER], kind="stable"))


def _told_of(tracks: OpenTracks, closed: list[StateBlock]) -> Bool:
    """Return which tracks (T,) have a block that closes now."""
    if not closed:
        return np.zeros(len(tracks.number), dtype=np.bool_)
    return np.asarray(find(np.array([block.key.number for block in closed]), tracks.number) >= 0)


def _rows(
    moment: Moment, closed: list[StateBlock], ended: OpenTracks, due: OpenTracks, rests: OpenTracks
) -> Rows:
    """Return the blocks that close now, with the summaries of the tracks that ended or are due."""
    summaries = _summaries(ended, moment, ended=True) + _summaries(due, moment)
    return Rows(tuple(closed), summaries + _summaries(rests.take(_told_of(rests, closed)), moment))


def _aligned(tracks: OpenTracks, time_us: int, frame_number: int, now: TrackEstimates) -> OpenTracks:
    """Return what was seen before of each track listed now; tracks: those of them that were open."""
    if len(tracks.number) == len(now.number):
        return tracks
    before = find(tracks.number, now.number)
    known = np.flatnonzero(before >= 0)
    aligned = _newborn(time_us, frame_number, now)
    aligned.whole[:, known] = tracks.whole[:, before[known]]
    aligned.real[:, known] = tracks.real[:, before[known]]
    return aligned


def _newborn(time_us: int, frame_number: int, now: TrackEstimates) -> OpenTracks:
    """Return tracks that begin where they are now, with no frame counted, in arrays of their own."""
    whole, real = np.zeros((EARLIER_HITS + 1, len(now)), dtype=np.int64), np.zeros((SPEED_MAX + 1, len(now)))
    whole[NUMBER], whole[FIRST_US], whole[FIRST_FRAME] = now.number, time_us, frame_number
    real[_EXTENT] = np.nan
    for places in (_FIRST, _LAST, _ANCHOR):
        real[places] = now.x_m, now.y_m
    return OpenTracks(whole, real)


def _seen(before: OpenTracks, time_us: int, frame_number: int, now: TrackEstimates) -> OpenTracks:
    """Return the tracks with this frame added."""
    whole, real = before.whole.copy(), before.real.copy()
    # fewer than before: its number goes on with a younger track
    whole[EARLIER_HITS] += np.where(now.hits < whole[HITS], whole[HITS], 0)
    whole[LAST_US], whole[LAST_FRAME], whole[HITS] = time_us, frame_number, now.hits
    whole[STATES] += 1
    columns = (now.x_m, now.y_m, now.vx_mps, now.vy_mps, now.length_m, now.width_m, now.existence)
    seen = np.array(columns, dtype=np.float64)
    place, velocity = seen[:2], seen[2:4]
    # of one that has rested the extent is not known again at once, but was
    real[_EXTENT], real[_LAST] = np.where(np.isnan(seen[4:]), real[_EXTENT], seen[4:]), place
    step = np.hypot(*(place - real[_ANCHOR]))
    moved = step >= ANCHOR_STEP_M
    real[_ANCHOR] = np.where(moved, place, real[_ANCHOR])
    real[DISTANCE] += np.where(moved, step, 0.0)
    speed = np.hypot(*velocity)
    real[SPEED_SUM] += speed
    real[SPEED_MAX] = np.maximum(real[SPEED_MAX], speed)
    return OpenTracks(whole, real)


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
        return _no_blocks(second), _blocks(blocks, moment)
    if len(ended) == 0:
        return blocks, []
    over = find(ended, blocks.number) >= 0
    parts = [
        OpenBlocks(blocks.second, blocks.number[which], blocks.frame[which], blocks.sample[which])
        for which in (~over, over)
    ]
    return parts[0], _blocks(parts[1], moment)


def _blocks(blocks: OpenBlocks, moment: Moment) -> list[StateBlock]:
    """Return the samples as a block for each track, by number."""
    order = np.argsort(blocks.number, kind="stable")
    numbers, first, count = np.unique(blocks.number[order], return_index=True, return_counts=True)
    samples, frames = blocks.sample[order], blocks.frame[order]
    samples.view(STATE_SAMPLE).reshape(-1)["frame_offset"] = frames - np.repeat(frames[first], count)
    return [
        StateBlock(
            TrackKey(moment.sensor_id, moment.epoch, number),
            blocks.second,
            frame,
            samples[at : at + many].tobytes(),
        )
        for number, frame, at, many in zip(
            numbers.tolist(), frames[first].tolist(), first.tolist(), count.tolist(), strict=True
        )
    ]


def _summaries(tracks: OpenTracks, moment: Moment, *, ended: bool = False) -> tuple[TrackSummary, ...]:
    """Return the summaries of the tracks."""
    if not len(tracks.number):
        return ()
    last_step = np.hypot(*(tracks.real[_LAST] - tracks.real[_ANCHOR]))
    table = tracks.real.copy()
    table[DISTANCE] += last_step
    table[SPEED_SUM] /= tracks.whole[STATES]
    return tuple(
        _summary(whole, real, moment, ended=ended)
        for whole, real in zip(tracks.whole.T.tolist(), table.T.tolist(), strict=True)
    )


def _summary(whole: list[int], real: list[float], moment: Moment, *, ended: bool) -> TrackSummary:
    """Return the summary of one track; the sum of its speeds has been divided by its states already."""
    length_m, width_m = _known(real[LENGTH]), _known(real[WIDTH])
    return TrackSummary(
        key=TrackKey(moment.sensor_id, moment.epoch, whole[NUMBER]),
        as_of=moment.position,
        ended=ended,
        first_time_us=whole[FIRST_US],
        last_time_us=whole[LAST_US],
        first_frame=whole[FIRST_FRAME],
        last_frame=whole[LAST_FRAME],
        states=whole[STATES],
        hits=whole[EARLIER_HITS] + whole[HITS],
        length_m=length_m,
        width_m=width_m,
        length_class=length_class(length_m, moment.length_bounds_m),
        existence=real[EXISTENCE],
        first_x_m=real[FIRST_X],
        first_y_m=real[FIRST_Y],
        last_x_m=real[LAST_X],
        last_y_m=real[LAST_Y],
        distance_m=real[DISTANCE],
        mean_speed_mps=real[SPEED_SUM],
        max_speed_mps=real[SPEED_MAX],
    )


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value
