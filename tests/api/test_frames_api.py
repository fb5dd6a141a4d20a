from __future__ import annotations

import gzip
import json

import pytest
import structlog
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.api import frames as frames_routes
from service.api.headers import header
from service.api.track_schemas import BatchReply, FrameReply
from tests.api.serving import problem, recording


@pytest.fixture(scope="module")
def frames(service):
    service.post("/sensors", json={"sensor_id": "intake"})
    return iter(recording("intake", 300))


def lines(frames):
    return b"".join(json.dumps(frame).encode() + b"\n" for frame in frames)


def test_a_frame_is_accepted_once_then_a_duplicate_then_a_conflict(service, frames):
    frame = next(frames)
    path = "/sensors/intake/frames"

    first, again = service.post(path, json=frame), service.post(path, json=frame)
    other = service.post(path, json=frame | {"detections": []})

    assert (first.status_code, first.json()) == (202, {"status": "accepted", "frame": frame["frame"]})
    assert (again.status_code, again.json()["status"]) == (200, "duplicate")
    assert FrameReply.model_validate(again.json())
    problem(other, 409)


def test_a_compressed_frame_is_the_same_frame(service, frames):
    frame = next(frames)
    body = gzip.compress(json.dumps(frame).encode())

    sent = service.post("/sensors/intake/frames", content=body, headers={"Content-Encoding": "gzip"})
    again = service.post("/sensors/intake/frames", json=frame)

    assert (sent.status_code, again.json()["status"]) == (202, "duplicate")


@pytest.mark.parametrize("form", ["array", "ndjson", "gzip"])
def test_a_batch_says_what_became_of_each_frame(service, frames, form):
    good, second = next(frames), next(frames)
    batch = [good, good, second | {"detections": [{"range_m": -1, "azimuth_deg": 0}]}, second, "no frame"]
    if form == "array":
        reply = service.post("/sensors/intake/frames:batch", json=batch)
    else:
        headers = {"Content-Type": "application/x-ndjson"}
        content = lines(batch)
        if form == "gzip":
            content, headers = gzip.compress(content), headers | {"Content-Encoding": "gzip"}
        reply = service.post("/sensors/intake/frames:batch", content=content, headers=headers)

    body = BatchReply.model_validate(reply.json())
    assert reply.status_code == 202
    assert [item.status for item in body.results] == [
        "accepted",
        "duplicate",
        "rejected",
        "accepted",
        "rejected",
    ]
    assert [item.index for item in body.results] == [0, 1, 2, 3, 4]
    assert (body.accepted, body.duplicate, body.rejected) == (2, 1, 2)
    assert body.results[2].errors[0].pointer == "/2/detections/0/range_m"
    assert "want an object" in body.results[4].detail


def test_a_late_frame_is_taken_and_flagged(service):
    service.post("/sensors", json={"sensor_id": "late"})
    sent = recording("late", 30)
    service.post("/sensors/late/frames:batch", json=[*sent[:5], *sent[6:]])

    reply = service.post("/sensors/late/frames", json=sent[5])

    assert (reply.status_code, reply.json()["status"]) == (202, "late")


def test_a_frame_from_the_future_is_refused(service):
    frame = recording("radar-1", 1)[0] | {"timestamp": "2999-01-01T00:00:00Z"}

    assert (
        problem(service.post("/sensors/radar-1/frames", json=frame), 422)["errors"][0]["pointer"]
        == "/timestamp"
    )


def test_booleans_are_no_numbers_in_a_batch_either(service):
    frames = recording("intake", 3)
    frames[1]["detections"] = {"range_m": [1.0, True], "azimuth_deg": [0, 0], "snr_db": [1, 1]}
    for body in (json.dumps(frames), "\n".join(map(json.dumps, frames))):
        kind = "application/json" if body.startswith("[") else "application/x-ndjson"
        reply = service.post(
            "/sensors/intake/frames:batch", content=body, headers={"Content-Type": kind}
        ).json()
        assert [result["status"] == "rejected" for result in reply["results"]] == [False, True, False]
        assert reply["results"][1]["errors"][0]["pointer"] == "/1/detections/range_m/1"


def test_an_unexpected_error_on_the_short_way_is_a_problem_as_elsewhere(service, monkeypatch):
    async def fail(*_):
        raise RuntimeError("the secret place of the log")

    monkeypatch.setattr(frames_routes, "post_frame", fail)
    with structlog.testing.capture_logs() as lines:
        reply = service.post("/sensors/intake/frames", json={})

    body = problem(reply, 500)
    assert "secret" not in reply.text
    assert [line["event"] for line in lines] == ["request failed"]
    assert reply.headers["x-content-type-options"] == "nosniff"
    assert reply.headers["x-request-id"] == body["request_id"]
    text = service.client.get("/metrics").text
    route = "/api/v1/sensors/{sensor_id}/frames"
    assert f'wayside_http_requests_total{{method="POST",route="{route}",status="500"}} 1.0' in text


def test_strange_hosts_and_origins_are_refused_on_the_short_way_too(service):
    frame = recording("intake", 1)[0]
    problem(service.post("/sensors/intake/frames", json=frame, headers={"Host": "evil.example"}), 421)
    problem(
        service.post("/sensors/intake/frames", json=frame, headers={"Origin": "http://evil.example"}), 403
    )


def test_of_a_field_that_comes_twice_the_first_counts():
    scope = {"headers": [(b"host", b"one"), (b"origin", b"\xe9"), (b"host", b"two")]}

    assert header(scope, b"host") == "one"
    assert header(scope, b"origin") == "\xe9"
    assert header(scope, b"cookie") is None


def test_wrong_bodies_are_problems_with_pointers(service):
    path = "/sensors/intake/frames"
    frame = recording("intake", 1)[0]

    wrong = problem(
        service.post(path, json=frame | {"detections": [{"range_m": 1, "azimuth_deg": 181}]}), 422
    )
    assert wrong["errors"][0]["pointer"] == "/detections/0/azimuth_deg"
    assert wrong["instance"] == "/api/v1/sensors/intake/frames"
    assert problem(service.post(path, json=frame | {"sensor_id": "radar-1"}), 422)
    assert problem(service.post(path, content=b"{"), 422)
    assert problem(service.post(path + ":batch", json={}), 422)
    assert problem(service.post(path, content=b"x", headers={"Content-Type": "text/csv"}), 415)
    assert problem(service.post(path, content=b"x", headers={"Content-Encoding": "br"}), 415)
    assert problem(service.post("/sensors/nobody/frames", json=frame), 404)
    assert problem(service.post("/sensors/no%20body/frames", json=frame), 422)


def test_a_body_above_the_limit_is_413_also_when_only_inflated(service):
    limit = 16 * 2**20
    bomb = gzip.compress(bytes(limit + 1))

    headers = {"Content-Encoding": "gzip"}
    assert problem(service.post("/sensors/intake/frames", content=bomb, headers=headers), 413)


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.one_of(st.binary(max_size=40), st.text(max_size=20).map(lambda text: json.dumps([text]).encode())))
def test_hostile_bodies_are_the_clients_fault(service, body):
    for path in ("/sensors/radar-1/frames", "/sensors/radar-1/frames:batch"):
        assert service.post(path, content=body).status_code in {202, 422}
