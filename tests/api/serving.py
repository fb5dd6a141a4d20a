"""Run the real service on a free port in a thread, and talk to it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass

import httpx

from service.api.app import create_app
from service.api.server import Server, listening
from service.formats.rfc3339 import format_time_exact
from service.pipeline.host import EmbeddedHost, wall_clock_us
from service.settings import Settings
from service.storage.database import open_database
from service.storage.migrate import upgrade
from tests.pipeline import simple_tracker

PATIENCE_S = 20.0


@dataclass
class Service:
    url: str
    client: httpx.Client
    app: object
    host: EmbeddedHost
    engine: object

    def __getattr__(self, method) -> Callable[..., httpx.Response]:
        """Offer get, post, patch, delete under the versioned prefix."""
        call = getattr(self.client, method)
        return lambda path, **more: call(f"/api/v1{path}", **more)


@contextmanager
def serving(folder, **settings):
    tracker, clock = settings.pop("tracker", simple_tracker), settings.pop("clock", wall_clock_us)
    values = {"data_dir": folder, "port": 0, "flush_interval_s": 0.05, "disk_free_min_share": 0.0}
    chosen = Settings(_env_file=None, **(values | settings))
    engine = open_database(chosen.rows_url)
    upgrade(engine)
    host = EmbeddedHost(engine, chosen, tracker=tracker, clock_us=clock)
    app = create_app(host, engine, chosen)
    ready, urls = threading.Event(), []
    server = Server(app, chosen, lambda url: (urls.append(url), ready.set()))
    with listening(chosen) as listener:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            assert ready.wait(PATIENCE_S)
            with httpx.Client(base_url=urls[0], timeout=PATIENCE_S) as client:
                yield Service(urls[0], client, app, host, engine)
        finally:
            server.should_exit = True
            thread.join(PATIENCE_S)
            engine.dispose()
    assert not thread.is_alive()


def until(question, patience_s=PATIENCE_S):
    """Ask until the answer is true, and return it."""
    end_s = time.monotonic() + patience_s
    while time.monotonic() < end_s:
        answer = question()
        if answer:
            return answer
        time.sleep(0.01)
    raise AssertionError(f"no answer within {patience_s} s")


def recording(sensor_id, count=40, vehicles=2, period_us=50_000):
    """Frames of vehicles that drive away side by side, ending now."""
    first_us = time.time_ns() // 1000 // 1000 * 1000 - count * period_us
    return [
        {
            "sensor_id": sensor_id,
            "timestamp": format_time_exact(first_us + k * period_us),
            "frame": k + 1,
            "detections": [
                {
                    "x_m": 4.0 + 6.0 * v,
                    "y_m": 30.0 + 7.0 * v + 10.0 * k * period_us / 1e6,
                    "radial_velocity_mps": 10.0,
                    "snr_db": 20.0,
                }
                for v in range(vehicles)
            ],
        }
        for k in range(count)
    ]


def problem(response, status):
    """Check that a reply is a well-formed problem, and return it."""
    body = response.json()
    assert response.status_code == status, body
    assert response.headers["content-type"] == "application/problem+json"
    assert body["status"] == status
    assert body["type"].startswith("/problems/")
    assert body["request_id"] == response.headers["x-request-id"]
    assert {"title", "detail", "instance", "errors"} <= body.keys()
    return body
