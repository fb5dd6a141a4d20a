import sqlite3
import threading

import pytest
from sqlalchemy import text
from sqlalchemy.exc import IntegrityError, OperationalError

from service.errors import StorageError, Unavailable
from service.storage import database
from service.storage.database import connection, open_database, session_scope


@pytest.mark.parametrize(
    "url",
    ["nonsense", "mysql://localhost/rows", "oracle://localhost", "sqlite://", "sqlite:///:memory:"],
)
def test_an_address_that_cannot_hold_the_rows_is_refused(url):
    with pytest.raises(StorageError):
        open_database(url)


def test_a_folder_that_cannot_be_made_is_an_error_of_storage(tmp_path):
    (tmp_path / "file").touch()

    with pytest.raises(StorageError, match="file"):
        open_database(f"sqlite:///{tmp_path / 'file' / 'rows.sqlite'}")


def test_sqlite_writes_ahead_in_pages_of_the_chosen_size(sqlite_engine):
    with connection(sqlite_engine) as reader:
        found = {
            name: reader.exec_driver_sql(f"PRAGMA {name}").scalar()
            for name in ("journal_mode", "synchronous", "foreign_keys", "page_size")
        }

    assert found == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1, "page_size": 8192}


def test_a_few_readers_at_a_time_use_the_same_few_connections(sqlite_engine):
    at_once = [sqlite_engine.connect() for _ in range(5)]
    for one in at_once:
        one.close()

    used = set()
    for _ in range(10):
        with connection(sqlite_engine) as reader:
            used.add(id(reader.connection.driver_connection))

    assert len(used) == 1


def test_an_error_rolls_the_whole_transaction_back(engine, sensor):
    def rename_then_fail():
        with session_scope(engine) as writer:
            writer.execute(text("UPDATE sensors SET name = 'other'"))
            raise RuntimeError

    with pytest.raises(RuntimeError):
        rename_then_fail()

    with connection(engine) as reader:
        assert reader.scalar(text("SELECT name FROM sensors")) == sensor


def test_a_reading_connection_leaves_nothing_behind(sqlite_engine):
    with connection(sqlite_engine) as reader:
        reader.execute(text("CREATE TABLE t (a INTEGER)"))

    with connection(sqlite_engine) as reader:
        assert reader.scalar(text("SELECT count(*) FROM sqlite_master")) == 0


def test_a_reader_sees_one_state_while_a_writer_commits(engine, sensor):
    with connection(engine) as reader:
        before = reader.scalar(text("SELECT name FROM sensors"))
        with session_scope(engine) as writer:
            writer.execute(text("UPDATE sensors SET name = 'changed'"))
        during = reader.scalar(text("SELECT name FROM sensors"))
    with connection(engine) as reader:
        after = reader.scalar(text("SELECT name FROM sensors"))

    assert (before, during, after) == (sensor, sensor, "changed")


def test_foreign_keys_hold(engine, sensor):
    with pytest.raises(IntegrityError), session_scope(engine) as writer:
        writer.execute(text("UPDATE sensors SET site_id = 'nowhere'"))


def test_a_second_writer_waits_for_the_first(engine, sensor):
    seen = []

    def append(letter):
        with session_scope(engine) as writer:
            name = writer.scalar(text("SELECT name FROM sensors"))
            writer.execute(text("UPDATE sensors SET name = name || :letter"), {"letter": letter})
            seen.append(name)

    threads = [threading.Thread(target=append, args=(letter,)) for letter in "abcdef"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    with connection(engine) as reader:
        name = reader.scalar(text("SELECT name FROM sensors"))
    assert len(seen) == 6
    assert sorted(name.removeprefix(sensor)) == list("abcdef")


def test_a_database_locked_too_long_is_unavailable(sqlite_engine, monkeypatch):
    monkeypatch.setattr(database, "BUSY_TIMEOUT_S", 0.01)
    impatient = open_database(sqlite_engine.url.render_as_string())

    with session_scope(sqlite_engine), pytest.raises(Unavailable, match="locked"), session_scope(impatient):
        pass

    impatient.dispose()


def test_a_mistake_in_the_sql_is_not_taken_for_a_busy_database(sqlite_engine):
    with (
        pytest.raises(OperationalError, match="no such table") as caught,
        connection(sqlite_engine) as reader,
    ):
        reader.execute(text("SELECT * FROM missing"))

    assert isinstance(caught.value.orig, sqlite3.OperationalError)


def test_a_server_that_does_not_answer_is_unavailable():
    engine = open_database("postgresql://nobody@127.0.0.1:1/nothing")

    with pytest.raises(Unavailable), connection(engine):
        pass
