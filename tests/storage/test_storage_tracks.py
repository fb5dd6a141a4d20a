from dataclasses import replace

import numpy as np
import pytest
from sqlalchemy import text

from service.errors import InvalidInput, NotFound
from service.formats.sensor import SensorConfig
from service.storage.database import connection, session_scope
from service.storage.rows import TrackKey
from service.storage.sites import archive_sensor, create_sensor
from service.storage.tracks import (
    TrackQuery,
    list_blocks,
    list_tracks,
    parse_track_id,
    read_track,
    save_blocks,
    save_summaries,
    stream_tracks,
)

NOW_US = 1_800_000_000_000_000
START_S = 1_747_000_000
START_US = START_S * 1_000_000


def table_dump(engine, name):
    with connection(engine) as reader:
        return sorted(map(tuple, reader.execute(text(f"SELECT * FROM {name}"))))  # noqa: S608 - names of ours


@pytest.fixture
def store(engine, sensor):
    """Return a function that stores summaries and blocks, each call in a transaction."""

    def write(*rows, now_us=NOW_US):
        with session_scope(engine) as writer:
            save_summaries(writer, [row for row in rows if hasattr(row, "as_of")], now_us=now_us)
            save_blocks(writer, [row for row in rows if hasattr(row, "samples")], now_us=now_us)

    return write


def found(engine, query=None, **paging):
    with connection(engine) as reader:
        return list_tracks(reader, query or TrackQuery(), **paging)


def numbers(page):
    return [track.key.number for track in page.items]


def test_rows_written_twice_stand_once(engine, store, block, summary):
    rows = [summary(n) for n in (1, 2)] + [block(n, START_S + s) for n in (1, 2) for s in (0, 1)]
    store(*rows)
    once = table_dump(engine, "tracks"), table_dump(engine, "track_states")

    store(*rows, now_us=NOW_US + 86_400_000_000)

    assert (table_dump(engine, "tracks"), table_dump(engine, "track_states")) == once
    assert (len(once[0]), len(once[1])) == (2, 4)


def test_a_summary_comes_back_as_it_was_written(engine, store, summary):
    written = summary(3, 0.5, ended=True, width_m=1.8, length_class=None, length_m=None)
    store(written)

    with connection(engine) as reader:
        assert read_track(reader, written.key) == written


def test_numbers_of_numpy_are_stored_as_numbers(engine, store, summary):
    written = summary(1)
    of_numpy = {
        name: np.int64(getattr(written, name))
        for name in ("first_time_us", "last_time_us", "states", "as_of")
    }
    store(replace(written, existence=np.float32(0.5), ended=np.True_, **of_numpy))

    (found_track,) = found(engine, TrackQuery(start_us=START_US)).items
    assert found_track == replace(written, existence=0.5, ended=True)


def test_the_summary_of_the_later_log_position_stays(engine, store, summary):
    early, late = summary(as_of=40, states=40), summary(as_of=60, states=60, ended=True)
    store(early)
    store(late)
    store(early)
    store(replace(late, states=99))  # the same position again

    with connection(engine) as reader:
        assert read_track(reader, late.key) == late


def test_several_summaries_of_one_track_in_one_flush_leave_the_latest(engine, store, summary):
    store(summary(as_of=60, states=60), summary(as_of=40, states=40), summary(as_of=80, states=80))

    assert found(engine).items[0].states == 80


def test_a_stored_block_is_left_as_it_is(engine, store, block, summary):
    store(summary(), block(count=20))
    store(replace(block(count=3), first_frame=77))

    with connection(engine) as reader:
        assert list_blocks(reader, TrackKey("radar-1", 1, 1)).items == (block(count=20),)


def test_tracks_are_those_seen_inside_the_half_open_window(engine, store, summary):
    store(summary(1, 0.0), summary(2, 2.0), summary(3, 4.0), summary(4, 0.5, life_s=100.0))

    def seen(start_s, end_s):
        window = TrackQuery("radar-1", START_US + round(start_s * 1e6), START_US + round(end_s * 1e6))
        return numbers(found(engine, window))

    assert seen(0, 100) == [1, 4, 2, 3]
    assert seen(0, 2) == [1, 4]  # 2 begins at the end of the window
    assert seen(2, 2.001) == [1, 4, 2]  # the last state of 1 is at the start of the window
    assert seen(2.001, 2.01) == [4, 2]
    assert seen(50, 60) == [4]
    assert seen(200, 300) == []


def test_tracks_are_listed_of_one_sensor_or_of_all(engine, store, summary):
    with session_scope(engine) as writer:
        create_sensor(writer, SensorConfig(sensor_id="radar-2"), now_us=NOW_US)
    store(summary(1, 1.0), summary(2, 0.0, sensor_id="radar-2"), summary(3, 1.0, sensor_id="radar-2"))

    assert numbers(found(engine)) == [2, 1, 3]
    assert numbers(found(engine, TrackQuery("radar-2"))) == [2, 3]
    with pytest.raises(NotFound):
        found(engine, TrackQuery("radar-3"))


def test_pages_neither_repeat_nor_miss_while_tracks_arrive_and_grow(engine, store, summary):
    store(*(summary(n, n % 5) for n in range(1, 31)))
    seen, cursor, fresh = [], None, 100
    while True:
        page = found(engine, cursor=cursor, limit=4)
        seen += numbers(page)
        cursor = page.next_cursor
        if cursor is None:
            break
        # one before the place that was reached, one after the end; and a track already seen goes on
        store(
            summary(fresh, -1.0),
            summary(fresh + 1, 50.0),
            summary(seen[-1], seen[-1] % 5, life_s=9, as_of=99),
        )
        fresh += 2

    first = sorted(range(1, 31), key=lambda n: (n % 5, n))
    assert seen[:30] == first
    assert len(seen) == len(set(seen))
    assert {n for n in seen if n >= 100} == set(range(101, fresh, 2))  # all that came later in the order


def test_the_last_page_says_so(engine, store, summary):
    store(*(summary(n, n) for n in range(4)))

    assert found(engine, limit=4).next_cursor is None
    assert found(engine, limit=3).next_cursor is not None
    assert numbers(found(engine, cursor=found(engine, limit=3).next_cursor)) == [3]


@pytest.mark.parametrize(
    "cursor",
    [
        "",
        "!",
        "äö",
        "e30",  # {}
        "W10",  # []
        "WzEsMiwzLDRd",  # four numbers
        "WzEsInJhZGFyLTEiLDEsdHJ1ZV0",  # a truth value for a number
        "WzEwMDAwMDAwMDAwMDAwMDAwMDAwMCwicmFkYXItMSIsMSwxXQ",  # a number beyond 64 bits
        "A" * 99,
    ],
)
def test_a_cursor_of_another_make_is_refused(engine, sensor, cursor):
    with pytest.raises(InvalidInput) as caught:
        found(engine, cursor=cursor)

    assert caught.value.errors[0].pointer == "/cursor"


@pytest.mark.parametrize("limit", [0, -1, 10_001])
def test_a_limit_out_of_bounds_is_refused(engine, sensor, limit):
    with pytest.raises(InvalidInput, match="limit"):
        found(engine, limit=limit)


def test_a_stream_gives_every_track_in_order(engine, store, summary, monkeypatch):
    monkeypatch.setattr("service.storage.tracks.STREAM_TRACKS", 3)
    store(*(summary(n, -n) for n in range(10)))

    assert [track.key.number for track in stream_tracks(engine, TrackQuery("radar-1"))] == list(
        range(9, -1, -1)
    )


def test_the_states_of_one_track_come_by_second_and_page(engine, store, block, summary):
    blocks = [block(1, START_S + s, first_frame=1 + 20 * s) for s in range(5)]
    store(summary(1, life_s=4.95), summary(2, life_s=4.95), *blocks, block(2), block(1, START_S + 2, epoch=2))
    key = TrackKey("radar-1", 1, 1)

    with connection(engine) as reader:
        assert list_blocks(reader, key).items == tuple(blocks)
        first = list_blocks(reader, key, limit=3)
        rest = list_blocks(reader, key, limit=3, cursor=first.next_cursor)
        with pytest.raises(NotFound, match="radar-1-2-1"):
            list_blocks(reader, TrackKey("radar-1", 2, 1))
    assert first.items + rest.items == tuple(blocks)
    assert rest.next_cursor is None


def test_tracks_of_an_archived_sensor_stay_readable(engine, store, summary):
    store(summary())
    with session_scope(engine) as writer:
        archive_sensor(writer, "radar-1", now_us=NOW_US)

    assert numbers(found(engine, TrackQuery("radar-1"))) == [1]


def test_rows_of_an_unknown_sensor_are_refused(engine, summary):
    with pytest.raises(NotFound), session_scope(engine) as writer:
        save_summaries(writer, [summary()], now_us=NOW_US)


def test_a_track_id_names_sensor_epoch_and_number():
    key = TrackKey("radar-1-b", 2, 31)

    assert parse_track_id(str(key)) == key


@pytest.mark.parametrize(
    "text", ["", "radar-1", "-1-1", "radar-1-x", "radar-1--1", "radar-01-1", "radar-1-²", "r-1-" + "9" * 30]
)
def test_a_text_that_is_no_track_id_names_no_track(text):
    with pytest.raises(NotFound):
        parse_track_id(text)
