"""Tracks that are not listed for a while and then again: they stay open, and are one track."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from service.pipeline import fold_snapshot
from service.pipeline.blocks import Moment, collect_frame, collect_tick, end_all, nothing_collected
from service.pipeline.fold import start
from service.pipeline.records import TickRecord
from service.storage.rows import STATE_SAMPLE
from service.tracking.model import I64, StepReport
from tests.pipeline.recordings import CONFIG, all_rows, fold_records, recording, records
from tests.traffic.tracks import FRAME_US, START_US, estimates

SECOND_US = 1_000_000
BOUNDS_M = (2.6, 7.0, 14.9)
NONE = np.zeros(0, dtype=np.int64)


def moment(frame):
    return Moment("radar-1", 1, frame, START_US + frame * FRAME_US, BOUNDS_M)


def collected(frames, resting=None, state=None, first=0):
    """Return the state after frames of numbers listed, and the rows of each.

    Vehicles drive at 10 m/s, number 1 at x = 0, number 2 at x = 3.5. resting: the numbers at rest by frame.
    """
    state, rows = state or nothing_collected(), []
    for k, listed in enumerate(frames, start=first):
        now = estimates(listed, [3.5 * (n - 1) for n in listed], 20.0 + 0.5 * k, 0.0, 10.0)
        asleep = np.array((resting or {}).get(k, []), dtype=np.int64)
        state, found = collect_frame(state, moment(k), k, now, asleep)
        rows.append(found)
    return state, rows


def resting_from(first, last, number=1):
    return {k: [number] for k in range(first, last)}


def samples_of(block):
    return np.frombuffer(block.samples, STATE_SAMPLE)


def test_a_track_whose_number_rests_has_not_ended():
    frames = [*[[1, 2]] * 30, *[[2]] * 60]

    state, rows = collected(frames, resting_from(30, 90))

    of_it = [(k, row) for k, part in enumerate(rows) for row in part.tracks if row.key.number == 1]
    assert [(k, row.ended) for k, row in of_it] == [(0, False), (20, False), (40, False)]
    assert state.tracks.number.tolist() == [2]
    assert state.resting.number.tolist() == [1]


def test_its_last_block_comes_when_its_second_is_over_with_what_is_known_of_it():
    _, rows = collected([*[[1, 2]] * 30, *[[2]] * 60], resting_from(30, 90))

    blocks = [(k, block) for k, part in enumerate(rows) for block in part.blocks if block.key.number == 1]
    assert [(k, block.first_frame, len(samples_of(block))) for k, block in blocks] == [
        (20, 0, 20),
        (40, 20, 10),
    ]
    (summary,) = [row for row in rows[40].tracks if row.key.number == 1]
    assert (summary.ended, summary.states, summary.last_frame) == (False, 30, 29)
    assert summary.last_time_us == START_US + 29 * FRAME_US


def test_it_ends_when_it_rests_no_more():
    _, rows = collected([*[[1, 2]] * 30, *[[2]] * 60], resting_from(30, 80))

    (ended,) = [(k, row) for k, part in enumerate(rows) for row in part.tracks if row.ended]
    k, summary = ended
    assert (k, summary.key.number, summary.states, summary.as_of) == (80, 1, 30, 80)
    assert (summary.last_frame, summary.last_time_us) == (29, START_US + 29 * FRAME_US)
    assert [block.key.number for block in rows[80].blocks].count(1) == 0  # told long before


def test_it_ends_by_a_tick_too():
    state, _ = collected([*[[1, 2]] * 30, *[[2]] * 60], resting_from(30, 90))
    still = estimates([2], 3.5, 65.0, 0.0, 10.0)

    state, rows = collect_tick(state, moment(110), still, np.array([1]))
    assert not [row for row in rows.tracks if row.ended]
    assert state.resting.number.tolist() == [1]
    state, rows = collect_tick(state, moment(130), still, NONE)

    assert [(row.key.number, row.ended) for row in rows.tracks] == [(1, True)]
    assert not len(state.resting.number)
    assert state.tracks.number.tolist() == [2]


def test_one_that_comes_to_rest_by_a_tick_has_not_ended():
    state, _ = collected([[1, 2]] * 30)

    state, rows = collect_tick(state, moment(50), estimates([2], 3.5, 65.0, 0.0, 10.0), np.array([1]))

    assert {(row.key.number, row.ended) for row in rows.tracks} == {(1, False), (2, False)}
    assert sorted(block.key.number for block in rows.blocks) == [1, 2]
    assert state.resting.number.tolist() == [1]


def test_the_summary_of_one_that_came_back_spans_both_times():
    frames = [*[[1, 2]] * 30, *[[2]] * 60, *[[1, 2]] * 40, *[[2]] * 2]

    state, rows = collected(frames, resting_from(30, 90))

    of_it = [row for part in rows for row in part.tracks if row.key.number == 1]
    (last,) = [row for row in of_it if row.ended]
    assert last is of_it[-1]
    assert (last.first_frame, last.last_frame, last.states) == (0, 129, 70)
    assert (last.first_time_us, last.last_time_us) == (START_US, START_US + 129 * FRAME_US)
    assert last.distance_m == pytest.approx(129 * 0.5, abs=0.01)  # that nobody saw too
    assert last.mean_speed_mps == pytest.approx(10.0)
    assert (last.first_y_m, last.last_y_m) == (20.0, 20.0 + 0.5 * 129)
    assert last.hits == 100  # fifty each time, by `estimates`
    assert not len(state.resting.number)
    keys = [(block.second, block.key) for part in rows for block in part.blocks]
    assert len(keys) == len(set(keys))
    seen = [samples_of(b)["y_m"] for part in rows for b in part.blocks if b.key.number == 1]
    np.testing.assert_allclose(np.concatenate(seen), 20.0 + 0.5 * np.r_[0:30, 90:130])


def test_it_may_rest_more_than_once():
    frames = [*[[1]] * 10, *[[]] * 10, *[[1]] * 10, *[[]] * 10, *[[1]] * 10]

    state, rows = collected(frames, resting_from(10, 20) | resting_from(30, 40))
    (end,) = end_all(state, moment(50)).tracks

    assert not [row for part in rows for row in part.tracks if row.ended]
    assert (end.states, end.first_frame, end.last_frame, end.hits) == (30, 0, 49, 150)


def test_its_length_stays_known_while_it_is_measured_anew():
    state, _ = collected([*[[1]] * 10, *[[]] * 10], resting_from(10, 20))
    again = estimates([1], 0.0, 30.0, 0.0, 10.0)
    unknown = np.array([np.nan], dtype=np.float32)
    again = dataclasses.replace(again, length_m=unknown, width_m=unknown)

    state, _ = collect_frame(state, moment(20), 20, again, NONE)
    (end,) = end_all(state, moment(20)).tracks

    assert (end.length_m, end.length_class) == (4.5, "short")
    assert end.width_m == pytest.approx(1.9)


def test_what_is_seen_before_and_after_within_a_second_is_one_block():
    state, rows = collected([*[[1, 2]] * 5, *[[2]] * 5, *[[1, 2]] * 15], resting_from(5, 10))

    (block,) = [block for part in rows for block in part.blocks if block.key.number == 1]
    assert (block.second, block.first_frame) == (START_US // SECOND_US, 0)
    table = samples_of(block)
    assert table["frame_offset"].tolist() == [*range(5), *range(10, 20)]
    np.testing.assert_array_equal(table["time_offset_ms"], 50 * table["frame_offset"])
    assert state.blocks.number.tolist() == [1, 2] * 5


def test_where_all_ends_those_that_rest_end_too():
    state, _ = collected([*[[1, 2]] * 30, *[[2]] * 5], resting_from(30, 35))

    rows = end_all(state, moment(35))

    assert [(row.key.number, row.ended, row.states) for row in rows.tracks] == [(1, True, 30), (2, True, 35)]
    assert [(block.key.number, len(samples_of(block))) for block in rows.blocks] == [(1, 10), (2, 15)]


# ---------------------------------------------------------------- with a tracker, by the whole fold


@dataclasses.dataclass(frozen=True, slots=True)
class BlinkingState:
    """A tracker's that lists one track, lets it rest, and lists it again, by the count of frames."""

    frames: int
    resting: I64
    since_us: int

    @property
    def idle(self) -> bool:
        return not len(self.resting)

    @property
    def resting_numbers(self) -> I64:
        return self.resting


def blinking(hidden, keep_s=30.0):
    """A tracker whose only track is not listed in the frames `hidden`; its number rests then, for a while."""

    def begin(parameters=None):
        return BlinkingState(0, NONE, 0)

    def go_on(state, frame, parameters):
        count = state.frames + 1
        if count in hidden:
            since_us = state.since_us if len(state.resting) else frame.time_us
            over = frame.time_us - since_us > keep_s * 1e6
            return BlinkingState(count, NONE if over else np.array([1]), since_us), NOBODY, StepReport()
        now = estimates([1], 4.0, 30.0 + 0.5 * count, 0.0, 10.0)
        return BlinkingState(count, NONE, frame.time_us), now, StepReport()

    def wait(state, time_us, parameters):
        over = time_us - state.since_us > keep_s * 1e6
        return dataclasses.replace(state, resting=NONE if over else state.resting), NOBODY, StepReport()

    return SimpleNamespace(initial_state=begin, step=go_on, coast=wait)


NOBODY = estimates([], 0, 0, 0, 0)


def folded(tracker, log):
    return fold_records(log, start("radar-1", 1, CONFIG, tracker), tracker)


def test_the_fold_takes_a_track_that_came_back_for_one():
    frames = recording(140)

    _, outputs = folded(blinking(range(31, 91)), [*records(frames), TickRecord(frames[-1].time_us + 10**8)])

    (track,) = all_rows(outputs).tracks
    assert (track.first_frame, track.last_frame, track.states, track.ended) == (1, 140, 80, True)
    assert [row.ended for out in outputs for row in out.rows.tracks].count(True) == 1


def test_the_fold_wants_ticks_until_a_number_rests_no_more():
    frames = recording(40)

    state, _ = folded(blinking(range(31, 99)), records(frames))
    assert state.wants_ticks
    assert not state.quiet
    state, ticked = fold_records(
        [TickRecord(frames[-1].time_us + k * SECOND_US) for k in range(1, 60)], state, blinking(())
    )

    given = [k for k, out in enumerate(ticked, start=1) for row in out.rows.tracks if row.ended]
    assert given == [30]  # half a second after its last frame and 30 s on
    assert state.quiet


def test_a_snapshot_while_a_number_rests_ends_it_alike():
    frames = recording(140)
    tracker = blinking(range(31, 91))
    state, _ = folded(tracker, records(frames[:60]))

    restored = fold_snapshot.load(fold_snapshot.dump(state), tracker)

    rest = [*records(frames[60:]), TickRecord(frames[-1].time_us + 10**8)]
    assert restored.collected.resting.number.tolist() == [1]
    assert all_rows(fold_records(rest, restored, tracker)[1]) == all_rows(
        fold_records(rest, state, tracker)[1]
    )
