from __future__ import annotations

import json

import pytest
import structlog

from service.telemetry import Telemetry, set_up_logging


@pytest.fixture(autouse=True)
def _logging_as_before():
    before = structlog.get_config()
    yield
    structlog.configure(**before)


def test_log_lines_are_json_objects_with_keys(capsys):
    set_up_logging("info", "json")

    structlog.get_logger("wayside").info("shard taken", shard=3)
    structlog.get_logger("wayside").debug("not said")

    line = json.loads(capsys.readouterr().err)
    assert (line["event"], line["shard"], line["level"]) == ("shard taken", 3, "info")
    assert line["timestamp"].endswith("Z")


def test_a_failure_is_logged_with_its_place_and_without_the_values_around_it(capsys):
    set_up_logging("error", "json")

    beside = "kept to itself"
    try:
        float("made up" if beside else "")
    except ValueError:
        structlog.get_logger("wayside").exception("sensor failed", sensor_id="radar-1")

    line = json.loads(capsys.readouterr().err)
    assert line["error"].startswith("ValueError: could not convert")
    assert line["where"][0].startswith("test_telemetry.py:")
    assert beside not in str(line)
    assert "Traceback" not in str(line)


def test_the_console_layout_is_readable(capsys):
    set_up_logging("warning", "console")

    structlog.get_logger("wayside").warning("log is nearly full", size_bytes=5)

    assert "log is nearly full" in capsys.readouterr().err


def test_each_host_has_metrics_of_its_own():
    one, other = Telemetry(), Telemetry()

    one.frames.labels("radar-1", "tracked").inc()

    assert b'wayside_frames_total{fate="tracked",sensor_id="radar-1"} 1.0' in one.text()
    assert b"wayside_frames_total{" not in other.text()
