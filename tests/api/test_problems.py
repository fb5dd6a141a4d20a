from __future__ import annotations

import pytest

from service.api.problems import KINDS
from service.errors import StorageError
from tests.api.serving import problem, recording, serving


def test_every_wrong_path_and_method_is_a_problem(service):
    problem(service.client.get("/nothing.html"), 404)
    problem(service.client.get("/../pyproject.toml"), 404)
    problem(service.client.post("/nothing"), 404)
    problem(service.get("/nothing"), 404)
    problem(service.get("/sensors/"), 404)
    reply = service.client.put("/api/v1/sensors")
    problem(reply, 405)
    assert reply.headers["allow"] == "GET, POST"
    problem(service.client.get("/api/v1/sensors/radar-1/frames"), 405)


def test_a_validation_error_points_into_the_body_or_names_the_parameter(service):
    assert problem(service.get("/tracks?limit=0"), 422)["errors"][0]["pointer"] == "/limit"
    body = {"sensor_id": "x", "count_lines": [{"line_id": "a", "p0": [0, 1], "p1": [0]}]}
    assert problem(service.post("/sensors", json=body), 422)["errors"][0]["pointer"] == "/count_lines/0/p1/1"
    broken = service.post("/sensors", content=b"{", headers={"Content-Type": "application/json"})
    assert problem(broken, 422)["errors"][0]["pointer"] == ""


def test_the_callers_request_or_trace_id_is_kept(service):
    trace = "4bf92f3577b34da6a3ce929d0e0e4736"
    given = service.client.get("/nothing", headers={"X-Request-ID": "abcdef-123"})
    traced = service.client.get("/nothing", headers={"traceparent": f"00-{trace}-00f067aa0ba902b7-01"})
    hostile = service.client.get("/nothing", headers={"X-Request-ID": "<script>"})

    assert problem(given, 404)["request_id"] == "abcdef-123"
    assert problem(traced, 404)["request_id"] == trace
    assert problem(hostile, 404)["request_id"] != "<script>"


def test_the_type_of_a_problem_leads_to_its_explanation(service):
    reply = service.client.get("/nothing")

    page = service.client.get(reply.json()["type"])

    assert page.status_code == 200
    assert KINDS["not-found"].explanation in page.text
    problem(service.client.get("/problems/none"), 404)


def test_an_unexpected_error_tells_its_request_id_and_nothing_else(tmp_path, capsys):
    with serving(tmp_path) as running:

        async def fail() -> None:
            raise StorageError("the secret place of the database")

        running.app.add_api_route("/fail", fail)
        reply = running.client.get("/fail")

    body = problem(reply, 500)
    assert "secret" not in reply.text
    assert "Traceback" not in reply.text
    out = "".join(capsys.readouterr())
    assert body["request_id"] in out
    assert "the secret place" in out


def test_a_service_that_cannot_take_frames_says_when_to_come_again(tmp_path):
    with serving(tmp_path) as running:
        running.post("/sensors", json={"sensor_id": "radar-1"})
    with serving(tmp_path, disk_free_min_share=0.999999) as running:
        reply = running.post("/sensors/radar-1/frames", json=recording("radar-1", 1)[0])
        new = running.post("/sensors", json={"sensor_id": "radar-2"})

        assert "disk" in problem(reply, 503)["detail"]
        assert int(reply.headers["retry-after"]) >= 1
        problem(new, 503)
        problem(
            running.post("/sensors", json={"sensor_id": "radar-2"}), 503
        )  # not 409: trying again is right


@pytest.mark.parametrize("path", ["/livez", "/nothing", "/api/v1/sensors", "/docs", "/"])
def test_no_reply_may_be_sniffed_or_tell_where_its_reader_came_from(service, path):
    headers = service.client.get(path).headers

    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "no-referrer"


def test_the_health_of_the_service(service):
    assert service.client.get("/livez").json() == {"status": "ok"}
    ready = service.client.get("/readyz")
    assert (ready.status_code, ready.json()["status"]) == (200, "ready")
    assert [check["name"] for check in ready.json()["checks"]] == [
        "host",
        "log",
        "tracker",
        "lag",
        "database",
    ]
    health = service.client.get("/healthz").json()
    assert health["status"] == "ok"
    assert health["sensors"][0]["sensor_id"] == "radar-1"
    text = service.client.get("/metrics").text
    assert 'wayside_http_requests_total{method="GET",route="/healthz",status="200"} 1.0' in text
    assert 'route="/api/v1/sensors",status="201"' in text
    assert 'wayside_queue_records{sensor_id="radar-1"} 0.0' in text


def test_a_stopped_host_is_not_ready(tmp_path):
    with serving(tmp_path) as running:
        running.host.stop()
        reply = running.client.get("/readyz")

        assert (reply.status_code, reply.json()["status"]) == (503, "not ready")
