"""A short cut of `wayside chaos`; its model of the disk catches a log that acknowledges too soon."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import pytest

from service.chaos import child, process
from service.chaos.cut import Kind, Phase, Plan
from service.chaos.disk import available
from service.chaos.evidence import Evidence
from service.chaos.suite import Reference, Suite, run
from service.chaos.workload import SENSORS, batches, recording
from service.pipeline.sqlite_log import LogLimits, SqliteLog
from service.warmup import warm_up

ROOT = Path(__file__).resolve().parents[2]
MEASURED = ROOT / "docs" / "measured" / "chaos.json"


@pytest.mark.slow
def test_a_host_that_is_cut_anywhere_ends_as_if_it_had_not_been():
    command = [sys.executable, "-m", "service.cli.main", "chaos", "--cuts", "7", "--frames", "48", "--json"]

    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)

    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout)
    assert (found["cuts"], found["equal"]) == (7, 7)
    assert [index for index, run in enumerate(found["runs"]) if run["tracker_processes"]] == [2, 5]
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


def test_every_third_cut_is_made_where_trackers_are_processes():
    reference = Reference([], Evidence({}, {}, {}, {}), [], dict.fromkeys(Phase, 50))
    plans = Suite(1).plans(99, reference)

    of_processes = [plan for plan in plans if plan.processes]
    assert len(of_processes) == 33
    assert {(plan.kind, plan.processes) for plan in of_processes} == {
        (kind, count) for kind in (Kind.GROUP, Kind.TRACKER) for count in (1, 2)
    }
    assert {plan.phase for plan in of_processes} == set(Phase) - {Phase.MIGRATION}
    assert {plan.kind for plan in plans if not plan.processes} == {Kind.KILL, Kind.POWER, Kind.TORN}
    assert plans == Suite(1).plans(99, reference)


@pytest.mark.slow
@pytest.mark.parametrize("phase", [Phase.FLUSH, Phase.BATCH])
def test_a_cut_ends_all_processes_or_one_tracker_alone(tmp_path, phase):
    warm_up(lambda *_: None)
    work = batches(48, 1)
    plan = Plan(phase, 3, 1, Kind.TRACKER, 7, processes=2)
    ended = run(tmp_path / "one", work, 0, plan)
    assert (ended.killed, ended.code) == (False, 0)
    assert ended.said[-1]["cut"]
    assert sum("batch" in message for message in ended.said) == len(work)

    running = process.start(
        lambda say: child.post(
            say, tmp_path / "all", work, 0, plan=dataclasses.replace(plan, kind=Kind.GROUP), processes=2
        )
    )
    assert running.end().killed
    deadline_s = time.monotonic() + 10
    while time.monotonic() < deadline_s:
        try:
            os.killpg(running.pid, 0)
        except ProcessLookupError:
            break
        time.sleep(0.01)
    else:
        pytest.fail("a process of the group lives on")


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
    kinds = [run["kind"] for run in found["runs"] if run["tracker_processes"]]
    assert len(kinds) >= 33
    assert set(kinds) == {Kind.GROUP, Kind.TRACKER}
    assert all(incident["faults"] == [] for incident in found["incidents"])
