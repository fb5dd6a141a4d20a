"""The dashboard in a real browser, before a real server."""

from __future__ import annotations

import re
import subprocess
from itertools import product

import pytest
from playwright.sync_api import expect

from tests.api.serving import serving
from tests.browser.conftest import PHONE, needed_program
from tests.browser.stream import PARKED_M, SENSOR, VEHICLES, RoadStream

pytestmark = [pytest.mark.browser, pytest.mark.slow]

SOME = re.compile(r"^[1-9]\d*$")
ALL_VEHICLES = re.compile(r"^(9|\d\d)$")  # one that drives out and in again is there twice for a moment


def wait_for_drawn(page, name, count):
    """Wait until the canvas tells that it drew so many."""
    expect(page.locator("#plan")).to_have_attribute(f"data-{name}", count)


def wait_for_vehicles(page):
    wait_for_drawn(page, "tracks", ALL_VEHICLES)


def cells(page, column):
    return page.locator(f"#tracks tbody td.of-{column}").all_inner_texts()


def test_vehicles_appear_and_move(road, visit):
    with visit(road.url, motion="no-preference") as page:
        wait_for_vehicles(page)
        row = page.locator("#tracks tbody tr").nth(3)
        expect(row.locator("td.of-status")).to_have_text("Confirmed")
        track_id = row.get_attribute("data-track")
        place = page.locator(f"tr[data-track='{track_id}'] td.of-y")
        before = place.inner_text()
        expect(place).not_to_have_text(before)
        expect(page.locator("#state")).to_have_text("Live")
        expect(page.locator("#banner")).to_be_hidden()
        assert page.locator("#tracks tbody tr").count() >= VEHICLES
        assert page.title() == f"{SENSOR} · Wayside"


def test_the_canvas_is_not_blank(road, visit):
    with visit(road.url) as page:
        wait_for_vehicles(page)
        colours = page.evaluate(
            """() => {
              const canvas = document.querySelector("#plan");
              const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
              const found = new Set();
              for (let i = 0; i < pixels.length; i += 4) {
                found.add((pixels[i] << 16) | (pixels[i + 1] << 8) | pixels[i + 2]);
              }
              return found.size;
            }"""
        )
        assert colours > 20  # ground, region, rings, boxes, text with its smoothed edges


def test_switches_change_what_is_drawn(road, visit):
    with visit(road.url) as page:
        wait_for_vehicles(page)
        wait_for_drawn(page, "labels", SOME)
        wait_for_drawn(page, "trails", SOME)
        wait_for_drawn(page, "points", "0")
        page.get_by_label("Points").check()
        wait_for_drawn(page, "points", str(VEHICLES))
        page.get_by_label("Labels").uncheck()
        wait_for_drawn(page, "labels", "0")
        page.get_by_label("Trails").uncheck()
        wait_for_drawn(page, "trails", "0")
        page.get_by_label("Points").uncheck()
        wait_for_drawn(page, "points", "0")
        wait_for_vehicles(page)


def test_raw_points_are_asked_for_only_when_they_are_shown(road, visit):
    with visit(road.url) as page:
        with page.expect_response(lambda reply: "/live?" in reply.url) as plain:
            pass
        assert "points" not in plain.value.url
        page.get_by_label("Points").check()
        with page.expect_response(lambda reply: "points=true" in reply.url) as full:
            pass
        assert len(full.value.json()["points"]["x_m"]) == VEHICLES


def test_preferences_outlive_the_page(road, visit):
    with visit(road.url) as page:
        page.get_by_label("Points").check()
        page.get_by_label("Units").select_option("mph")
        page.reload()
        expect(page.get_by_label("Points")).to_be_checked()
        expect(page.get_by_label("Units")).to_have_value("mph")
        wait_for_drawn(page, "points", SOME)


def test_units_switch_speeds_everywhere(road, visit):
    with visit(road.url) as page:
        wait_for_vehicles(page)
        expect(page.locator("td.of-speed", has_text=re.compile(r"^[345]\d$")).first).to_be_visible()
        page.get_by_label("Units").select_option("mps")
        expect(page.locator("th.of-speed")).to_have_text("m/s")
        assert all(re.fullmatch(r"\d+\.\d", text) for text in cells(page, "speed"))
        assert page.locator("#legend-fast").inner_text() == "16.7+ m/s"


def test_a_row_opens_the_details_and_the_headings_sort(road, visit):
    with visit(road.url) as page:
        wait_for_vehicles(page)
        parked = page.locator("#tracks tbody tr", has=page.locator("td.of-speed", has_text=re.compile("^0$")))
        track_id = parked.get_attribute("data-track")
        button = parked.locator("button")
        button.focus()
        page.keyboard.press("Enter")
        details = page.locator("#details")
        expect(details.locator("h2")).to_contain_text(track_id)
        expect(details).to_contain_text(re.compile(r"Speed\s*0 km/h"))
        expect(details).to_contain_text("48.1")  # latitude
        expect(button).to_have_attribute("aria-pressed", "true")
        page.get_by_role("button", name="Close the details").click()
        expect(details).to_be_hidden()
        page.get_by_role("button", name="Id", exact=True).click()
        expect(page.locator("th.of-id")).to_have_attribute("aria-sort", "ascending")
        numbers = [int(text) for text in cells(page, "id")]
        assert numbers == sorted(numbers)


def test_a_row_that_changes_its_place_keeps_the_focus(road, visit):
    with visit(road.url) as page:
        wait_for_vehicles(page)
        parked = page.locator("#tracks tbody tr", has=page.locator("td.of-speed", has_text=re.compile("^0$")))
        track_id = parked.get_attribute("data-track")
        button = page.locator(f'#tracks tbody tr[data-track="{track_id}"] button')
        button.focus()
        page.evaluate(  # how often the row has been taken from its place
            """(id) => {
                window.moves = 0;
                const row = document.querySelector(`#tracks tbody tr[data-track="${id}"]`);
                new MutationObserver((changes) => {
                    for (const { removedNodes } of changes) window.moves += [...removedNodes].includes(row);
                }).observe(row.parentElement, { childList: true });
            }""",
            track_id,
        )
        page.wait_for_function("() => window.moves > 1")
        expect(button).to_be_focused()


def test_the_plan_zooms_pans_and_fits(road, visit):
    with visit(road.url) as page:
        wait_for_vehicles(page)
        canvas = page.locator("#plan")
        scale, centre = canvas.get_attribute("data-scale"), canvas.get_attribute("data-centre")
        canvas.focus()
        page.keyboard.press("+")
        expect(canvas).not_to_have_attribute("data-scale", scale)
        box = canvas.bounding_box()
        page.mouse.move(box["x"] + 300, box["y"] + 300)
        page.mouse.wheel(0, -300)
        page.mouse.down()
        page.mouse.move(box["x"] + 380, box["y"] + 260, steps=4)
        page.mouse.up()
        expect(canvas).not_to_have_attribute("data-centre", centre)
        page.get_by_role("button", name="Fit").click()
        expect(canvas).to_have_attribute("data-scale", scale)
        expect(canvas).to_have_attribute("data-centre", centre)


def test_a_tap_on_a_vehicle_selects_it_and_escape_lets_go(road, visit):
    with visit(road.url) as page:
        wait_for_vehicles(page)
        canvas = page.locator("#plan")
        box, scale = canvas.bounding_box(), float(canvas.get_attribute("data-scale"))
        x_centre_m, y_centre_m = map(float, canvas.get_attribute("data-centre").split())
        x_m, y_m = PARKED_M
        left, top = (
            box["width"] / 2 + (x_m - x_centre_m) * scale,
            box["height"] / 2 - (y_m - y_centre_m) * scale,
        )
        canvas.click(position={"x": left, "y": top})
        expect(page.locator("#details")).to_contain_text(re.compile(r"Speed\s*0 km/h"))
        expect(page.locator("#tracks tr.selected td.of-y")).to_have_text(re.compile(rf"^{y_m:.0f}\.\d$"))
        page.keyboard.press("Escape")
        expect(page.locator("#details")).to_be_hidden()
        expect(page.locator("#tracks tr.selected")).to_have_count(0)


def test_health_tells_rate_and_points(road, visit):
    with visit(road.url) as page:
        health = page.locator("#health")
        expect(health).to_contain_text(re.compile(r"Frame rate\s*[12]\d\.\d /s"))
        expect(health).to_contain_text(re.compile(rf"Points\s*{VEHICLES} a frame"))
        expect(health).to_contain_text(re.compile(r"Missing\s*0 frames"))
        expect(page.locator("#version")).to_contain_text("Wayside")


def test_another_sensor_can_be_picked(road, visit):
    with visit(road.url) as page:
        wait_for_vehicles(page)
        page.get_by_label("Sensor", exact=True).select_option("radar-2")
        expect(page.locator("#empty")).to_contain_text("Waiting for the first frame of radar-2")
        wait_for_drawn(page, "tracks", "0")
        page.get_by_label("Sensor", exact=True).select_option(SENSOR)
        wait_for_vehicles(page)
        expect(page.locator("#empty")).to_be_hidden()


def test_it_works_behind_a_prefix(road, visit):
    def strip(route):
        route.fulfill(response=route.fetch(url=route.request.url.replace("/roads/north/", "/")))

    with visit(f"{road.url}/roads/north/", route=("**/*", strip)) as page:
        wait_for_vehicles(page)
        page.get_by_label("Sensor", exact=True).select_option("radar-2")
        expect(page.locator("#empty")).to_contain_text(
            f"{road.url}/roads/north/api/v1/sensors/radar-2/frames"
        )
        page.goto("about:blank")  # it asks for nothing more: without the route that would not be found
        page.unroute_all(behavior="ignoreErrors")


def test_nothing_new_is_answered_by_304_and_a_silent_sensor_is_shown_as_stale(tmp_path, visit):
    with serving(tmp_path) as service:
        assert service.post("/sensors", json={"sensor_id": SENSOR}).status_code == 201
        with RoadStream(service) as stream, visit(service.url) as page:
            wait_for_vehicles(page)
            stream.stop()
            expect(page.locator("#banner")).to_contain_text(f"No frames from {SENSOR}")
            expect(page.locator("#state")).to_have_text("No data")
            expect(page.locator("#main")).to_have_class(re.compile("stale"))
            assert page.title().startswith("⚠")
            with page.expect_response(lambda reply: "/live?" in reply.url and reply.status == 304) as reply:
                pass
            assert reply.value.headers["etag"] == reply.value.request.all_headers()["if-none-match"]
            expect(page.locator("#banner")).to_be_visible()
            with RoadStream(service):
                expect(page.locator("#banner")).to_be_hidden()


def test_a_server_that_went_away_is_told(tmp_path, visit):
    server = serving(tmp_path)
    service = server.__enter__()
    try:
        assert service.post("/sensors", json={"sensor_id": SENSOR}).status_code == 201
        with (
            visit(service.url, expected=("net::ERR_",)) as page,
            RoadStream(service) as stream,
        ):
            wait_for_vehicles(page)
            stream.stop()
            server.__exit__(None, None, None)
            server = None
            expect(page.locator("#banner")).to_contain_text("The server cannot be reached")
            expect(page.locator("#state")).to_have_text("Unreachable")
            expect(page.locator("#main")).to_have_class(re.compile("stale"))
    finally:
        if server is not None:
            server.__exit__(None, None, None)


def test_without_a_sensor_and_without_frames_the_next_command_is_shown(tmp_path, visit):
    needed_program("curl")
    with serving(tmp_path) as service, visit(service.url) as page:
        empty = page.locator("#empty")
        expect(empty).to_contain_text("No sensor yet")
        expect(empty).to_contain_text(f"wayside sensor add site.json --url {service.url}")
        expect(empty).to_contain_text("wayside demo --port")
        run_shown(empty.locator("code", has_text="curl").inner_text())
        expect(empty).to_contain_text("Waiting for the first frame of radar-1")
        expect(empty).to_contain_text(f"wayside replay frames.jsonl.gz --sensor radar-1 --url {service.url}")
        run_shown(empty.locator("code", has_text="curl").inner_text())
        expect(empty).to_be_hidden()
        assert service.get("/sensors/radar-1/live").json()["frame"] is not None


def run_shown(command):
    done = subprocess.run(["/bin/sh", "-c", command], capture_output=True, check=True, text=True)
    assert '"errors"' not in done.stdout, done.stdout


def test_a_key_opens_the_dashboard_and_signing_out_closes_it(tmp_path, visit):
    with serving(tmp_path) as service:
        assert service.post("/sensors", json={"sensor_id": SENSOR}).status_code == 201
        admin = service.post("/keys", json={"name": "all", "scopes": ["admin"]}).json()["secret"]
        headers = {"Authorization": f"Bearer {admin}"}
        ingest, reading = (
            service.post("/keys", json={"name": scope, "scopes": [scope]}, headers=headers).json()["secret"]
            for scope in ("ingest", "read")
        )
        with (
            RoadStream(service, headers={"X-API-Key": ingest}),
            visit(service.url, expected=("status of 401",)) as page,
        ):
            form = page.locator("#sign-in")
            expect(page.get_by_label("API key")).to_be_focused()
            expect(page.locator("#main")).to_be_hidden()
            for secret, answer in (("wrong", "not valid"), (ingest, "does not open the scope read")):
                page.get_by_label("API key").fill(secret)
                page.get_by_role("button", name="Sign in").click()
                expect(form.get_by_role("alert")).to_contain_text(answer)
            page.get_by_label("API key").fill(reading)
            page.keyboard.press("Enter")
            wait_for_vehicles(page)
            expect(form).to_be_hidden()
            (cookie,) = page.context.cookies()
            assert cookie["httpOnly"]
            assert cookie["sameSite"] == "Strict"
            assert reading not in page.evaluate(
                "JSON.stringify([localStorage, sessionStorage, document.cookie])"
            )
            page.reload()
            wait_for_vehicles(page)
            page.get_by_role("button", name="Sign out").click()
            expect(form).to_be_visible()
            assert page.context.cookies() == []


def test_the_desktop_shows_plan_and_table_side_by_side_without_scrolling(road, visit):
    with visit(road.url) as page:
        wait_for_vehicles(page)
        plan, table = (page.locator(name).bounding_box() for name in ("#plan", "#tracks"))
        assert plan["width"] > 800
        assert plan["height"] > 600
        assert table["x"] > plan["x"] + plan["width"]
        assert overflow(page) == (0, 0)


def test_the_phone_shows_the_table_under_the_plan_with_targets_for_fingers(road, visit):
    with visit(road.url, size=PHONE, has_touch=True, is_mobile=True) as page:
        wait_for_vehicles(page)
        plan, table = (page.locator(name).bounding_box() for name in ("#plan", "#tracks"))
        assert plan["width"] > 350
        assert plan["height"] > 400
        assert table["y"] > plan["y"] + plan["height"]
        assert table["width"] < PHONE["width"]
        assert overflow(page)[0] == 0
        page.locator("#tracks tbody tr button").nth(1).tap()
        expect(page.locator("#details")).to_be_visible()
        targets = page.locator("header select, .tools label, .tools button, td button, #details-close")
        sizes = targets.evaluate_all(
            "all => all.map(one => [one.id || one.textContent, one.offsetWidth, one.offsetHeight])"
        )
        assert len(sizes) > VEHICLES
        assert [size for size in sizes if 0 < min(size[1:]) < 44] == []


def overflow(page):
    """Return by how many pixels the page is wider and higher than the window."""
    wide = page.evaluate("document.documentElement.scrollWidth - innerWidth")
    return wide, page.evaluate("document.documentElement.scrollHeight - innerHeight")


def test_text_has_the_contrast_that_wcag_asks_for_in_both_schemes(road, visit):
    pairs = [
        ("--text", "--surface"),
        ("--quiet", "--surface"),
        ("--quiet", "--ground"),
        ("--text", "--selected"),
        ("--bad", "--surface"),
        ("--good", "--surface"),
        ("--warn-text", "--warn-ground"),
        ("--on-accent", "--accent"),
        ("--plan-ink", "--plan-region"),
        ("--plan-grid-text", "--plan-region"),
        ("--plan-mark", "--plan-region"),
    ]
    with visit(road.url) as page:
        for scheme, names in product(("dark", "light"), pairs):
            page.emulate_media(color_scheme=scheme)
            first, second = (
                page.evaluate(
                    "(name) => getComputedStyle(document.documentElement).getPropertyValue(name)", name
                )
                for name in names
            )
            ratio = contrast(first.strip(), second.strip())
            assert ratio >= 4.5, (scheme, names)  # WCAG 2.2, 1.4.3, level AA


def contrast(first, second):
    bright, dark = sorted((luminance(first), luminance(second)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)


def luminance(colour):
    parts = [int(colour[start : start + 2], 16) / 255 for start in (1, 3, 5)]
    red, green, blue = (
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def test_numbers_are_written_as_people_read_them(road, visit):
    cases = {
        "speedText(16.811, 'kmh')": "61 km/h",
        "speedText(16.811, 'mps')": "16.8 m/s",
        "speedText(16.811, 'mph')": "38 mph",
        "speedText(null, 'kmh')": "\u2013",
        "numberText(-0.04, 1)": "0.0",
        "numberText(-3.26, 1, 'm')": "\u22123.3 m",
        "durationText(0.31)": "0.3 s",
        "durationText(119)": "119 s",
        "durationText(3600)": "60 min",
        "durationText(90_000)": "25 h",
        "durationText(400_000)": "5 d",
        "bytesText(999)": "999 B",
        "bytesText(3_343_920)": "3.3 MB",
        "shortId('radar-1-2-37')": "37",
    }
    with visit(road.url) as page:
        for call, text in cases.items():
            assert page.evaluate(f"import('./format.js').then((format) => format.{call})") == text, call
