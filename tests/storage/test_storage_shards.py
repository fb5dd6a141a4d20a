import pytest
from sqlalchemy import text

from service.errors import NotFound, StorageError
from service.storage.database import connection, session_scope
from service.storage.events import list_events, save_events
from service.storage.rows import EventRow, Rows
from service.storage.shards import Shard, Snapshot, begin_epoch, load_shard, save_flush, save_snapshot
from service.storage.tracks import TrackQuery, list_tracks

NOW_US = 1_800_000_000_000_000


@pytest.fixture
def write(engine):
    def run(function, *args, **kwargs):
        with session_scope(engine) as writer:
            return function(writer, *args, now_us=NOW_US, **kwargs)

    return run


@pytest.fixture
def load(engine):
    def run(sensor_id):
        with connection(engine) as reader:
            return load_shard(reader, sensor_id)

    return run


@pytest.fixture
def begin(write, sensor):
    def run(first_position=1, reason="lost log", time_us=7):
        return write(begin_epoch, sensor, first_position=first_position, reason=reason, time_us=time_us)

    return run


def events_of(engine, sensor, **filters):
    with connection(engine) as reader:
        return list_events(reader, sensor, **filters)


def event(number, time_us=0, as_of=1, **detail):
    return EventRow("radar-1", 1, number, as_of, "stopped", time_us, detail)


def test_a_sensor_starts_with_epoch_one_and_without_an_event(engine, sensor, load, begin):
    assert load(sensor) is None

    shard = begin(first_position=4)

    assert shard == Shard(sensor, epoch=1, epoch_first_position=4, cursor=3, snapshot=None)
    assert load(sensor) == shard
    assert events_of(engine, sensor).items == ()


def test_a_later_epoch_forgets_the_snapshot_and_tells_why(engine, sensor, write, load, begin):
    shard = write(save_flush, begin(), 50, Rows())
    write(save_snapshot, shard, Snapshot(40, b"state"))

    shard = begin(first_position=51, reason="unreadable snapshot", time_us=99)

    assert shard == load(sensor) == Shard(sensor, 2, 51, 50, None)
    (restart,) = events_of(engine, sensor).items
    assert (restart.kind, restart.epoch, restart.number, restart.time_us) == ("tracker_restarted", 2, 0, 99)
    assert restart.detail == {"reason": "unreadable snapshot"}


def test_rows_and_cursor_are_written_together_or_not_at_all(
    engine, sensor, write, load, begin, summary, block
):
    shard = begin()
    rows = Rows((block(),), (summary(),), (event(1),))

    def flush_then_fail():
        with session_scope(engine) as writer:
            save_flush(writer, shard, 20, rows, now_us=NOW_US)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        flush_then_fail()
    assert load(sensor) == shard
    assert events_of(engine, sensor).items == ()

    flushed = write(save_flush, shard, 20, rows)

    assert load(sensor) == flushed
    assert flushed.cursor == 20
    assert events_of(engine, sensor).items == rows.events
    with connection(engine) as reader:
        assert list_tracks(reader, TrackQuery(sensor)).items == rows.tracks


def test_folding_again_behind_the_cursor_changes_nothing(engine, sensor, write, load, begin, summary, block):
    rows = Rows((block(),), (summary(),), (event(1),))
    first = write(save_flush, begin(), 40, rows)

    again = write(save_flush, first, 20, rows)
    assert again == first == load(sensor)

    assert write(save_flush, again, 60, Rows()).cursor == 60


def test_a_host_that_was_superseded_writes_nothing(engine, sensor, write, load, begin, summary):
    old = begin()
    write(save_flush, old, 20, Rows())

    with pytest.raises(StorageError, match="superseded"):
        write(save_flush, old, 40, Rows(tracks=(summary(),)))
    newer = begin(first_position=21)
    with pytest.raises(StorageError, match="superseded"):
        write(save_flush, Shard(sensor, 1, 1, 20, None), 40, Rows(tracks=(summary(),)))
    with pytest.raises(StorageError, match="does not fit"):
        write(save_snapshot, old, Snapshot(1, b"old"))

    assert load(sensor) == newer
    with connection(engine) as reader:
        assert list_tracks(reader, TrackQuery(sensor)).items == ()


def test_a_snapshot_replaces_the_one_before(sensor, write, load, begin):
    shard = write(save_flush, begin(), 30, Rows())
    write(save_snapshot, shard, Snapshot(10, b"one"))
    write(save_snapshot, shard, Snapshot(30, b"\0two" * 100_000))

    assert load(sensor).snapshot == Snapshot(30, b"\0two" * 100_000)


def test_a_snapshot_ahead_of_the_stored_rows_is_refused(sensor, write, load, begin):
    shard = write(save_flush, begin(), 30, Rows())

    with pytest.raises(StorageError, match="31"):
        write(save_snapshot, shard, Snapshot(31, b"early"))

    assert load(sensor).snapshot is None


def test_an_unknown_sensor_has_no_shard(write, load):
    with pytest.raises(NotFound):
        load("radar-9")
    with pytest.raises(NotFound):
        write(begin_epoch, "radar-9", first_position=1, reason="", time_us=0)


def test_an_event_written_twice_stands_once_and_a_later_state_of_it_wins(engine, sensor, write):
    write(save_events, [event(1, as_of=5, phase="opened"), event(2, as_of=6)])
    write(save_events, [event(1, as_of=9, phase="closed")])
    write(save_events, [event(1, as_of=5, phase="opened"), event(2, as_of=6)])

    found = events_of(engine, sensor).items
    assert [(e.number, e.as_of, e.detail) for e in found] == [(1, 9, {"phase": "closed"}), (2, 6, {})]


def test_events_are_listed_by_time_window_and_page(engine, sensor, write):
    write(save_events, [event(n, time_us=10 * (n % 3)) for n in range(1, 10)])

    def numbers(**filters):
        return [e.number for e in events_of(engine, sensor, **filters).items]

    assert numbers() == [3, 6, 9, 1, 4, 7, 2, 5, 8]
    assert numbers(start_us=10, end_us=20) == [1, 4, 7]
    assert numbers(kind="stopped", limit=2) == [3, 6]
    assert numbers(kind="queue") == []
    first = events_of(engine, sensor, limit=4)
    assert numbers(cursor=first.next_cursor) == [4, 7, 2, 5, 8]


def test_the_cursor_and_the_snapshot_are_rows_of_their_own(engine, sensor, write, begin):
    shard = write(save_flush, begin(), 30, Rows())
    write(save_snapshot, shard, Snapshot(30, b"state"))

    with connection(engine) as reader:
        assert reader.scalar(text("SELECT cursor FROM shards")) == 30
        assert bytes(reader.scalar(text("SELECT state FROM snapshots"))) == b"state"
