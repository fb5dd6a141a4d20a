"""A recording is moved to now without a change of what was measured."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import pytest

from service.cli.recording import count_lines, look_through, read_recording
from service.errors import InvalidInput
from service.formats.rfc3339 import parse_time_us

NOW_US = parse_time_us("2026-01-01T12:00:00Z")
DETECTIONS = [{"range_m": 20.63, "azimuth_deg": 17.28}]


def frame(number: int, second: float) -> dict[str, object]:
    timestamp = f"2025-05-12T06:00:{second:06.3f}Z"
    return {"sensor_id": "radar-1", "timestamp": timestamp, "frame": number, "detections": DETECTIONS}


@pytest.fixture(params=["frames.jsonl", "frames.jsonl.gz"])
def path(request, tmp_path: Path) -> Path:
    text = "\n".join(json.dumps(frame(i, i * 0.5)) for i in range(21)) + "\n\n"
    path = tmp_path / request.param
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())
    return path


def test_a_recording_is_looked_through(path):
    recording = look_through([path])

    assert (recording.sensor_id, recording.frames, recording.duration_us) == ("radar-1", 21, 10_000_000)
    assert count_lines([path, path]) == 42


def test_at_the_pace_of_life_the_first_frame_happens_now(path):
    assert look_through([path]).shift_us(NOW_US, 1.0) == NOW_US - parse_time_us("2025-05-12T06:00:00Z")


@pytest.mark.parametrize("speed", [1.0, 2.0, 50.0, float("inf")])
def test_no_frame_is_sent_before_its_time(path, speed):
    recording = look_through([path])
    shift_us = recording.shift_us(NOW_US, speed)

    ahead_us = [
        frame.time_us + shift_us - (NOW_US + recording.due_s(frame.time_us, speed) * 1e6)
        for frame in read_recording([path])
    ]

    assert max(ahead_us) == pytest.approx(0.0, abs=1.0)  # microseconds are rounded once


def test_a_moved_frame_differs_in_time_and_boot_only(path):
    first = next(read_recording([path]))

    moved = first.moved(1_000_500, "replay-1")

    assert moved == frame(0, 0.0) | {"timestamp": "2025-05-12T06:00:01.000500Z", "boot_id": "replay-1"}


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"{", "line 2: is not JSON"),
        (b"[]", "line 2: want a frame"),
        (b'{"timestamp": "yesterday"}', "line 2: want RFC 3339"),
    ],
)
def test_a_damaged_line_is_named(tmp_path, line, reason):
    path = tmp_path / "frames.jsonl"
    path.write_bytes(json.dumps(frame(1, 0.0)).encode() + b"\n" + line)

    with pytest.raises(InvalidInput, match=reason):
        look_through([path])


def test_a_truncated_file_is_named(tmp_path):
    path = tmp_path / "frames.jsonl.gz"
    path.write_bytes(gzip.compress(json.dumps(frame(1, 0.0)).encode() * 100)[:-9])

    with pytest.raises(InvalidInput, match="damaged gzip data"):
        look_through([path])


def test_an_empty_recording_is_refused(tmp_path):
    path = tmp_path / "frames.jsonl"
    path.touch()

    with pytest.raises(InvalidInput, match="no frames"):
        look_through([path])
