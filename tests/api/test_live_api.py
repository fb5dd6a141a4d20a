from __future__ import annotations

import json
import time

import httpx
import pytest

from service.api import broadcast
from service.api.track_schemas import LiveView
from tests.api.serving import problem, recording, serving


@pytest.fixture(scope="module")
def seen(service):
    """Two vehicles have driven past the sensor."""
    place = {"latitude_deg": 48.137, "longitude_deg": 11.575}
    service.post("/sensors", json={"sensor_id": "watched", **place})
    sent = recording("watched")
    service.post("/sensors/watched/frames:batch", json=sent)
    after = 0
    while True:
        view = service.get(f"/sensors/watched/live?after={after}&wait=10").json()
        after = view["version"]
        if view["frame"] == sent[-1]["frame"]:
            return sent


def events(lines):
    """Yield the events of a stream as dictionaries; comments have the key "comment"."""
    event = {}
    for line in lines:
        if line == "":
            if event:
                yield event
            event = {}
        elif line.startswith(":"):
            yield {"comment": line[1:].strip()}
        else:
            name, _, value = line.partition(":")
            event[name] = value.strip()


def test_a_long_poll_ends_with_the_newest_tracks(service, seen):
    view = LiveView.model_validate(service.get("/sensors/watched/live").json())

    assert (view.frame, view.timestamp) == (40, seen[-1]["timestamp"][:23] + "Z")
    assert [track.track_id for track in view.tracks] == ["watched-1-1", "watched-1-2"]
    assert view.tracks[0].y_m == pytest.approx(seen[-1]["detections"][0]["y_m"], abs=0.5)
    assert view.tracks[0].latitude_deg == pytest.approx(48.1374, abs=2e-4)
    assert view.points is None


def test_points_are_given_in_the_plan_frame(service, seen):
    points = LiveView.model_validate(service.get("/sensors/watched/live?points=true").json()).points

    assert points.x_m[0] == pytest.approx(seen[-1]["detections"][0]["x_m"], rel=0.02)
    assert points.snr_db == [20.0, 20.0]


def test_an_unchanged_view_is_304(service, seen):
    first = service.get("/sensors/watched/live")
    tag = first.headers["etag"]

    again = service.get("/sensors/watched/live", headers={"If-None-Match": f'"other", {tag}'})
    points = service.get("/sensors/watched/live?points=1", headers={"If-None-Match": tag})

    assert tag.startswith('"')
    assert first.headers["cache-control"] == "no-cache"
    stale = first.json()["state"] != service.get("/sensors/watched/live").json()["state"]
    assert again.status_code == 304 or stale
    assert again.status_code != 304 or (again.content == b"" and again.headers["etag"] == tag)
    assert points.status_code == 200


def test_a_long_poll_without_news_ends_with_what_is_there(service):
    service.post("/sensors", json={"sensor_id": "quiet"})
    version = service.get("/sensors/quiet/live?after=0&wait=10").json()["version"]
    begun_s = time.monotonic()

    view = service.get(f"/sensors/quiet/live?after={version}&wait=0.2").json()

    assert view["version"] == version
    assert view["state"] == "waiting"
    assert time.monotonic() - begun_s >= 0.2


def test_waiting_longer_than_half_a_minute_is_refused(service):
    reply = service.get("/sensors/radar-1/live?after=1&wait=31")

    assert problem(reply, 422)["errors"][0]["pointer"] == "/wait"


def test_a_stream_begins_with_the_newest_view_and_goes_on_with_news(service):
    service.post("/sensors", json={"sensor_id": "streamed"})
    sent = recording("streamed", 12)
    service.post("/sensors/streamed/frames:batch", json=sent[:6])
    with service.client.stream("GET", "/api/v1/sensors/streamed/live/stream") as reply:
        stream = events(reply.iter_lines())
        assert next(stream) == {"retry": "1000"}
        first = next(stream)
        service.post("/sensors/streamed/frames:batch", json=sent[6:])
        ids = [int(first["id"])]
        while json.loads((event := next(stream))["data"])["frame"] != 12:
            ids.append(int(event["id"]))

    assert reply.headers["content-type"].startswith("text/event-stream")
    assert event["event"] == "live"
    assert LiveView.model_validate_json(event["data"])
    assert ids == sorted(ids)
    assert int(event["id"]) > ids[0]


def test_a_stream_resumed_at_the_newest_view_does_not_repeat_it(service):
    service.post("/sensors", json={"sensor_id": "resumed"})
    sent = recording("resumed", 8)
    service.post("/sensors/resumed/frames:batch", json=sent[:4])
    version = 0
    while (view := service.get(f"/sensors/resumed/live?after={version}&wait=10").json())["frame"] != 4:
        version = view["version"]
    headers = {"Last-Event-ID": str(view["version"])}
    with service.client.stream("GET", "/api/v1/sensors/resumed/live/stream", headers=headers) as reply:
        stream = events(reply.iter_lines())
        next(stream)
        service.post("/sensors/resumed/frames:batch", json=sent[4:])
        event = next(stream)

    assert int(event["id"]) > view["version"] or json.loads(event["data"])["state"] == "stale"


def test_a_silent_stream_is_kept_alive_by_comments(service, monkeypatch):
    monkeypatch.setattr(broadcast, "KEEP_ALIVE_S", 0.05)
    service.post("/sensors", json={"sensor_id": "silent"})
    service.get("/sensors/silent/live?after=0&wait=10")
    with service.client.stream("GET", "/api/v1/sensors/silent/live/stream") as reply:
        stream = events(reply.iter_lines())
        next(stream)
        assert next(stream)["event"] == "live"
        assert [next(stream), next(stream)] == [{"comment": "keep-alive"}] * 2


def test_a_stream_of_an_archived_sensor_ends(service):
    service.post("/sensors", json={"sensor_id": "leaving"})
    with service.client.stream("GET", "/api/v1/sensors/leaving/live/stream") as reply:
        stream = events(reply.iter_lines())
        next(stream)
        next(stream)
        service.delete("/sensors/leaving")
        rest = list(stream)

    assert rest[-1]["event"] == "end"


def test_an_unknown_sensor_has_no_view(service):
    problem(service.get("/sensors/nobody/live"), 404)
    problem(service.get("/sensors/nobody/live/stream"), 404)


def test_streams_and_long_polls_end_when_the_service_stops(tmp_path):
    with serving(tmp_path) as running:
        running.post("/sensors", json={"sensor_id": "radar-1"})
        reader = httpx.Client(base_url=running.url, timeout=20)
        stream = reader.stream("GET", "/api/v1/sensors/radar-1/live/stream")
        lines = stream.__enter__().iter_lines()
        assert next(lines) == "retry: 1000"
        begun_s = time.monotonic()

    assert list(lines)[-1] == ""
    assert time.monotonic() - begun_s < 8
    stream.__exit__(None, None, None)
    reader.close()
