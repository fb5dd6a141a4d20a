"""Count lines drawn by mouse, and lanes, in a real browser, before a real server."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect

from tests.api.serving import serving, until
from tests.browser.stream import RoadStream

pytestmark = [pytest.mark.browser, pytest.mark.slow]


def lines_of(service):
    return service.get("/sensors/lined").json()["count_lines"]


@pytest.fixture
def lined(tmp_path):
    """A service whose sensor has no count line yet."""
    with serving(tmp_path) as service:
        assert service.post("/sensors", json={"sensor_id": "lined"}).status_code == 201
        with RoadStream(service, "lined"):
            yield service


def test_a_line_is_drawn_named_saved_and_removed(lined, visit):
    with visit(lined.url) as page:
        expect(page.locator("#plan")).not_to_have_attribute("data-tracks", "0")
        expect(page.locator("#lines-none")).to_be_visible()
        page.get_by_role("button", name="Draw a line").click()
        save = page.get_by_role("button", name="Save")
        expect(save).to_be_disabled()
        box = page.locator("#plan").bounding_box()
        page.mouse.click(box["x"] + box["width"] * 0.4, box["y"] + box["height"] * 0.5)
        page.mouse.click(box["x"] + box["width"] * 0.6, box["y"] + box["height"] * 0.5)
        expect(page.get_by_label("Name")).to_have_value("Line 1")
        page.get_by_label("Name").fill("Bridge")
        save.click()
        expect(page.locator("#lines-list")).to_contain_text("Bridge")
        (line,) = lines_of(lined)
        assert line["line_id"] == "Bridge"
        (x0_m, y0_m), (x1_m, y1_m) = line["p0"], line["p1"]
        assert x0_m < 0 < x1_m
        assert y0_m == y1_m
        assert 60 < y0_m < 90  # the middle of the region, which is fitted
        page.get_by_role("button", name="Remove the count line Bridge").click()
        expect(page.locator("#lines-none")).to_be_visible()
        assert lines_of(lined) == []


def test_a_refused_line_says_why_and_stays_to_be_mended(lined, visit):
    with visit(lined.url, expected=("422",)) as page:
        page.get_by_role("button", name="Draw a line").click()
        box = page.locator("#plan").bounding_box()
        for _ in range(2):
            page.mouse.click(box["x"] + box["width"] * 0.4, box["y"] + box["height"] * 0.5)
        page.get_by_role("button", name="Save").click()
        expect(page.locator("#line-failure")).to_contain_text("not changed")
        page.get_by_role("button", name="Cancel").click()
        expect(page.get_by_role("button", name="Draw a line")).to_be_visible()
        assert lines_of(lined) == []


def test_lanes_are_drawn_under_the_vehicles_and_can_be_hidden(lined, visit):
    lane = {"index": 1, "points_m": [[2.0, 25.0], [2.0, 140.0]], "width_m": 3.5}
    reply = lined.put("/sensors/lined/lanes", json={"action": "replace", "lanes": [lane]})
    assert reply.status_code == 202, reply.text
    until(lambda: lined.get("/sensors/lined/lanes").json()["lanes"])
    with visit(lined.url) as page:
        expect(page.locator("#plan")).to_have_attribute("data-lanes", "1")
        page.get_by_label("Lanes").uncheck()
        expect(page.locator("#plan")).to_have_attribute("data-lanes", "0")
