"""`wayside doctor` on a simulated scene, and on a running service."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.api.serving import recording, serving


def test_a_sound_recording_has_nothing_wrong(run, scene: Path):
    result = run("doctor", scene / "frames.jsonl.gz", "--site", scene / "site.json", "--json")

    found = json.loads(result.stdout)
    assert found["findings"] == []
    assert found["measured"]["rate_hz"] == pytest.approx(20.0, rel=0.01)


def test_doppler_of_the_wrong_sign_is_named_with_an_advice(run, scene: Path, tmp_path: Path):
    site = json.loads((scene / "site.json").read_text()) | {"radial_velocity_positive": "approaching"}
    (tmp_path / "site.json").write_text(json.dumps(site))

    result = run("doctor", scene / "frames.jsonl.gz", "--site", tmp_path / "site.json", code=1)

    assert "doppler_sign: Points move against their Doppler" in result.output
    assert "Change radial_velocity_positive" in result.output
    assert "not told: the mounting" in result.output


def test_a_running_service_is_asked(run, tmp_path: Path):
    with serving(tmp_path / "data") as service:
        service.post("/sensors", json={"sensor_id": "radar-1", "rate_hz": 40})
        for frame in recording("radar-1", 120):
            service.post("/sensors/radar-1/frames", json=frame)

        result = run("doctor", "--sensor", "radar-1", "--url", service.url, code=1)

    assert "frame_rate: By their times 20.0 frames a second come" in result.output


def test_nothing_to_look_at_is_wrong_usage(run):
    assert "want recorded FRAMES, or --sensor" in run("doctor", code=2).output
