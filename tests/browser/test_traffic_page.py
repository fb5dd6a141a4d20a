"""The page of traffic measures in a real browser, before a server with three recorded minutes and a bit."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import pytest
from playwright.sync_api import expect

from service.formats.rfc3339 import format_time
from tests.api.serving import serving, until
from tests.browser.stream import detections

pytestmark = [pytest.mark.browser, pytest.mark.slow]

SENSOR = "counted"
BEGIN_US = 1_747_029_600_000_000  # 2025-05-12T06:00:00Z
MINUTES = 3
RUNNING_S = 6  # of a fourth minute
RATE_HZ = 10.0
PATIENCE_S = 90.0  # the kernels may have to be compiled first
BATCH = 400
VENDOR = Path(__file__).parents[2] / "service" / "dashboard" / "vendor" / "uplot"


def frame(number):
    elapsed_s = number / RATE_HZ
    timestamp = format_time(BEGIN_US + round(elapsed_s * 1e6))
    return {"timestamp": timestamp, "frame": number, "detections": detections(elapsed_s)}


@pytest.fixture(scope="module")
def counted(tmp_path_factory):
    """A service that has folded the recording."""
    with serving(tmp_path_factory.mktemp("counted")) as service:
        lines = [{"line_id": "C80", "p0": [-12.0, 80.0], "p1": [12.0, 80.0]}]
        sensor = {"sensor_id": SENSOR, "rate_hz": RATE_HZ, "count_lines": lines}
        assert service.post("/sensors", json=sensor).status_code == 201
        total = round((MINUTES * 60 + RUNNING_S) * RATE_HZ)
        for first in range(1, total, BATCH):
            batch = [frame(number) for number in range(first, min(first + BATCH, total + 1))]
            reply = service.post(f"/sensors/{SENSOR}/frames:batch", json=batch)
            assert reply.json()["accepted"] == len(batch)
        until(lambda: service.get(f"/sensors/{SENSOR}/live").json()["frame"] == total, PATIENCE_S)
        until(lambda: volume_of(service) > 0)
        yield service


def volume_of(service):
    window = {"start": "2025-05-12T06:00:00Z", "end": "2025-05-12T07:00:00Z", "interval": "60min", "by": ""}
    items = service.get(f"/sensors/{SENSOR}/flow", params=window).json()["items"]
    return sum(row["volume"] for row in items)


def test_counts_of_a_recording_are_drawn_and_open_into_their_evidence(counted, visit):
    with visit(f"{counted.url}/traffic.html") as page:
        expect(page.locator("#line")).to_have_value("C80")
        expect(page.locator("#volume")).to_have_attribute("data-points", re.compile(r"^[34]$"))
        rows = page.locator("#measures tbody tr")
        expect(rows.first).to_be_visible()
        volumes = [int(text) for text in rows.locator("td:nth-child(3)").all_inner_texts()]
        shown = max(volumes)
        assert shown > 0
        rows.nth(volumes.index(shown)).get_by_role("button").click()
        dialog = page.locator("#evidence")
        expect(dialog).to_have_attribute("data-crossings", str(shown))
        assert dialog.locator("tbody tr").count() == shown
        expect(dialog).to_contain_text(f"{SENSOR}-1-")
        page.get_by_role("button", name="Close the evidence").click()
        expect(dialog).to_be_hidden()


def measured_interval(page):
    return page.locator("#measures-of")


def test_the_minute_that_runs_is_left_out_until_it_ends(counted, visit):
    with visit(f"{counted.url}/traffic.html", timezone_id="UTC", locale="en-GB") as page:
        expect(measured_interval(page)).to_contain_text("06:03:00")  # of a recording the last one has ended
        expect(page.locator("#window")).not_to_contain_text("left out")

        page.clock.set_fixed_time("2025-05-12T06:03:07Z")
        page.reload()

        expect(page.locator("#window")).to_contain_text("the interval that has not ended is left out")
        expect(measured_interval(page)).to_contain_text("06:02:00")
        coverages = page.locator("#measures tbody td:nth-child(11)").all_inner_texts()
        assert coverages
        assert set(coverages) == {"100"}

        page.locator("#period").select_option("One week, by hour")  # where none has ended, the one that runs
        expect(measured_interval(page)).to_contain_text("06:00:00")
        expect(page.locator("#window")).not_to_contain_text("left out")


def test_hours_without_frames_are_told_from_hours_with_them(counted, visit):
    with visit(f"{counted.url}/traffic.html") as page:
        expect(page.locator("#calendar td[data-level='poor']")).to_have_count(1)  # three minutes of an hour
        assert page.locator("#calendar td[data-level='none']").count() > 300


def test_the_diagram_shows_the_vehicles_of_the_last_minutes(counted, visit):
    with visit(f"{counted.url}/traffic.html") as page:
        expect(page.locator("#diagram")).to_have_attribute("data-tracks", re.compile(r"^\d\d"))


def test_a_count_by_hand_is_compared(counted, visit):
    with visit(f"{counted.url}/traffic.html", timezone_id="UTC") as page:
        expect(page.locator("#line")).to_have_value("C80")
        page.locator("#check-start").fill("2025-05-12T06:00")
        page.locator("#check-count").fill(str(volume_of(counted)))
        page.get_by_role("button", name="Compare").click()
        row = page.locator("#checks tbody tr").first
        expect(row).to_contain_text("within target")
        expect(row.locator("td").nth(4)).to_have_text("0")


def test_the_vendored_library_is_what_its_checksums_say():
    for line in (VENDOR / "SHA256SUMS").read_text().splitlines():
        digest, name = line.split()
        assert hashlib.sha256((VENDOR / name).read_bytes()).hexdigest() == digest, name
