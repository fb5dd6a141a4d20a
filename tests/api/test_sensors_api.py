from __future__ import annotations

import pytest

from service.api.sensors import merge
from tests.api.serving import problem

SITE = {"site_id": "north", "name": "North", "latitude_deg": 48.1, "longitude_deg": 11.5}


def test_a_site_is_made_read_changed_and_archived(service):
    made = service.post("/sites", json=SITE | {"time_zone": "Europe/Berlin"})
    assert (made.status_code, made.headers["location"]) == (201, "/api/v1/sites/north")
    assert service.get("/sites/north").json() == made.json()
    assert made.json() in service.get("/sites").json()["items"]

    changed = service.patch("/sites/north", json={"name": "Northern"}).json()
    assert (changed["name"], changed["time_zone"]) == ("Northern", "Europe/Berlin")

    problem(service.post("/sites", json=SITE), 409)
    assert service.delete("/sites/north").status_code == 204
    problem(service.get("/sites/north"), 404)


def test_a_wrong_site_is_named_field_by_field(service):
    reply = service.post("/sites", json=SITE | {"latitude_deg": 91, "time_zone": "Mars/Olympus", "x": 1})

    pointers = {error["pointer"] for error in problem(reply, 422)["errors"]}
    assert pointers == {"/latitude_deg", "/time_zone", "/x"}


def test_a_site_file_registers_a_sensor_as_it_is(service):
    body = {"scene": "curve", "kind": "one_way", "sensor_id": "from-file", "rate_hz": 10.0}
    made = service.post("/sensors", json=body)

    assert (made.status_code, made.json()["rate_hz"], made.json()["name"]) == (201, 10.0, "from-file")
    assert service.get("/sensors/from-file/live").json()["state"] == "waiting"
    assert service.delete("/sensors/from-file").status_code == 204
    problem(service.get("/sensors/from-file/live"), 404)
    problem(service.post("/sensors/from-file/frames", json={}), 404)
    problem(service.post("/sensors", json=body), 409)


def test_a_merge_patch_changes_only_what_it_names(service):
    service.post("/sensors", json={"sensor_id": "patched", "region": {"range_max_m": 120}})

    reply = service.patch(
        "/sensors/patched", json={"region": {"range_min_m": 12}, "parameters": {"existence.coast_s": "2.0"}}
    )

    assert reply.status_code == 200, reply.text
    assert reply.json()["region"] == {"range_min_m": 12, "range_max_m": 120, "azimuth_max_deg": 45}
    assert (reply.json()["revision"], service.host.config("patched").region.range_min_m) == (2, 12)
    fast = service.patch("/sensors/patched", json={"profile": "fast"}).json()
    assert (fast["profile"], service.host.config("patched").tracker_parameters().profile) == ("fast", "fast")
    removed = service.patch("/sensors/patched", json={"parameters": None, "name": None}).json()
    assert (removed["parameters"], removed["name"]) == ({}, "patched")


def test_a_sensor_that_the_tracker_cannot_work_with_is_refused(service):
    def pointer(**body):
        reply = service.post("/sensors", json={"sensor_id": "bad", **body})
        return problem(reply, 422)["errors"][0]["pointer"]

    assert pointer(filter="magic") == "/filter"
    assert pointer(profile="best") == "/profile"
    assert pointer(parameters={"no.such": "1"}).startswith("/parameters/")
    assert pointer(region={"azimuth_max_deg": 200}) == "/region/azimuth_max_deg"
    assert pointer(site_id="nowhere") == "/site_id"
    assert problem(service.patch("/sensors/radar-1", json={"sensor_id": "other"}), 422)
    problem(service.get("/sensors/bad"), 404)


def test_lists_come_in_pages_that_the_link_header_continues(service):
    for name in ("page-a", "page-b", "page-c"):
        service.post("/sites", json=SITE | {"site_id": name})
    seen, path = [], "/api/v1/sites?limit=1"
    while path:
        reply = service.client.get(path)
        seen += [site["site_id"] for site in reply.json()["items"]]
        path = reply.links["next"]["url"] if "next" in reply.links else None

    assert [name for name in seen if name.startswith("page-")] == ["page-a", "page-b", "page-c"]
    assert problem(service.get("/sites?cursor=xyz"), 422)["errors"][0]["pointer"] == "/cursor"


def test_merge_follows_the_examples_of_rfc_7396():
    assert merge({"a": "b", "c": {"d": "e", "f": "g"}}, {"a": "z", "c": {"f": None}}) == {
        "a": "z",
        "c": {"d": "e"},
    }
    assert merge({"a": [1]}, {"a": {"b": None, "c": 1}}) == {"a": {"c": 1}}


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        ([{"line_id": "a", "p0": [0, 50], "p1": [0, 50.1]}], "0.5 m at least"),
        ([{"line_id": "a", "p0": [0, 50], "p1": [9, 50]}] * 2, "'a' is there twice"),
    ],
)
def test_count_lines_without_length_or_with_one_name_twice_are_refused(service, lines, reason):
    reply = service.post("/sensors", json={"sensor_id": "lines", "count_lines": lines})

    assert reply.status_code == 422
    assert reason in reply.text
    assert service.get("/sensors/lines").status_code == 404
