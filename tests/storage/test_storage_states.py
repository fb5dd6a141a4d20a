import json
from dataclasses import replace

import numpy as np
import pytest

from service.errors import NotFound
from service.formats.tracks import stored_line
from service.storage.database import session_scope
from service.storage.rows import STATE_SAMPLE
from service.storage.states import stream_states
from service.storage.tracks import save_blocks

NOW_US = 1_800_000_000_000_000
START_S = 1_747_000_000
START_US = START_S * 1_000_000


@pytest.fixture
def store(engine, sensor):
    def write(*blocks):
        with session_scope(engine) as writer:
            save_blocks(writer, blocks, now_us=NOW_US)

    return write


def test_a_window_comes_frame_by_frame_with_all_its_tracks(engine, store, block):
    store(
        block(2, first_frame=1),
        block(1, first_frame=11, count=10),
        block(1, START_S + 1, first_frame=21, count=1),
    )
    shifted = np.frombuffer(block(1, first_frame=11, count=10).samples, STATE_SAMPLE).copy()
    shifted["time_offset_ms"] += 500
    store(replace(block(3, first_frame=11), samples=shifted.tobytes()))

    frames = list(stream_states(engine, "radar-1", START_US, START_US + 2_000_000))

    assert [frame.time_us for frame in frames] == sorted(frame.time_us for frame in frames)
    by_frame = {(f.frame, f.time_us - START_US): f.states.number.tolist() for f in frames}
    assert by_frame[(11, 500_000)] == [2, 3]
    assert by_frame[(11, 0)] == [1]  # another boot: the same number at another time is another frame
    assert by_frame[(1, 0)] == [2]
    assert by_frame[(21, 1_000_000)] == [1]
    assert sum(len(numbers) for numbers in by_frame.values()) == 20 + 10 + 10 + 1


def test_the_window_is_half_open_to_the_millisecond(engine, store, block):
    store(*(block(1, START_S + s, first_frame=1 + 20 * s) for s in range(3)))

    def frames(start_s, end_s):
        window = (START_US + round(start_s * 1e6), START_US + round(end_s * 1e6))
        return [frame.frame for frame in stream_states(engine, "radar-1", *window)]

    assert frames(0, 3) == list(range(1, 61))
    assert frames(0.05, 0.15) == [2, 3]
    assert frames(0.951, 1.001) == [21]
    assert frames(1.0, 1.0) == []
    assert frames(3, 4) == []


def test_empty_stretches_are_skipped(engine, store, block):
    store(block(1, START_S), block(2, START_S + 86_400))

    frames = list(stream_states(engine, "radar-1", 0, 4_000_000_000_000_000))

    assert len(frames) == 40
    assert {f.states.number[0] for f in frames} == {1, 2}


def test_epochs_of_one_moment_stay_apart(engine, store, block):
    store(block(1, epoch=1, count=1), block(1, epoch=2, count=1))

    frames = list(stream_states(engine, "radar-1", START_US, START_US + 1))

    assert [(f.epoch, f.states.number.tolist()) for f in frames] == [(1, [1]), (2, [1])]


def test_a_frame_makes_a_line_of_tracks_jsonl(engine, store, block):
    store(block(7, count=1))

    (frame,) = stream_states(engine, "radar-1", START_US, START_US + 1)
    line = json.loads(stored_line(frame.sensor_id, frame.epoch, frame.frame, frame.time_us, frame.states))

    assert line["frame"] == 1
    assert line["tracks"][0]["track_id"] == "radar-1-1-7"
    assert line["tracks"][0]["y_m"] == 100.25


def test_an_unknown_sensor_is_named_before_the_first_frame(engine):
    with pytest.raises(NotFound, match="radar-9"):
        stream_states(engine, "radar-9", 0, 1)
