from __future__ import annotations

import gzip
import json
import signal
import socket
import subprocess
import sys
import time

import httpx
import numpy as np
import pytest

from service.api.server import listening
from service.errors import StorageError
from service.formats.rfc3339 import format_time_exact
from service.settings import Settings
from service.tracking import tracker
from tests.api.serving import PATIENCE_S, serving, until


def drive_past(count=60, speed_mps=-16.0):
    """Frames of one car that comes towards the radar, six points on its front, with some standing clutter."""
    rng = np.random.default_rng(7)
    first_us = time.time_ns() // 1_000_000 * 1000 - count * 50_000
    frames = []
    for k in range(count):
        y_m = 120.0 + speed_mps * k * 0.05
        x_m = 2.0 + rng.uniform(-0.9, 0.9, 6)
        range_m = np.hypot(np.hypot(x_m, y_m + rng.uniform(0, 3.0, 6)), 5.4) + rng.normal(0, 0.05, 6)
        frames.append(
            {
                "timestamp": format_time_exact(first_us + k * 50_000),
                "frame": k,
                "detections": {
                    "range_m": [*range_m.tolist(), 60.0, 80.0],
                    "azimuth_deg": [*np.degrees(np.arctan2(x_m, y_m)).tolist(), 20.0, -20.0],
                    "radial_velocity_mps": [*rng.normal(speed_mps, 0.05, 6).tolist(), 0.0, 0.0],
                    "snr_db": [25.0] * 6 + [20.0, 20.0],
                },
            }
        )
    return frames


@pytest.mark.slow
def test_a_car_is_registered_posted_tracked_seen_stored_and_read_back(tmp_path):
    with serving(tmp_path, tracker=tracker) as running:
        running.post("/sensors", json={"sensor_id": "gantry", "latitude_deg": 48.0, "longitude_deg": 11.0})
        body = gzip.compress(b"\n".join(json.dumps(frame).encode() for frame in drive_past()))
        headers = {"Content-Type": "application/x-ndjson", "Content-Encoding": "gzip"}
        sent = running.post("/sensors/gantry/frames:batch", content=body, headers=headers)
        assert sent.json()["accepted"] == 60

        stored = until(lambda: running.get("/tracks?sensor_id=gantry").json()["items"])
        until(lambda: running.get("/tracks?sensor_id=gantry").json()["items"][0]["ended"])
        track = max(running.get("/tracks?sensor_id=gantry").json()["items"], key=lambda t: t["states"])
        states = running.get(f"/tracks/{track['track_id']}/states").json()["items"]

    assert stored
    assert track["mean_speed_mps"] == pytest.approx(16.0, abs=1.0)
    assert states[-1]["vy_mps"] == pytest.approx(-16.0, abs=1.0)
    assert all(abs(state["x_m"] - 2.0) < 1.0 for state in states)


SERVE = """
import sys
from service.api.server import run
from service.settings import Settings
from service.telemetry import set_up_logging
set_up_logging()
run(Settings(_env_file=None, data_dir=sys.argv[1], port=int(sys.argv[2]), disk_free_min_share=0.0))
"""


@pytest.mark.slow
def test_the_server_ends_in_order_on_sigterm_and_refuses_a_second_process(tmp_path):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-c", SERVE, str(tmp_path)]
    with subprocess.Popen([*command, str(port)], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as first:
        try:
            until(lambda: answers(port) or first.poll() is not None, 3 * PATIENCE_S)
            assert first.poll() is None, first.stderr.read()
            second = subprocess.run([*command, "0"], capture_output=True, check=False, timeout=3 * PATIENCE_S)
            with pytest.raises(StorageError, match=r"cannot listen on 127\.0\.0\.1"):
                listening(Settings(_env_file=None, port=port)).__enter__()
        finally:
            first.send_signal(signal.SIGTERM)
            out, _ = first.communicate(timeout=PATIENCE_S)

    assert first.returncode == 0
    assert out == b""
    assert b"StorageError" in second.stderr


def answers(port):
    try:
        return httpx.get(f"http://127.0.0.1:{port}/readyz").status_code == 200
    except httpx.TransportError:
        return False
