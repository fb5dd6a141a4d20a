"""`wayside serve`, `demo`, `sensor` and `replay` as processes, over real HTTP."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

PATIENCE_S = 120.0  # a busy machine that compiles kernels
ADDRESS = re.compile(r"http://127\.0\.0\.1:\d+")

Start = Callable[..., tuple[subprocess.Popen[str], str, list[str]]]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start a serving command and return it with its address and the lines it said before."""
    running: list[subprocess.Popen[str]] = []

    def begin(*arguments: str) -> tuple[subprocess.Popen[str], str, list[str]]:
        process = subprocess.Popen(
            [sys.executable, "-m", "service.cli.main", *arguments, "--port", "0"],
            stderr=subprocess.PIPE,
            text=True,
            cwd=Path(__file__).resolve().parents[2],
            env={**os.environ, "WAYSIDE_DATA_DIR": str(tmp_path / "data"), "WAYSIDE_LOG_LEVEL": "warning"},
        )
        running.append(process)
        assert process.stderr is not None
        told = []
        for line in process.stderr:  # ends with the process
            told.append(line)
            if found := ADDRESS.search(line):
                return process, found.group(), told
        raise AssertionError("".join(told))

    yield begin
    for process in running:
        process.kill()
        process.communicate()


def stop(process: subprocess.Popen[str], number: int) -> int:
    process.send_signal(number)
    return process.wait(PATIENCE_S)


@pytest.mark.slow
def test_a_recording_is_replayed_to_a_service_and_tracked(run, start, scene):
    process, address, _ = start("serve")

    told = json.loads(
        run(
            "replay", scene / "frames.jsonl.gz", "--url", address, "--speed", "max",
            "--register", scene / "site.json", "--json",
        ).stdout
    )  # fmt: skip
    sensors = json.loads(run("sensor", "list", "--url", address, "--json").stdout)["sensors"]
    live = newest(address, sensors[0]["sensor_id"], frame=119)

    assert (told["frames"], told["accepted"], told["rejected"]) == (120, 120, 0)
    assert len(live["tracks"]) > 0
    assert stop(process, signal.SIGTERM) == 0


def newest(address: str, sensor_id: str, frame: int) -> dict[str, object]:
    """Return the live view once it shows the frame."""
    version, deadline_s = 0, time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        reply = httpx.get(
            f"{address}/api/v1/sensors/{sensor_id}/live",
            params={"after": version, "wait": 25},
            timeout=PATIENCE_S,
        ).raise_for_status()
        live = reply.json()
        version = live["version"]
        if live["frame"] is not None and live["frame"] >= frame:
            return live
    raise AssertionError(f"frame {frame} was never tracked")


@pytest.mark.slow
def test_the_demo_shows_moving_vehicles(start, tmp_path):
    process, address, _ = start("demo", "--data-dir", str(tmp_path / "demo"))

    live = newest(address, "radar-1", frame=60)

    assert len(live["tracks"]) > 0
    assert httpx.get(f"{address}/readyz", timeout=PATIENCE_S).status_code == 200
    assert stop(process, signal.SIGINT) == 0


@pytest.mark.slow
def test_the_first_key_is_printed_once_and_needed_from_then_on(start):
    _, address, told = start("serve", "--host", "0.0.0.0", "--first-key")  # noqa: S104 - with a key

    key = told[0].rpartition(" ")[2].strip()

    url = f"{address}/api/v1/sensors"
    assert httpx.get(url, timeout=PATIENCE_S).status_code == 401
    assert httpx.get(url, headers={"X-API-Key": key}, timeout=PATIENCE_S).status_code == 200


@pytest.mark.slow
def test_a_second_process_on_the_same_data_is_a_sentence(run, start, tmp_path):
    start("serve")

    result = run("serve", "--port", "0", "--data-dir", tmp_path / "data", code=1)

    assert "Traceback" not in result.stderr
    assert str(tmp_path / "data") in result.stderr


def test_a_busy_port_is_a_sentence_that_names_the_way_out(run, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        result = run("serve", "--port", str(port), "--data-dir", tmp_path / "data", code=1)

    assert f"port {port}" in result.stderr
    assert "--port" in result.stderr


def test_another_address_is_refused_while_there_is_no_key(run, tmp_path):
    result = run("serve", "--host", "0.0.0.0", "--port", "0", "--data-dir", tmp_path, code=2)  # noqa: S104 - refused

    assert "wayside key create" in result.stderr


@pytest.mark.parametrize(
    "arguments", [("sensor", "list"), ("sensor", "show", "radar-1"), ("sensor", "remove", "radar-1")]
)
def test_no_service_is_a_sentence(run, arguments):
    with socket.create_server(("127.0.0.1", 0)) as door:
        port = door.getsockname()[1]

    result = run(*arguments, "--url", f"http://127.0.0.1:{port}", code=1)

    assert "wayside serve" in result.stderr


@pytest.mark.parametrize(("speed", "code"), [("fast", 2), ("0", 2), ("-1", 2), ("inf", 2), ("nan", 2)])
def test_a_wrong_speed_is_a_sentence(run, scene, speed, code):
    assert "--speed" in run("replay", scene / "frames.jsonl.gz", f"--speed={speed}", code=code).stderr
