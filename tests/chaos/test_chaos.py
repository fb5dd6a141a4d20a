"""A short cut of `wayside chaos`; its model of the disk catches a log that acknowledges too soon."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from service.chaos.disk import available
from service.chaos.workload import SENSORS, recording
from service.pipeline.sqlite_log import LogLimits, SqliteLog

ROOT = Path(__file__).resolve().parents[2]
MEASURED = ROOT / "docs" / "measured" / "chaos.json"


@pytest.mark.slow
def test_a_host_that_is_cut_anywhere_ends_as_if_it_had_not_been():
    command = [sys.executable, "-m", "service.cli.main", "chaos", "--cuts", "7", "--frames", "48", "--json"]

    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)

    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout)
    assert (found["cuts"], found["equal"]) == (7, 7)
    assert found["rows"]["tracks"] > 8
    assert found["rows"]["events"] == 2  # both clocks were set back
    assert [incident["faults"] for incident in found["incidents"]] == [[]] * len(found["incidents"])
    assert len(found["incidents"]) == (7 if found["below_sqlite"] else 6)


@pytest.mark.slow
@pytest.mark.parametrize(("synchronous", "kept"), [("FULL", 5), ("OFF", 0)])
def test_a_power_cut_takes_back_what_was_acknowledged_before_it_was_synced(tmp_path, synchronous, kept):
    if not available():
        assert "libsqlite3" not in Path("/proc/self/maps").read_text()
        return
    command = [sys.executable, "-m", "tests.chaos.power_cut", str(tmp_path), synchronous]
    syncs = int(subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout)

    log = SqliteLog(tmp_path, LogLimits(free_share=0.0))
    try:
        assert len(log.read("radar-1", 0, 10)) == kept
    finally:
        log.close()
    assert syncs >= kept


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("strace") is None and "CI" not in os.environ, reason="strace is not installed"
)
def test_every_acknowledged_append_has_called_fsync(tmp_path):
    code = (
        "import sys\nfrom pathlib import Path\nfrom service.pipeline.sqlite_log import *\n"
        "from tests.pipeline.recordings import recording, records\n"
        "log = SqliteLog(Path(sys.argv[1]), LogLimits(free_share=0.0))\n"
        "for record in records(recording(20)):\n"
        "    log.append('radar-1', [record])\n    print('acknowledged', flush=True)\n"
    )
    traced = tmp_path / "calls"
    trace = ["strace", "-f", "-e", "trace=fsync,fdatasync,write", "-o", str(traced)]
    subprocess.run([*trace, sys.executable, "-c", code, str(tmp_path / "log")], cwd=ROOT, check=True)

    calls = [line for line in traced.read_text().splitlines() if "sync(" in line or "acknowledged" in line]
    acknowledged = [at for at, line in enumerate(calls) if "acknowledged" in line]
    assert len(acknowledged) == 20
    for before, at in pairwise([-1, *acknowledged]):
        assert any("sync(" in line for line in calls[before + 1 : at])


def test_the_workload_has_every_kind_of_trouble_in_it():
    frames = recording(SENSORS[0], 48, 3)
    numbers = [frame.sequence for frame in frames]
    times = [frame.time_us for frame in frames]
    steps = [b - a for a, b in pairwise(times)]
    assert len(set(numbers)) < len(numbers)  # a repeat, and a reboot that counts from 1 again
    assert numbers.count(1) == 2
    assert max(steps) > 3_000_000  # a silence
    assert min(steps) < -3_000_000_000  # a clock set back by an hour
    assert any(-1_000_000 < step < 0 for step in steps)  # a swap


def test_the_committed_result_is_of_a_hundred_cuts_and_no_row_differs():
    found = json.loads(MEASURED.read_text())

    assert found["cuts"] == len(found["runs"]) >= 100
    assert found["equal"] >= 99  # docs/operations.md tells of the other
    differences = [text for run in found["runs"] for text in run["differences"]]
    assert not any("rows" in text or "epoch" in text for text in differences)
    assert all(incident["faults"] == [] for incident in found["incidents"])
