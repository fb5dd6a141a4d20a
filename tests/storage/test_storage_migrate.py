import os
import subprocess
import sys
from pathlib import Path

import pytest
from sqlalchemy import inspect, text

from service.errors import StorageError
from service.storage import migrate
from service.storage.database import open_database, session_scope
from service.storage.tables import metadata

MIGRATE = """
import sys
from service.storage import migrate
from service.storage.database import open_database

engine = open_database(sys.argv[1])
print("ready", flush=True)
sys.stdin.readline()
migrate.upgrade(engine)
print(migrate.current(engine), flush=True)
"""


@pytest.fixture
def blank(blank_url):
    """Return a database without tables."""
    engine = open_database(blank_url)
    migrate.downgrade(engine, "base")
    yield engine
    engine.dispose()


def test_an_empty_database_goes_up_down_and_up_again(blank):
    assert migrate.current(blank) is None

    migrate.upgrade(blank)
    assert migrate.current(blank) == migrate.head()
    assert set(metadata.tables) <= set(inspect(blank).get_table_names())

    migrate.downgrade(blank, "base")
    assert migrate.current(blank) is None
    assert set(inspect(blank).get_table_names()) == {"alembic_version"}

    migrate.upgrade(blank)
    migrate.upgrade(blank)
    migrate.require_current(blank)


def test_the_migrations_lead_to_the_tables_of_the_code(blank):
    migrate.upgrade(blank)

    migrate.check(blank)
    for table in metadata.sorted_tables:  # what the comparison of Alembic leaves out
        found = inspect(blank).get_pk_constraint(table.name)["constrained_columns"]
        assert found == [column.name for column in table.primary_key]


def test_a_table_that_differs_from_the_code_is_found(blank):
    migrate.upgrade(blank)
    with session_scope(blank) as connection:
        connection.execute(text("ALTER TABLE tracks ADD COLUMN colour TEXT"))

    with pytest.raises(StorageError, match="colour"):
        migrate.check(blank)


def test_a_database_without_the_newest_schema_is_not_taken_for_current(blank):
    with pytest.raises(StorageError, match="run `wayside migrate`"):
        migrate.require_current(blank)
    with pytest.raises(StorageError, match="up to date"):
        migrate.check(blank)


def test_a_newer_schema_is_refused_and_left_alone(blank):
    migrate.upgrade(blank)
    with session_scope(blank) as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))

    for attempt in (migrate.upgrade, migrate.require_current, lambda e: migrate.downgrade(e, "base")):
        with pytest.raises(StorageError, match="9999"):
            attempt(blank)

    assert migrate.current(blank) == "9999"
    with session_scope(blank) as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = :head"), {"head": migrate.head()})


def test_a_migration_that_fails_changes_nothing(blank):
    with session_scope(blank) as connection:
        connection.execute(text("CREATE TABLE events (already INTEGER)"))  # made last by the first revision

    with pytest.raises(Exception, match="already exists"):
        migrate.upgrade(blank)

    assert migrate.current(blank) is None
    assert "tracks" not in inspect(blank).get_table_names()
    with session_scope(blank) as connection:
        connection.execute(text("DROP TABLE events"))


@pytest.mark.slow
def test_two_processes_may_migrate_at_once(blank, blank_url):
    if blank.dialect.name == "sqlite":  # from no file at all
        blank.dispose()
        for path in Path(blank.url.database).parent.iterdir():
            path.unlink()
    environment = os.environ | {"PYTHONPATH": str(Path(migrate.__file__).parents[2])}
    both = [
        subprocess.Popen(
            [sys.executable, "-c", MIGRATE, blank_url],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        for _ in range(2)
    ]
    assert [process.stdout.readline() for process in both] == ["ready\n", "ready\n"]
    for process in both:
        process.stdin.write("go\n")
        process.stdin.flush()

    assert [process.communicate(timeout=60)[0] for process in both] == [f"{migrate.head()}\n"] * 2
    assert [process.returncode for process in both] == [0, 0]
    migrate.check(blank)


def test_the_migrations_are_found_beside_the_package():
    assert (migrate.scripts_dir() / "versions").is_dir()
