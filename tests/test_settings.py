from pathlib import Path

import pytest
from pydantic import ValidationError

from service.settings import Settings


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """Run where no file `.env` and no variable of this machine has a say."""
    monkeypatch.chdir(tmp_path)
    for name in Settings.model_fields:
        monkeypatch.delenv(f"WAYSIDE_{name.upper()}", raising=False)


def test_the_rows_lie_in_the_data_directory_unless_an_address_is_set(monkeypatch):
    monkeypatch.setenv("WAYSIDE_DATA_DIR", "/srv/wayside")
    assert Settings().rows_url == "sqlite:////srv/wayside/rows.sqlite"
    assert Settings().log_dir == Path("/srv/wayside/log")

    monkeypatch.setenv("WAYSIDE_DATABASE_URL", "postgresql://db/wayside")
    assert Settings().rows_url == "postgresql://db/wayside"


def test_the_environment_goes_before_the_file(tmp_path, monkeypatch):
    (tmp_path / ".env").write_text("WAYSIDE_PORT=9000\nWAYSIDE_HOST=0.0.0.0\nOTHER=1\n")
    monkeypatch.setenv("WAYSIDE_PORT", "9001")

    assert (Settings().host, Settings().port) == ("0.0.0.0", 9001)  # noqa: S104 - read from the file


def test_sizes_have_units_and_retention_counts_days(monkeypatch):
    monkeypatch.setenv("WAYSIDE_LOG_LIMIT_BYTES", "500MB")

    assert Settings().log_limit_bytes == 500_000_000
    assert (Settings().states_days, Settings().tracks_days) == (7, 400)


@pytest.mark.parametrize(
    ("name", "value"),
    [("PORT", "70000"), ("STATES_DAYS", "0"), ("DISK_FREE_MIN_SHARE", "1.5"), ("LOG_LEVEL", "loud")],
)
def test_a_setting_out_of_bounds_is_refused(monkeypatch, name, value):
    monkeypatch.setenv(f"WAYSIDE_{name}", value)

    with pytest.raises(ValidationError, match=name.lower()):
        Settings()


@pytest.mark.parametrize(("processors", "trackers"), [(1, 0), (2, 2), (4, 4), (64, 4)])
def test_there_are_as_many_trackers_as_processors_up_to_four(monkeypatch, processors, trackers):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(processors)))

    assert Settings().tracker_process_count == trackers
    assert Settings(tracker_processes=7).tracker_process_count == 7
