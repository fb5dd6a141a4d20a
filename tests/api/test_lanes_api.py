from __future__ import annotations

import json

import pytest

from service.api.lane_schemas import LaneChangeReply, LaneMapReply, LaneVersionReply
from service.api.schemas import Page
from tests.api.serving import problem, recording, until

PLACE = {"latitude_deg": 52.0, "longitude_deg": 8.0, "heading_deg": 90.0}
# Two lanes that slant to the left of a vehicle which drives straight on at x = 4 m, from one into the other.
SLANTED = [
    {"index": 1, "points_m": [[4.0, 25.0], [0.5, 135.0]], "width_m": 3.5},
    {"index": 2, "points_m": [[7.5, 25.0], [4.0, 135.0]], "width_m": 3.5},
]


@pytest.fixture(scope="module")
def road(service):
    """A sensor with drawn lanes, and frames of a vehicle that changes between them."""
    service.post("/sensors", json={"sensor_id": "road", **PLACE})
    sent = service.put("/sensors/road/lanes", json={"action": "replace", "lanes": SLANTED})
    assert (sent.status_code, sent.json()["mode"]) == (202, "replaced")
    service.post("/sensors/road/frames:batch", json=recording("road", 200, vehicles=1))
    until(lambda: service.get("/sensors/road/lanes").json()["version"])
    return "/sensors/road"


def test_drawn_lanes_are_in_force_and_given_in_the_plan_frame_and_on_earth(service, road):
    reply = LaneMapReply.model_validate(service.get(f"{road}/lanes").json())

    assert (reply.version, reply.source, reply.mode) == ("1-1", "user", "replaced")
    assert [lane.lane_id for lane in reply.lanes] == ["L1", "L2"]
    lane = reply.lanes[0]
    assert lane.points_m == [(4.0, 25.0), (0.5, 135.0)]
    assert lane.direction == "receding"
    assert lane.left_m[0][0] < 4.0 < lane.right_m[0][0]
    # the boresight points east: 25 m ahead and 4 m to the right are 25 m east and 4 m south
    assert lane.coordinates[0] == pytest.approx((8.000364, 51.999964), abs=2e-6)


def test_geojson_has_longitude_first_and_the_direction_of_driving(service, road):
    reply = service.get(f"{road}/lanes", headers={"Accept": "application/geo+json"})

    assert reply.headers["content-type"] == "application/geo+json"
    feature = reply.json()["features"][0]
    (first, _), (last, _) = feature["geometry"]["coordinates"][0], feature["geometry"]["coordinates"][-1]
    assert feature["geometry"]["type"] == "LineString"
    assert 8.0 < first < last
    assert feature["properties"]["lane_id"] == feature["id"] == "L1"


def test_a_map_that_is_known_already_is_not_sent_again(service, road):
    first = service.get(f"{road}/lanes")
    again = service.get(f"{road}/lanes", headers={"If-None-Match": first.headers["etag"]})

    assert (again.status_code, again.content) == (304, b"")


def test_tracks_are_in_lanes_and_their_changes_are_stored(service, road):
    page = until(
        lambda: Page[LaneChangeReply].model_validate(service.get(f"{road}/lane-changes").json()).items
    )

    (change,) = page
    assert (change.from_lane, change.to_lane, change.map_version) == ("L1", "L2", "1-1")
    assert change.x_m == pytest.approx(4.0, abs=0.1)
    assert change.y_m == pytest.approx(80.0, abs=6.0)
    assert change.decided_at > change.timestamp

    def lanes():
        lines = service.get(f"/tracks/{change.track_id}/states?format=ndjson").text.splitlines()
        return [json.loads(line)["lane"] for line in lines]

    until(lambda: lanes()[-1] == 2)
    assert lanes()[0] == 1
    later = service.get(f"{road}/lane-changes?start={change.decided_at}").json()
    assert later["items"] == []


def test_versions_tell_what_they_changed(service, road):
    page = Page[LaneVersionReply].model_validate(service.get(f"{road}/lanes/versions").json())

    assert [(item.version, item.lanes, item.change.added) for item in page.items] == [
        ("1-1", 2, ["L1", "L2"])
    ]
    assert service.get(f"{road}/lanes?version=1-1").json()["version"] == "1-1"
    problem(service.get(f"{road}/lanes?version=1-7"), 404)
    problem(service.get(f"{road}/lanes?version=newest"), 422)


def test_a_map_is_accepted_and_its_lanes_are_named(service, road):
    service.put(f"{road}/lanes", json={"action": "accept", "version": "1-1", "names": {"L1": "left"}})

    reply = service.get(f"{road}/lanes").json()
    assert (reply["accepted"], [lane["name"] for lane in reply["lanes"]]) == (True, ["left", None])
    service.put(f"{road}/lanes", json={"action": "rename", "names": {"L1": None, "L2": "right"}})
    assert [lane["name"] for lane in service.get(f"{road}/lanes").json()["lanes"]] == [None, "right"]


def test_a_version_is_pinned_and_let_go(service, road):
    pinned = service.put(f"{road}/lanes", json={"action": "pin"}).json()
    learned = service.put(f"{road}/lanes", json={"action": "learn"}).json()

    assert (pinned["mode"], [lane["index"] for lane in pinned["lanes"]]) == ("pinned", [1, 2])
    assert (learned["mode"], learned["lanes"]) == ("learned", [])


@pytest.mark.parametrize(
    ("body", "status"),
    [
        ({"action": "replace"}, 422),
        ({"action": "rename"}, 422),
        ({"action": "pin", "lanes": SLANTED}, 422),
        ({"action": "pin", "version": "2-2"}, 404),
        ({"action": "forget"}, 422),
        ({"action": "replace", "lanes": [SLANTED[0], SLANTED[0]]}, 422),
    ],
)
def test_an_action_without_sense_is_refused(service, road, body, status):
    problem(service.put(f"{road}/lanes", json=body), status)


def test_a_sensor_without_lanes_and_without_a_position_says_so(service):
    service.post("/sensors", json={"sensor_id": "lost"})

    reply = service.get("/sensors/lost/lanes").json()

    assert (reply["version"], reply["lanes"]) == (None, [])
    problem(service.get("/sensors/lost/lanes?format=geojson"), 409)
    problem(service.put("/sensors/lost/lanes", json={"action": "pin"}), 404)
    problem(service.get("/sensors/nobody/lanes"), 404)
    problem(service.get("/sensors/nobody/lane-changes"), 404)
