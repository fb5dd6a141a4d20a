"""The thread that keeps the database: expired rows go, and the ages of what stays are told."""

from __future__ import annotations

import time
from pathlib import Path

from service.pipeline.health import HostHealth, StorageHealth, show
from service.pipeline.host import EmbeddedHost
from service.settings import Settings
from service.storage import migrate
from service.storage.audit import list_acts, note_act
from service.storage.database import connection as reading
from service.storage.database import open_database, session_scope
from service.telemetry import Telemetry
from tests.pipeline import simple_tracker

DAY_US = 86_400_000_000
NOW_US = 20_833 * DAY_US


def test_a_host_lets_old_acts_go_and_tells_the_age_of_the_oldest(tmp_path: Path):
    engine = open_database(f"sqlite:///{tmp_path}/rows.sqlite")
    migrate.upgrade(engine)
    with session_scope(engine) as writer:
        for days in (9, 2, 1):
            note_act(writer, actor="a", action="x", target=str(days), now_us=NOW_US - days * DAY_US)
    settings = Settings(data_dir=tmp_path, disk_free_min_share=0.0, audit_days=3)
    host = EmbeddedHost(engine, settings, tracker=simple_tracker, clock_us=lambda: NOW_US)

    host.start()
    deadline_s = time.monotonic() + 20
    while not host.health().storage.oldest_age_s and time.monotonic() < deadline_s:
        time.sleep(0.005)
    ages, text = host.health().storage.oldest_age_s, host.metrics().decode()
    host.stop()

    assert ages == {"acts": 2 * 86_400.0}
    assert 'wayside_rows_oldest_age_seconds{kind="acts"} 172800.0' in text
    assert 'wayside_rows_oldest_age_seconds{kind="tracks"} 0.0' in text
    with reading(engine) as reader:
        assert [act.target for act in list_acts(reader).items] == ["1", "2"]
    engine.dispose()


def test_the_age_of_a_kind_that_is_gone_does_not_stay_in_the_metrics():
    telemetry = Telemetry()
    for ages in ({"tracks": 5.0}, {}):
        show(HostHealth(True, True, None, StorageHealth(oldest_age_s=ages), ()), telemetry)
    assert b'wayside_rows_oldest_age_seconds{kind="tracks"} 0.0' in telemetry.text()
