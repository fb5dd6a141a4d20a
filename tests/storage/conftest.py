"""Each test of the storage runs on SQLite and on PostgreSQL, on tables made by the migrations."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import Engine, create_engine, make_url, text
from sqlalchemy.exc import OperationalError

from service.formats.sensor import SensorConfig
from service.storage.database import open_database, session_scope
from service.storage.migrate import upgrade
from service.storage.rows import STATE_SAMPLE, StateBlock, TrackKey, TrackSummary
from service.storage.sites import create_sensor
from service.storage.tables import metadata

POSTGRES = os.environ.get("WAYSIDE_TEST_POSTGRES", "postgresql://postgres@127.0.0.1:5432/test")
NOW_US = 1_800_000_000_000_000  # when the rows of the tests are stored
START_S = 1_747_000_000  # when what they speak of happened


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def blank_url(request, tmp_path_factory) -> Iterator[str]:
    """Return the address of an empty database; on PostgreSQL a schema of its own."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path_factory.mktemp('rows') / 'rows.sqlite'}"
        return
    schema = f"wayside_test_{secrets.token_hex(6)}"
    admin = create_engine(make_url(POSTGRES).set(drivername="postgresql+psycopg"))
    try:
        with admin.begin() as connection:
            connection.execute(text(f"CREATE SCHEMA {schema}"))
    except OperationalError as error:
        if os.environ.get("CI") == "true":
            raise
        pytest.skip(f"no PostgreSQL at {POSTGRES}: {error.orig}")
    yield make_url(POSTGRES).update_query_dict({"options": f"-csearch_path={schema}"}).render_as_string(False)
    with admin.begin() as connection:
        connection.execute(text(f"DROP SCHEMA {schema} CASCADE"))
    admin.dispose()


@pytest.fixture(scope="module")
def migrated(blank_url: str) -> Iterator[Engine]:
    engine = open_database(blank_url)
    upgrade(engine)
    yield engine
    engine.dispose()


@pytest.fixture
def engine(migrated: Engine) -> Engine:
    """Return a migrated database without rows."""
    with session_scope(migrated) as connection:
        for table in reversed(metadata.sorted_tables):
            connection.execute(table.delete())
    return migrated


@pytest.fixture
def sensor(engine: Engine) -> str:
    """Return the id of a registered sensor."""
    with session_scope(engine) as connection:
        return create_sensor(connection, SensorConfig(sensor_id="radar-1"), now_us=NOW_US).sensor_id


@pytest.fixture
def sqlite_engine(tmp_path: Path) -> Iterator[Engine]:
    """Return an empty SQLite database, not migrated."""
    engine = open_database(f"sqlite:///{tmp_path / 'data' / 'rows.sqlite'}")
    yield engine
    engine.dispose()


@pytest.fixture
def block() -> Callable[..., StateBlock]:
    """Return a maker of state blocks: 20 samples, 50 ms apart, x counting up from the track's number."""

    def make(
        number: int = 1, second: int = START_S, *, epoch: int = 1, first_frame: int = 1, count: int = 20
    ):
        samples = np.zeros(count, STATE_SAMPLE)
        samples["x_m"] = number + np.arange(count) / 100
        samples["y_m"] = 100.25
        samples["std_x_m"] = 0.2
        samples["status"] = 1
        samples["frame_offset"] = np.arange(count)
        samples["time_offset_ms"] = np.arange(count) * 50
        return StateBlock(TrackKey("radar-1", epoch, number), second, first_frame, samples.tobytes())

    return make


@pytest.fixture
def summary() -> Callable[..., TrackSummary]:
    """Return a maker of track summaries: seen for two seconds from START_S + start_s on."""
    common = TrackSummary(
        key=TrackKey("radar-1", 1, 1),
        as_of=40,
        ended=False,
        first_time_us=0,
        last_time_us=0,
        first_frame=1,
        last_frame=40,
        states=40,
        hits=38,
        length_m=4.5,
        width_m=None,
        length_class="short",
        existence=0.999,
        first_x_m=1.0,
        first_y_m=150.0,
        last_x_m=1.5,
        last_y_m=120.0,
        distance_m=30.0,
        mean_speed_mps=15.0,
        max_speed_mps=16.5,
    )

    def make(number: int = 1, start_s: float = 0.0, *, life_s: float = 2.0, **changes):
        first_us = round((START_S + start_s) * 1_000_000)
        last_us = first_us + round(life_s * 1_000_000)
        key = TrackKey(changes.pop("sensor_id", "radar-1"), changes.pop("epoch", 1), number)
        return replace(common, **{"key": key, "first_time_us": first_us, "last_time_us": last_us} | changes)

    return make
