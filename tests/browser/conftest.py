from __future__ import annotations

import os
import shutil
from contextlib import contextmanager
from dataclasses import dataclass, field

import pytest
from playwright.sync_api import ConsoleMessage, Page, expect, sync_playwright

from tests.api.serving import serving
from tests.browser.stream import SENSOR, RoadStream

FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
DESKTOP = {"width": 1440, "height": 900}
PHONE = {"width": 390, "height": 844}
PATIENCE_MS = 15_000
VIOLATIONS = """
window.violations = [];
addEventListener("securitypolicyviolation", (event) => window.violations.push(event.violatedDirective));
"""


def needed_program(name):
    """Return the path of a program; without it the test is skipped, but fails on CI."""
    path = shutil.which(name)
    if path is None and os.environ.get("CI") == "true":
        pytest.fail(f"{name} is not installed")
    if path is None:
        pytest.skip(f"{name} is not installed")
    return path


@dataclass
class Visit:
    """A page, and what went wrong on it."""

    page: Page
    faults: list[str] = field(default_factory=list)
    expected: tuple[str, ...] = ()  # parts of console errors that belong to the test

    def hear(self, message: ConsoleMessage):
        if message.type in {"error", "warning"}:
            self.faults.append(message.text)

    def check(self):
        strange = [text for text in self.faults if not any(part in text for part in self.expected)]
        assert strange == []
        assert self.page.evaluate("window.violations") == []


@pytest.fixture(scope="module")  # not longer: while it lives, its event loop runs in this thread
def chromium():
    path = needed_program("chromium")
    expect.set_options(timeout=PATIENCE_MS)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def visit(chromium):
    """Open pages; at the end none may have had an error or a violation of the security policy."""

    @contextmanager
    def open_page(url, *, size=DESKTOP, motion="reduce", expected=(), route=None, **options):
        # Without smooth motion the page draws eight times a second, not thirty: software drawing is slow.
        context = chromium.new_context(viewport=size, reduced_motion=motion, **options)
        context.set_default_timeout(PATIENCE_MS)
        context.add_init_script(VIOLATIONS)
        page = context.new_page()
        visited = Visit(page, expected=expected)
        page.on("console", visited.hear)
        page.on("pageerror", lambda error: visited.faults.append(str(error)))
        try:
            if route is not None:
                page.route(*route)
            page.goto(url)
            yield page
            visited.check()
        finally:
            context.close()

    return open_page


@pytest.fixture(scope="module")
def road(tmp_path_factory):
    """A service with one sensor and moving vehicles, and another sensor without frames."""
    with serving(tmp_path_factory.mktemp("road")) as service:
        lines = [{"line_id": "C80", "p0": [-8.0, 80.0], "p1": [8.0, 80.0]}]
        place = {"latitude_deg": 48.137, "longitude_deg": 11.575}
        for body in ({"sensor_id": SENSOR, "count_lines": lines, **place}, {"sensor_id": "radar-2"}):
            assert service.post("/sensors", json=body).status_code == 201
        with RoadStream(service):
            yield service
