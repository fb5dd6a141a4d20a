from __future__ import annotations

import httpx
import pytest
from anyio import run
from fastapi import FastAPI

from service.api import problems
from service.api.dashboard import Dashboard


def get(app, path, **headers):
    async def ask() -> httpx.Response:
        transport = httpx.ASGITransport(app)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return await client.get(path, headers=headers)

    return run(ask)


@pytest.fixture
def app(tmp_path):
    (tmp_path / "vendor").mkdir()
    (tmp_path / "index.html").write_text("<!doctype html><title>Wayside</title>")
    (tmp_path / "vendor" / "plot.js").write_text("export {}")
    app = FastAPI(redirect_slashes=False)
    app.router.default = Dashboard(tmp_path)
    problems.install(app)
    return app


def test_the_page_and_its_files_are_served_under_a_strict_policy(app):
    page, script = get(app, "/"), get(app, "/vendor/plot.js")

    assert "Wayside" in page.text
    assert "javascript" in script.headers["content-type"]
    for reply in (page, script):
        policy = reply.headers["content-security-policy"]
        assert "default-src 'none'; script-src 'self'; style-src 'self'" in policy
        assert "unsafe" not in policy
        assert reply.headers["cache-control"] == "no-cache"


def test_an_unchanged_file_is_not_sent_again(app):
    tag = get(app, "/").headers["etag"]

    assert get(app, "/", **{"If-None-Match": tag}).status_code == 304


@pytest.mark.parametrize("path", ["/none.js", "/api/index.html", "/../x", "/vendor/%2e%2e/%2e%2e/etc/passwd"])
def test_nothing_else_is_served(app, path):
    reply = get(app, path)

    assert reply.status_code == 404
    assert reply.headers["content-type"] == "application/problem+json"


def test_a_missing_folder_is_no_fault(tmp_path):
    app = FastAPI()
    app.router.default = Dashboard(tmp_path / "nothing")
    problems.install(app)

    assert get(app, "/").status_code == 404
