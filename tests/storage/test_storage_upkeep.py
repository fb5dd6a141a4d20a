import pytest
from sqlalchemy import event, inspect, text

from service.formats.sensor import SensorConfig
from service.storage import migrate, upkeep
from service.storage.audit import list_acts, note_act
from service.storage.counts import save_counts
from service.storage.database import connection, session_scope
from service.storage.events import save_events
from service.storage.lanes import list_lane_maps, save_lane_changes, save_lane_maps
from service.storage.oldest import KINDS, oldest_rows
from service.storage.rows import CellRow, CrossingBlock, EventRow, LaneChangeRow, LaneMapRow, TrackKey
from service.storage.sites import create_sensor
from service.storage.tables import metadata
from service.storage.tracks import save_blocks, save_summaries
from service.storage.upkeep import Expired, Retention, keep_up, partition_name
from service.traffic.records import Crossing, record_of

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


def lane_map(epoch, version, day):
    return LaneMapRow("radar-1", epoch, version, day * DAY_US, 400, 30, "learned", "[]")


@pytest.fixture
def maps(engine, sensor):
    """Store maps on the day that each speaks of, and return a function that tells which are left."""

    def write(*rows):
        for row in rows:
            with session_scope(engine) as writer:
                save_lane_maps(writer, [row], now_us=row.time_us)

        def left():
            with connection(engine) as reader:
                return [(row.epoch, row.version) for row in list_lane_maps(reader, "radar-1").items]

        return left

    return write


def crossing_block(epoch, map_version, minute):
    records = record_of(
        Crossing(
            line_id="C40", time_us=minute * 60_000_000 + 5, track=1, vehicle=1, frame=1, lane=2, direction=1,
            x_m=1.0, y_m=40.0, speed_mps=12.0, length_m=4.0, probability=0.9, number=1,
            map_version=map_version,
        )
    ).tobytes()  # fmt: skip
    return CrossingBlock("radar-1", epoch, "C40", minute, 0, 5, records)


def test_old_lane_maps_leave_but_the_one_in_force(engine, maps):
    left = maps(*(lane_map(1 + n // 3, 1 + n % 3, TODAY - 20 + n) for n in range(6)))

    assert keep_up(engine, Retention(lane_maps_days=18), now_us=TODAY * DAY_US) == Expired(lane_maps=2)
    assert left() == [(1, 3), (2, 1), (2, 2), (2, 3)]
    assert keep_up(engine, Retention(lane_maps_days=1), now_us=TODAY * DAY_US) == Expired(lane_maps=3)
    assert left() == [(2, 3)]


def test_old_lane_maps_stay_while_something_stored_names_them(engine, maps):
    left = maps(*(lane_map(1 + n // 4, 1 + n % 4, TODAY - 40 + n) for n in range(9)))
    minute = lambda n: (TODAY - 40 + n) * 1440 + 700  # noqa: E731
    with session_scope(engine) as writer:
        now_us = (TODAY - 20) * DAY_US
        # Of epoch 1 version 2 by a crossing, 3 by none of its own epoch, 4 by a sum, 1 by a change before it.
        blocks = [crossing_block(1, 2, minute(1)), crossing_block(2, 3, minute(6))]
        cells = [CellRow("radar-1", 1, minute(3), 4, 5, b"")]
        save_counts(writer, blocks, [], cells, now_us=now_us)
        time_us = minute(-3) * 60_000_000
        change = LaneChangeRow(TrackKey("radar-1", 1, 7), time_us, time_us, 1, 2, 1.7, 60.0, 14.0, 1)
        save_lane_changes(writer, [change], now_us=now_us)

    keep_up(engine, Retention(lane_maps_days=1), now_us=TODAY * DAY_US)
    assert left() == [(1, 1), (1, 2), (1, 4), (2, 3), (3, 1)]

    # Once what names them has expired they go too.
    keep_up(engine, Retention(lane_maps_days=1, counts_days=19), now_us=TODAY * DAY_US)
    assert left() == [(3, 1)]


def test_the_audit_log_expires_but_its_newest_entry(engine):
    with session_scope(engine) as writer:
        for n in range(5):
            note_act(writer, actor="a", action="key.created", target=str(n), now_us=(TODAY - 5 + n) * DAY_US)

    assert keep_up(engine, Retention(audit_days=2), now_us=TODAY * DAY_US).acts == 3
    assert keep_up(engine, Retention(audit_days=2), now_us=(TODAY + 1) * DAY_US).acts == 1
    with session_scope(engine) as writer:
        (last,) = list_acts(writer).items
        note_act(writer, actor="a", action="key.created", target="x", now_us=(TODAY + 90) * DAY_US)
        assert last.target == "4"
        assert list_acts(writer).items[0].number == last.number + 1


def test_the_oldest_row_of_each_kind_is_told(engine, store, block, summary, maps):
    with connection(engine) as reader:
        assert oldest_rows(reader) == {}

    live_s = TODAY * DAY_S + 4_000
    store(TODAY, block(1, live_s), block(2, live_s + 9))
    store(TODAY - 3, summary())  # of a recording from long ago
    maps(lane_map(1, 1, TODAY - 9))
    with session_scope(engine) as writer:
        note_act(writer, actor="a", action="key.created", target="x", now_us=77)
    with connection(engine) as reader:
        assert oldest_rows(reader) == {
            "track_states": live_s * 1_000_000,
            "tracks": (TODAY - 3) * DAY_US,
            "lane_maps": (TODAY - 9) * DAY_US,
            "acts": 77,
        }


def test_the_oldest_rows_are_found_in_indices(sqlite_engine):
    migrate.upgrade(sqlite_engine)
    asked = []
    event.listen(
        sqlite_engine,
        "before_cursor_execute",
        lambda _c, _cursor, statement, parameters, *_: asked.append((statement, parameters)),
    )
    with session_scope(sqlite_engine) as writer:  # one row of each kind, so that every question is asked
        create_sensor(writer, SensorConfig(sensor_id="radar-1"), now_us=0)
        for name in KINDS:
            table = metadata.tables[name]
            values = {
                c.name: 1 if c.type.python_type is int else "x" for c in table.columns if c.name != "id"
            }
            values |= {c.name: b"" for c in table.columns if c.type.python_type is bytes}
            values |= {c.name: 1.0 for c in table.columns if c.type.python_type is float}
            values |= {c.name: True for c in table.columns if c.type.python_type is bool}
            writer.execute(table.insert().values(values))
    asked.clear()
    with connection(sqlite_engine) as reader:
        assert set(oldest_rows(reader)) == set(KINDS)
        questions = [one for one in asked if one[0].startswith("SELECT")]
        plans = [
            str(row.detail)
            for statement, parameters in questions
            for row in reader.exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", parameters)
        ]

    tables = [name for name in KINDS if name not in {"acts", "lane_maps"}]  # of acts the first by its key
    scans = [plan for plan in plans if plan.startswith("SCAN") and plan.split()[1] in tables]
    assert len(questions) == 2 * len(KINDS) - 1
    # min() of an indexed column is a SEARCH, so nothing of these is scanned
    assert scans == []
