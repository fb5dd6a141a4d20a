from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.errors import SnapshotUnreadable
from service.pipeline import fold_snapshot
from service.pipeline.fold import CLOCK_SET_BACK, CONFIGURATION_REFUSED, start, step
from service.pipeline.fold_state import MAX_TICKS
from service.pipeline.order import Fate
from service.pipeline.records import ControlRecord, FrameRecord, TickRecord
from service.storage.rows import STATE_SAMPLE
from tests.pipeline import simple_tracker
from tests.pipeline.recordings import (
    CONFIG,
    PERIOD_US,
    START_US,
    all_rows,
    fold_records,
    frame,
    history,
    recording,
    records,
)

SECOND_US = 1_000_000


def ticks(after_us: int, count: int) -> list[TickRecord]:
    return [TickRecord(after_us + k * SECOND_US) for k in range(1, count + 1)]


def test_each_block_holds_one_track_and_one_second():
    frames = recording(50, start_us=START_US + 300_000)

    _, outputs = fold_records([*records(frames), *ticks(frames[-1].time_us, 5)])

    rows = all_rows(outputs)
    seconds = [(block.key.number, block.second - START_US // SECOND_US) for block in rows.blocks]
    assert seconds == [(1, 0), (1, 1), (1, 2), (2, 0), (2, 1), (2, 2)]
    samples = [np.frombuffer(block.samples, STATE_SAMPLE) for block in rows.blocks]
    assert [len(s) for s in samples] == [13, 20, 16] * 2  # the first frame confirms nothing yet
    assert [block.first_frame for block in rows.blocks] == [2, 15, 35] * 2
    np.testing.assert_array_equal(samples[1]["time_offset_ms"], np.arange(20) * 50)
    np.testing.assert_array_equal(samples[1]["frame_offset"], np.arange(20))


def test_the_last_summary_of_a_track_tells_its_whole_life():
    frames = recording(50)

    _, outputs = fold_records([*records(frames), *ticks(frames[-1].time_us, 5)])

    first, second = all_rows(outputs).tracks
    assert (first.key.number, second.key.number) == (1, 2)
    assert first.ended
    assert (first.first_frame, first.last_frame, first.states, first.hits) == (2, 50, 49, 50)
    assert first.first_time_us == frames[1].time_us
    assert first.last_time_us == frames[-1].time_us
    assert first.distance_m == pytest.approx(48 * 0.5, abs=0.01)
    assert (first.length_m, first.length_class) == (4.5, "short")
    assert first.width_m is None


def test_a_track_is_classed_by_the_bounds_of_its_sensor():
    frames = recording(30)
    config = CONFIG.model_copy(update={"length_bounds_m": (2.6, 4.0, 14.9)})  # the tracks are 4.5 m long

    _, outputs = fold_records(records(frames), start("radar-1", 1, config, simple_tracker))

    assert {row.length_class for row in all_rows(outputs).tracks} == {"medium"}


def test_a_summary_is_given_at_confirmation_with_each_block_and_at_the_end():
    frames = recording(30, vehicles=1)

    _, outputs = fold_records([*records(frames), *ticks(frames[-1].time_us, 4)])

    given_at = [i for i, out in enumerate(outputs, start=1) if out.rows.tracks]
    assert given_at == [2, 21, 31, 32]
    assert [row.ended for out in outputs for row in out.rows.tracks] == [False, False, False, True]


def test_a_standing_vehicle_that_jitters_travels_nowhere():
    jitter = np.random.default_rng(1).normal(0.0, 0.1, 200)
    frames = [
        frame(i + 1, START_US + i * PERIOD_US, vehicles=0)
        for i in range(200)
    ]  # fmt: skip
    standing = [
        type(f)(
            f.sensor_id,
            f.time_us,
            f.sequence,
            None,
            *(np.array([v], dtype=np.float32) for v in (50 + j, 0, 0, 20)),
        )
        for f, j in zip(frames, jitter, strict=True)
    ]

    _, outputs = fold_records([*records(standing), *ticks(standing[-1].time_us, 5)])

    assert all_rows(outputs).tracks[0].distance_m < 1.0


def test_ticks_of_the_host_and_ticks_of_the_fold_give_one_history():
    before = recording(30)
    last_us = before[-1].time_us
    after = recording(30, first=31, start_us=last_us + 3 * SECOND_US + 200_000)

    _, live = fold_records(
        [*records(before), *ticks(last_us, 3), *records(after), *ticks(after[-1].time_us, 4)]
    )
    _, offline = fold_records(
        [*records(before), *records(after), TickRecord(after[-1].time_us + 60 * SECOND_US)]
    )

    assert history(live) == history(offline)
    assert all_rows(live) == all_rows(offline)


def test_ticks_end_when_nothing_is_left():
    frames = recording(30)
    state, outputs = fold_records([*records(frames), TickRecord(frames[-1].time_us + 3600 * SECOND_US)])

    assert state.quiet
    assert not state.wants_ticks
    assert len(outputs[-1].folded) == 2


def test_time_jumps_after_the_longest_silence_that_is_ticked_through():
    frames = recording(30)

    def never_forget(state, time_us, parameters) -> tuple:
        kept, estimates, report = simple_tracker.coast(state, time_us, parameters)
        return (kept, estimates, report) if kept.number.size else (state, estimates, report)

    patient = SimpleNamespace(
        initial_state=simple_tracker.initial_state, step=simple_tracker.step, coast=never_forget
    )
    log = [*records(frames), TickRecord(frames[-1].time_us + 10**12)]

    state, outputs = fold_records(log, tracker=patient)

    assert len(outputs[-1].folded) == MAX_TICKS
    assert not state.wants_ticks


def test_a_tick_flushes_the_frame_that_waits_for_a_missing_one():
    frames = recording(5)
    _, outputs = fold_records([*records([*frames[:3], frames[4]]), TickRecord(frames[4].time_us + SECOND_US)])

    assert outputs[3].fate == Fate.HELD
    assert outputs[4].fate == Fate.TICK
    assert [item.number for item in outputs[4].frames] == [5]
    assert outputs[4].missing == 1


def test_a_frame_behind_a_folded_tick_is_late():
    frames = recording(30)
    tick_us = frames[-1].time_us + SECOND_US

    _, outputs = fold_records([*records(frames), TickRecord(tick_us), *records([frame(31, tick_us - 1)])])

    assert outputs[-1].fate == Fate.LATE


def test_a_control_record_takes_effect_between_two_frames():
    changed = CONFIG.model_copy(update={"filter": "ekf"})
    state, outputs = fold_records([*records(recording(3)), ControlRecord(changed.canonical_json(), 0)])

    assert outputs[-1].fate == Fate.CONTROL
    assert state.parameters.filter == "ekf"
    assert state.config == changed.canonical_json()


@pytest.mark.parametrize("config", ["{", '{"rate_hz": -1}', '{"parameters": {"nonsense": "1"}}'])
def test_a_wrong_configuration_is_refused_by_an_event(config):
    state, outputs = fold_records([*records(recording(3)), ControlRecord(config, 17)])

    (event,) = outputs[-1].rows.events
    assert (event.kind, event.number, event.time_us) == (CONFIGURATION_REFUSED, 1, 17)
    assert state.config == CONFIG.canonical_json()


def test_a_clock_set_back_ends_every_track_and_begins_an_epoch():
    behind = recording(10, first=31, start_us=START_US - 10**9)

    state, outputs = fold_records(records([*recording(30), *behind]))

    assert [out.restarted for out in outputs if out.restarted] == [CLOCK_SET_BACK]
    assert (state.epoch, state.epoch_first_position) == (2, 33)
    rows = all_rows(outputs)
    assert [(row.key.epoch, row.key.number, row.ended) for row in rows.tracks] == [
        (1, 1, True),
        (1, 2, True),
        (2, 1, False),
        (2, 2, False),
    ]


def test_a_step_sums_a_track_up_only_once():
    # Frame 40 waits for 39 while a block closes and the track ends: both happen in the step of the tick.
    frames = recording(60, vehicles=1)
    log = [*records([*frames[:18], frames[39]]), TickRecord(frames[39].time_us + 30 * SECOND_US)]

    _, outputs = fold_records(log)

    for out in outputs:
        keys = [row.key for row in out.rows.tracks]
        assert len(keys) == len(set(keys))
    assert all_rows(outputs).tracks[0].ended


@st.composite
def disturbed(draw: st.DrawFn):
    """A recording with lost frames and pauses, and the same one delayed inside the window, with repeats."""
    count = draw(st.integers(4, 40))
    pauses = draw(
        st.lists(
            st.sampled_from([0, 0, 0, 0, 0, 700_000, 1_000_000, 2_300_000]), min_size=count, max_size=count
        )
    )
    times = list(itertools.accumulate(pauses, lambda t, pause: t + PERIOD_US + pause, initial=START_US))
    lost = draw(st.sets(st.integers(2, count), max_size=4))
    frames = [frame(n, times[n], vehicles=1 + n % 2) for n in range(1, count + 1) if n not in lost]
    arrival = [(frames[0], 0)]
    waiting = [(item, 0) for item in frames[1:]]
    while waiting:
        # A frame may be overtaken by at most two others, as the window allows.
        overdue = next((i for i, (_, passed) in enumerate(waiting) if passed == 2), None)
        reach = min(2, len(waiting) - 1) if overdue is None else overdue
        pick = draw(st.integers(0, reach)) if overdue is None else overdue
        waiting = [(item, passed + (i < pick)) for i, (item, passed) in enumerate(waiting)]
        arrival.append(waiting.pop(pick))
        if draw(st.integers(0, 3)) == 0:
            arrival.append(arrival[draw(st.integers(0, len(arrival) - 1))])
    return frames, [item for item, _ in arrival]


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(disturbed())
def test_delays_inside_the_window_and_repeats_change_no_row(pair):
    frames, arrival = pair
    end = TickRecord(frames[-1].time_us + 60 * SECOND_US)

    _, straight = fold_records([*records(frames), end])
    _, shuffled = fold_records([*records(arrival), end])

    assert history(shuffled) == history(straight)
    assert all_rows(shuffled) == all_rows(straight)
    lost = sum(out.missing for out in straight)
    assert sum(out.missing for out in shuffled) == lost
    assert sum(out.fate == Fate.DUPLICATE for out in shuffled) == len(arrival) - len(frames)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(disturbed(), st.data())
def test_a_restored_snapshot_gives_the_same_remaining_outputs_to_the_bit(pair, data):
    _, arrival = pair
    log = [*records(arrival), TickRecord(max(f.time_us for f in arrival) + 60 * SECOND_US)]
    cut = data.draw(st.integers(0, len(log)))
    _, whole = fold_records(log)

    state, _ = fold_records(log[:cut])
    stored = fold_snapshot.dump(state)
    restored = fold_snapshot.load(stored, simple_tracker)
    final, rest = fold_records(log[cut:], restored)

    assert fold_snapshot.dump(restored) == stored
    assert history(rest) == history(whole[cut:])
    assert [out.rows for out in rest] == [out.rows for out in whole[cut:]]
    assert fold_snapshot.dump(final) == fold_snapshot.dump(fold_records(log)[0])


def test_a_damaged_or_foreign_fold_snapshot_is_refused():
    state, _ = fold_records(records(recording(5)))
    good = fold_snapshot.dump(state)

    for at in range(0, len(good), 7):
        changed = bytearray(good)
        changed[at] ^= 0x55
        try:
            restored = fold_snapshot.load(bytes(changed), simple_tracker)
        except SnapshotUnreadable:
            continue
        pytest.fail(f"byte {at} changed unnoticed: {restored}")
    for keep in (0, 5, 20, len(good) - 1):
        with pytest.raises(SnapshotUnreadable):
            fold_snapshot.load(good[:keep], simple_tracker)


def test_a_fold_does_not_change_the_state_it_was_given():
    state, _ = fold_records(records(recording(10)))
    before = fold_snapshot.dump(state)

    step(state, 11, FrameRecord(frame(11, START_US + 10 * PERIOD_US), 0), simple_tracker)

    assert fold_snapshot.dump(state) == before


def test_an_epoch_may_start_in_the_middle_of_the_log():
    state = start("radar-1", 3, CONFIG, simple_tracker, first_position=500)

    _, outputs = fold_records(records(recording(5)), state)

    assert outputs[0].folded[0].position == 500
    assert {row.key.epoch for row in all_rows(outputs).tracks} == {3}
