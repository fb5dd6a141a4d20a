import pytest
from sqlalchemy import inspect, text

from service.storage import upkeep
from service.storage.database import connection, session_scope
from service.storage.events import save_events
from service.storage.rows import EventRow
from service.storage.tracks import save_blocks, save_summaries
from service.storage.upkeep import Expired, Retention, keep_up, partition_name

DAY_S = 86_400
DAY_US = DAY_S * 1_000_000
TODAY = 20_833
START_S = 1_747_000_000


@pytest.fixture
def store(engine, sensor):
    def write(day, *rows):
        with session_scope(engine) as writer:
            now_us = day * DAY_US + 5
            save_blocks(writer, [row for row in rows if hasattr(row, "samples")], now_us=now_us)
            save_summaries(writer, [row for row in rows if hasattr(row, "states")], now_us=now_us)
            save_events(writer, [row for row in rows if hasattr(row, "kind")], now_us=now_us)

    return write


on_postgresql = pytest.mark.parametrize("blank_url", ["postgresql"], indirect=True)


@pytest.fixture
def partitions(engine):
    """Return a function that names the days' partitions; drops them all in the end."""

    def names():
        return {name for name in inspect(engine).get_table_names() if name.startswith("track_states_2")}

    yield names
    with session_scope(engine) as writer:
        for name in names():
            writer.execute(text(f"DROP TABLE {name}"))


def count(engine, table):
    with connection(engine) as reader:
        return reader.scalar(text(f"SELECT count(*) FROM {table}"))  # noqa: S608 - names of ours


def test_rows_leave_after_their_days_counted_from_when_they_were_stored(engine, store, block, summary):
    for n in range(5):
        # what they speak of is long ago: a recording replayed today is as fresh as today's frames
        store(TODAY - n, block(n), summary(n), EventRow("radar-1", 1, n, 1, "x", 0, {}))

    expired = keep_up(
        engine, Retention(states_days=1, tracks_days=2, events_days=3), now_us=TODAY * DAY_US + 9
    )

    assert expired == Expired(state_blocks=3, tracks=2, events=1)
    assert [count(engine, name) for name in ("track_states", "tracks", "events")] == [2, 3, 4]
    again = keep_up(engine, Retention(states_days=1, tracks_days=2, events_days=3), now_us=TODAY * DAY_US + 9)
    assert again == Expired()


def test_a_day_is_deleted_in_small_transactions(engine, store, block, monkeypatch):
    monkeypatch.setattr(upkeep, "BATCH_ROWS", 3)
    store(TODAY - 8, *(block(n) for n in range(10)))
    store(TODAY, block(99))

    assert keep_up(engine, Retention(), now_us=TODAY * DAY_US).state_blocks == 10
    assert count(engine, "track_states") == 1


def test_a_row_written_again_keeps_its_day(engine, store, block, summary):
    store(TODAY - 8, block(), summary())
    store(TODAY, block(), summary(as_of=99))

    assert keep_up(engine, Retention(tracks_days=7), now_us=TODAY * DAY_US) == Expired(
        state_blocks=1, tracks=1
    )


@on_postgresql
def test_partitions_of_today_and_tomorrow_are_made_once(engine, partitions):
    for _ in range(2):
        keep_up(engine, Retention(), now_us=TODAY * DAY_US)

    assert partitions() == {partition_name(TODAY), partition_name(TODAY + 1)}
    assert partition_name(TODAY) == "track_states_20270115"


@on_postgresql
def test_states_go_into_the_partition_of_their_day_and_others_into_the_default(
    engine, store, block, partitions
):
    keep_up(engine, Retention(), now_us=TODAY * DAY_US)
    store(
        TODAY,
        block(1, TODAY * DAY_S),
        block(2, (TODAY + 1) * DAY_S - 1),
        block(3, (TODAY + 1) * DAY_S),
        block(4),
    )

    assert count(engine, partition_name(TODAY)) == 2
    assert count(engine, partition_name(TODAY + 1)) == 1
    assert count(engine, "track_states_default") == 1


@on_postgresql
def test_a_new_partition_takes_over_what_the_default_held(engine, store, block, partitions):
    store(TODAY, block(1, TODAY * DAY_S), block(2))

    keep_up(engine, Retention(), now_us=TODAY * DAY_US)
    store(TODAY, block(1, TODAY * DAY_S))  # still the same row

    assert count(engine, partition_name(TODAY)) == 1
    assert count(engine, "track_states_default") == 1


@on_postgresql
def test_a_past_partition_is_dropped_whole_unless_something_in_it_is_fresh(engine, store, block, partitions):
    keep_up(engine, Retention(), now_us=TODAY * DAY_US)
    store(TODAY, block(1, TODAY * DAY_S))
    store(TODAY + 9, block(2, (TODAY + 1) * DAY_S))  # a recording of that day, replayed nine days later

    expired = keep_up(engine, Retention(states_days=7), now_us=(TODAY + 10) * DAY_US)

    assert expired.partitions == 1
    assert partitions() == {partition_name(TODAY + n) for n in (1, 10, 11)}
    assert count(engine, "track_states") == 1
