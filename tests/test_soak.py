"""A few seconds of `benchmarks/soak.py`: a real service, posted to over HTTP, loses and doubles nothing."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
def test_a_short_soak_loses_and_doubles_nothing(tmp_path):
    options = ["--minutes", "0.05", "--warm", "1", "--sensors", "2", "--vehicles", "6"]
    command = [sys.executable, "benchmarks/soak.py", *options, "--json", str(tmp_path / "soak.json")]

    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=300)

    found = json.loads((tmp_path / "soak.json").read_text())
    assert found["posted"] == 2 * 80
    assert (found["lost"], found["doubled"]) == (0, 0)
    assert found["fates"] == {"tracked": 160}
    assert found["readable_p50_ms"] > 0
    assert found["log_mb_per_sensor_hour"] > 0
