from __future__ import annotations

import dataclasses

import pytest

from service.pipeline.order import CLOCK_STEP_US, RECENT_KEYS, Fate, OrderState, admit, flush
from tests.pipeline.recordings import PERIOD_US, START_US, frame, recording


def admit_all(frames, state=None):
    state = state or OrderState()
    admissions = []
    for item in frames:
        state, admission = admit(state, item)
        admissions.append(admission)
    return state, admissions


def fates(admissions) -> list[str]:
    return [admission.fate.value for admission in admissions]


def numbers(admissions) -> list[int]:
    return [released.number for admission in admissions for released in admission.released]


def numbered(*sequence: int, start_us: int = START_US) -> list:
    return [frame(n, start_us + n * PERIOD_US) for n in sequence]


def test_frames_in_order_are_released_at_once():
    _, admissions = admit_all(recording(5))

    assert fates(admissions) == ["tracked"] * 5
    assert numbers(admissions) == [1, 2, 3, 4, 5]


def test_a_swapped_pair_is_put_right_without_a_gap():
    _, admissions = admit_all(numbered(1, 3, 2, 4))

    assert fates(admissions) == ["tracked", "held", "tracked", "tracked"]
    assert numbers(admissions) == [1, 2, 3, 4]
    assert sum(admission.missing for admission in admissions) == 0


def test_a_gap_is_counted_after_two_further_frames():
    _, admissions = admit_all(numbered(1, 4, 5, 6))

    assert fates(admissions) == ["tracked", "held", "held", "tracked"]
    assert numbers(admissions) == [1, 4, 5, 6]
    assert [admission.missing for admission in admissions] == [0, 0, 0, 2]


def test_a_second_gap_behind_the_first_still_waits_its_turn():
    state, admissions = admit_all(numbered(1, 3, 5, 6))

    assert numbers(admissions) == [1, 3]
    assert [item.sequence for item in state.held] == [5, 6]


def test_a_frame_after_its_gap_was_counted_is_late():
    _, admissions = admit_all(numbered(1, 3, 4, 5, 2))

    assert admissions[-1].fate == Fate.LATE
    assert numbers(admissions) == [1, 3, 4, 5]


def test_a_flush_releases_what_is_held():
    state, _ = admit_all(numbered(1, 3))

    state, admission = flush(state)

    assert [released.number for released in admission.released] == [3]
    assert admission.missing == 1
    assert not state.held


@pytest.mark.parametrize("again", [0, 1, 4], ids=["oldest", "second", "newest"])
def test_the_same_frame_again_is_a_duplicate(again):
    frames = recording(5)
    state, _ = admit_all(frames)

    unchanged, admission = admit(state, frames[again])

    assert admission.fate == Fate.DUPLICATE
    assert unchanged is state


def test_a_held_frame_again_is_a_duplicate():
    _, admissions = admit_all(numbered(1, 3, 3))

    assert fates(admissions) == ["tracked", "held", "duplicate"]


@pytest.mark.parametrize("again", [0, 1])
def test_another_frame_under_the_same_key_is_a_conflict(again):
    frames = recording(2)
    state, _ = admit_all(frames)
    other = dataclasses.replace(frames[again], snr_db=frames[again].snr_db + 1)

    _, admission = admit(state, other)

    assert admission.fate == Fate.CONFLICT
    assert not admission.released


def test_keys_are_forgotten_after_a_bounded_number_of_frames():
    frames = recording(RECENT_KEYS + 2)
    state, _ = admit_all(frames)

    assert len(state.recent.key) == RECENT_KEYS
    assert admit(state, frames[0])[1].fate == Fate.LATE
    assert admit(state, frames[2])[1].fate == Fate.DUPLICATE


def test_numbers_that_go_back_while_time_goes_on_open_a_new_boot():
    before = recording(5, first=100)
    after = recording(3, first=1, start_us=START_US + 10 * PERIOD_US)

    _, admissions = admit_all(before + after)

    assert fates(admissions) == ["tracked"] * 8
    assert [released.boot for admission in admissions for released in admission.released] == [0] * 5 + [1] * 3


def test_frame_numbers_rise_through_reboots_and_wraps():
    before = recording(3, first=65_533)
    after = recording(3, first=0, start_us=START_US + 3 * PERIOD_US)

    _, admissions = admit_all(before + after)

    assert numbers(admissions) == [65_533, 65_534, 65_535, 65_536, 65_537, 65_538]


def test_a_repeat_of_a_number_with_another_time_is_a_conflict_and_no_reboot():
    state, _ = admit_all(recording(5))

    _, admission = admit(state, frame(5, START_US + 9 * PERIOD_US))

    assert admission.fate == Fate.CONFLICT


def test_a_batch_across_a_reboot_that_is_posted_again_is_all_duplicates():
    before = [frame(n, START_US + n * PERIOD_US) for n in (1, 2, 98, 99, 100)]
    after = [frame(n, START_US + (100 + n) * PERIOD_US) for n in (1, 2, 3)]
    state, _ = admit_all([*before, *after])

    again, admissions = admit_all([*before, *after], state)

    assert fates(admissions) == ["duplicate"] * 8
    assert again is state


def test_an_unknown_frame_from_before_a_reboot_is_late_and_another_content_a_conflict():
    state, _ = admit_all([*numbered(97, 98, 100), *numbered(1, 2, 3, start_us=START_US + 100 * PERIOD_US)])
    other = dataclasses.replace(frame(2, START_US + 102 * PERIOD_US), snr_db=frame(2, 0).snr_db + 1)

    assert fates(admit_all([*numbered(99), other], state)[1]) == ["late", "conflict"]


def test_a_new_boot_id_opens_a_boot_and_a_former_one_is_late():
    first = [frame(n, START_US + n * PERIOD_US, boot_id="a") for n in (7, 8)]
    second = [frame(n, START_US + (n + 8) * PERIOD_US, boot_id="b") for n in (1, 2)]
    stray = frame(9, START_US + 20 * PERIOD_US, boot_id="a")

    state, admissions = admit_all([*first, *second, stray])

    assert fates(admissions) == ["tracked", "tracked", "tracked", "tracked", "late"]
    assert admit(state, first[0])[1].fate == Fate.DUPLICATE


def test_with_a_boot_id_numbers_that_go_back_are_late():
    frames = [frame(n, START_US + i * PERIOD_US, boot_id="a") for i, n in enumerate((300, 301, 1))]

    _, admissions = admit_all(frames)

    assert fates(admissions) == ["tracked", "tracked", "late"]


def test_a_new_boot_flushes_what_the_old_one_held():
    later = frame(1, START_US + 30 * PERIOD_US)

    _, admissions = admit_all([*numbered(1, 2, 4), later])

    assert numbers(admissions) == [1, 2, 4, 5]
    assert admissions[-1].missing == 1


def test_a_radar_that_counts_from_zero_keeps_its_numbers():
    _, admissions = admit_all(numbered(0, 1, 2))

    assert numbers(admissions) == [0, 1, 2]


def test_frames_without_numbers_go_by_their_time():
    first, second = frame(None, START_US), frame(None, START_US + PERIOD_US)

    _, admissions = admit_all([first, second, second, first, frame(None, START_US + 10)])

    assert fates(admissions) == ["tracked", "tracked", "duplicate", "duplicate", "late"]
    assert numbers(admissions) == [0, 1]


def test_a_rising_number_with_a_time_that_does_not_rise_is_late():
    _, admissions = admit_all([frame(1, START_US), frame(2, START_US), frame(3, START_US + 1)])

    assert fates(admissions) == ["tracked", "late", "held"]


def test_a_held_frame_that_turns_out_not_to_be_later_is_dropped():
    times = {1: 0, 3: 2, 2: 5, 4: 9}
    frames = [frame(n, START_US + after_us, boot_id="a") for n, after_us in times.items()]

    state, admissions = admit_all(frames)

    assert numbers(admissions) == [1, 2, 4]
    assert sum(admission.dropped for admission in admissions) == 1
    assert not state.held


def test_a_clock_that_was_set_back_restarts_after_three_frames():
    behind = recording(5, first=10, start_us=START_US - 2 * CLOCK_STEP_US)

    _, admissions = admit_all(recording(9) + behind)

    assert fates(admissions[9:]) == ["late", "late", "tracked", "tracked", "tracked"]
    assert [admission.clock_step for admission in admissions[9:]] == [False, False, True, False, False]


def test_one_frame_with_a_time_far_ahead_does_not_block_the_sensor_for_good():
    ahead = frame(6, START_US + 10**12)

    _, admissions = admit_all(
        [*recording(5), ahead, *recording(5, first=7, start_us=START_US + 6 * PERIOD_US)]
    )

    assert fates(admissions[6:]) == ["late", "late", "tracked", "tracked", "tracked"]
