"""What the service tells of itself: stages, queues, ages, lag, and the diagnosis of a sensor."""

from __future__ import annotations

import re
import threading
from types import SimpleNamespace

import pytest

from tests.api.serving import problem, recording, serving, until
from tests.pipeline import simple_tracker


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    with serving(tmp_path_factory.mktemp("health")) as running:
        line = {"line_id": "C50", "p0": [-4, 50], "p1": [14, 50]}
        body = {"sensor_id": "radar-1", "rate_hz": 20, "count_lines": [line]}
        assert running.post("/sensors", json=body).status_code == 201
        for frame in recording("radar-1", 140):
            assert running.post("/sensors/radar-1/frames", json=frame).status_code == 202
        until(lambda: stage_counts(running).get("stored") == 140)
        yield running


def stage_counts(running) -> dict[str, int]:
    text = running.client.get("/metrics").text
    found = re.findall(r'wayside_stage_seconds_count\{stage="(\w+)"\} ([\d.]+)', text)
    return {stage: int(float(count)) for stage, count in found}


def test_every_frame_is_timed_at_each_stage(service):
    assert stage_counts(service) == {"logged": 140, "folded": 140, "readable": 140, "stored": 140}


def test_queues_ages_and_sizes_are_metrics(service):
    text = service.client.get("/metrics").text

    for name, label in (
        ("lag_seconds", True),
        ("unstored_frames", True),
        ("queue_records", True),
        ("frame_age_seconds", True),
        ("stored_age_seconds", True),
        ("log_bytes", False),
        ("log_files", False),
        ("log_oldest_age_seconds", False),
        ("log_waiting_records", False),
        ("rows_bytes", False),
        ("disk_free_ratio", False),
    ):
        line = f'wayside_{name}{{sensor_id="radar-1"}} ' if label else f"wayside_{name} "
        assert line in text
    assert 'wayside_frames_total{fate="tracked",sensor_id="radar-1"} 140.0' in text
    assert 'wayside_rows_oldest_age_seconds{kind="track_states"} ' in text


def test_the_health_tells_what_is_stored_and_since_when(service):
    health = service.client.get("/healthz").json()

    assert health["lag_s"] == 0.0
    assert health["storage"]["rows_bytes"] > 50_000
    assert health["storage"]["log_files"] == 1
    assert 0 <= health["storage"]["log_oldest_age_s"] < 120
    assert 0 < health["storage"]["disk_free_share"] < 1
    sensor = health["sensors"][0]
    assert (sensor["queue_depth"], sensor["lag_s"], sensor["unstored_frames"]) == (0, 0.0, 0)
    assert sensor["stored_age_s"] >= 0


def test_the_diagnosis_names_what_is_wrong(service):
    reply = service.get("/sensors/radar-1/diagnosis", params={"seconds": 60}).json()

    # Frames of the last seven seconds, posted at once; two vehicles of one point each, and no clutter at all.
    assert [finding["code"] for finding in reply["findings"]] == ["clock_skew", "too_few_points"]
    assert "behind" in reply["findings"][0]["sentence"]
    assert reply["measured"]["points_per_frame"] == 2.0
    assert reply["measured"]["rate_hz"] == pytest.approx(20.0)
    assert "the mounting" in reply["not_told"][-1]
    problem(service.get("/sensors/nobody/diagnosis"), 404)
    problem(service.get("/sensors/radar-1/diagnosis", params={"seconds": 1}), 422)


def test_a_service_that_lags_is_not_ready(tmp_path):
    gate = threading.Event()
    slow = SimpleNamespace(**{name: getattr(simple_tracker, name) for name in ("initial_state", "coast")})

    def step(*arguments):
        gate.wait(20)
        return simple_tracker.step(*arguments)

    slow.step = step
    with serving(tmp_path, tracker=slow) as running:
        running.post("/sensors", json={"sensor_id": "radar-1"})
        try:
            running.post("/sensors/radar-1/frames", json=recording("radar-1", 2)[0])
            assert running.client.get("/readyz").status_code == 200
            doorway = running.host._doorways["radar-1"]
            position, received_us, before = doorway.waiting[0]
            doorway.waiting[0] = position, received_us - 5_100_000, before

            reply = running.client.get("/readyz")

            assert reply.status_code == 503
            (lag,) = [check for check in reply.json()["checks"] if not check["ok"]]
            assert lag["name"] == "lag"
            assert "has waited 5." in lag["detail"]
            assert running.client.get("/healthz").json()["sensors"][0]["lag_s"] > 5
        finally:
            gate.set()
        until(lambda: running.client.get("/readyz").status_code == 200)
