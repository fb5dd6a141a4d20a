from __future__ import annotations

import csv
import io
import json

import pytest

from service.api.schemas import Page
from service.api.track_schemas import StateReply, TrackReply
from service.formats.tracks import frame_line
from tests.api.serving import problem, recording, until


@pytest.fixture(scope="module")
def stored(service):
    """Four vehicles have driven past and their rows are stored; the lines as the tracker gave them."""
    service.post("/sensors", json={"sensor_id": "stored", "latitude_deg": 48.0, "longitude_deg": 11.0})
    lines = []
    publish = service.host.live.publish

    def note(entry):
        folded = entry.folded
        if entry.sensor_id == "stored" and folded is not None and folded.frame is not None:
            lines.append(frame_line("stored", entry.epoch, folded.number, folded.time_us, folded.estimates))
        publish(entry)

    service.host.live.publish = note
    sent = recording("stored", 60, vehicles=4)
    for frame in sent:  # one by one, so that every frame is published
        service.post("/sensors/stored/frames", json=frame)
    until(lambda: all(track["ended"] for track in tracks(service)) and len(tracks(service)) == 4)
    service.host.live.publish = publish
    return sent, lines


def tracks(service):
    return service.get("/tracks?sensor_id=stored").json()["items"]


def test_stored_tracks_are_read_by_time(service, stored):
    sent, _ = stored
    page = Page[TrackReply].model_validate(service.get("/tracks?sensor_id=stored").json())

    assert [track.track_id for track in page.items] == [f"stored-1-{n}" for n in (1, 2, 3, 4)]
    assert page.next is None
    assert all(track.mean_speed_mps == pytest.approx(10, abs=1) for track in page.items)
    start, end = sent[0]["timestamp"], sent[-1]["timestamp"]
    assert len(service.get("/tracks", params={"sensor_id": "stored", "start": end}).json()["items"]) == 4
    before = service.get("/tracks", params={"sensor_id": "stored", "end": start})
    assert before.json()["items"] == []  # half-open
    problem(service.get("/tracks", params={"start": end, "end": start}), 422)
    assert problem(service.get("/tracks?start=today"), 422)["errors"][0]["pointer"] == "/start"


def test_pages_of_tracks_neither_repeat_nor_leave_out(service, stored):
    seen, path = [], "/api/v1/tracks?sensor_id=stored&limit=3"
    while path:
        reply = service.client.get(path)
        seen += [track["track_id"] for track in reply.json()["items"]]
        path = reply.links["next"]["url"] if "next" in reply.links else None

    assert seen == [track["track_id"] for track in tracks(service)]


def test_exports_hold_the_same_tracks(service, stored):
    found = tracks(service)
    path = "/tracks?sensor_id=stored"

    ndjson = service.get(path, headers={"Accept": "application/x-ndjson"})
    rows = service.get(path + "&format=csv")
    geojson = service.get(path, headers={"Accept": "application/geo+json"})

    assert [json.loads(line) for line in ndjson.text.splitlines()] == found
    read = list(csv.DictReader(io.StringIO(rows.text, newline="")))
    assert [row["track_id"] for row in read] == [track["track_id"] for track in found]
    assert float(read[0]["mean_speed_mps"]) == found[0]["mean_speed_mps"]
    assert rows.headers["content-type"].startswith("text/csv")
    features = geojson.json()["features"]
    assert geojson.headers["content-type"] == "application/geo+json"
    assert features[0]["geometry"]["type"] == "LineString"
    assert features[0]["geometry"]["coordinates"][0][1] == pytest.approx(48.0003, abs=1e-4)
    empty = service.get("/tracks?sensor_id=radar-1&format=geojson").json()
    assert empty == {"type": "FeatureCollection", "features": []}


def test_what_cannot_be_exported_is_said(service, stored):
    problem(service.get("/tracks", headers={"Accept": "image/png"}), 406)
    assert problem(service.get("/tracks?format=csv&limit=3"), 422)["errors"][0]["pointer"] == "/limit"
    problem(service.get("/tracks?sensor_id=nobody&format=csv"), 404)
    problem(service.get("/sensors/nobody/states"), 404)


def test_one_track_and_its_path(service, stored):
    track = service.get("/tracks/stored-1-2").json()
    path = service.get("/tracks/stored-1-2", headers={"Accept": "application/geo+json"}).json()

    assert TrackReply.model_validate(track)
    assert len(path["geometry"]["coordinates"]) == track["states"] == len(path["properties"]["times"])
    for name in ("stored-1-99", "stored-1-x", "x", "nobody-1-1"):
        problem(service.get(f"/tracks/{name}"), 404)


def test_the_states_of_a_track_in_every_form(service, stored):
    path = "/tracks/stored-1-1/states"
    page = Page[StateReply].model_validate(service.get(path).json())
    rows = list(csv.DictReader(io.StringIO(service.get(path + "?format=csv").text, newline="")))
    lines = service.get(path, headers={"Accept": "application/x-ndjson"}).text.splitlines()
    geojson = service.get(path + "?format=geojson").json()

    states = [state.model_dump() for state in page.items]
    assert [state["frame"] for state in states] == sorted(state["frame"] for state in states)
    assert [json.loads(line) for line in lines] == states
    assert [float(row["y_m"]) for row in rows] == [state["y_m"] for state in states]
    assert len(geojson["geometry"]["coordinates"]) == len(states)
    first = service.get(path + "?limit=1").json()
    second = service.get(path + f"?limit=9000&cursor={first['next']}").json()
    assert first["items"] + second["items"] == states
    problem(service.get("/tracks/stored-1-99/states"), 404)


def test_the_states_of_a_window_are_the_lines_that_the_tracker_gave(service, stored):
    sent, lines = stored
    window = {"start": sent[10]["timestamp"], "end": sent[-1]["timestamp"]}

    reply = service.get("/sensors/stored/states", params=window)

    assert reply.headers["content-type"].startswith("application/x-ndjson")
    wanted = [line for line in lines if 11 <= json.loads(line)["frame"] < 60]
    assert len(wanted) > 40
    assert [line for line in reply.content.splitlines() if json.loads(line)["frame"] < 60] == wanted
    text = service.get("/sensors/stored/states", params=window | {"format": "csv"}).text
    rows = list(csv.DictReader(io.StringIO(text, newline="")))
    assert len(rows) >= 4 * len(wanted)
