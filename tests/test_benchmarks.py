"""Short cuts of the commands whose results stand in docs/measured/."""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks import counts, diagnosis, hostile, ingest  # noqa: E402
from benchmarks.process_tree import resident_mb  # noqa: E402


@pytest.mark.slow
def test_hostile_requests_break_nothing_store_nothing_and_take_no_memory():
    found = hostile.measure(1500, seed=7, connections=4, idle_tracker=True)

    assert (found["answered_5xx"], found["failures"], found["server_alive"]) == (0, [], True)
    assert found["frames_in_log"] == found["frames_called_logged"] > 0
    assert found["frames_in_log_with_wrong_values"] == 0
    assert found["growth"] < 0.25  # caches still fill in so short a run; the bar of 10 % is for the long one
    assert found["statuses"]["422"] > 500


def test_hostile_requests_are_the_same_for_the_same_seed(monkeypatch):
    monkeypatch.setattr(hostile.time, "time_ns", lambda: 1_764_000_000_000_000_000)

    def draw(seed, now_s=0.0):
        monkeypatch.setattr(hostile.time, "time", lambda: now_s)
        rng = random.Random(seed)  # noqa: S311
        return [hostile.hostile(rng) for _ in range(300)]

    assert draw(1) == draw(1, now_s=5.0)
    assert draw(1) != draw(2)
    assert len({request.kind for request in draw(1)}) > 40


@pytest.mark.slow
@pytest.mark.parametrize("batch", [1, 4])
def test_frames_posted_to_a_real_server_are_accepted_and_timed(batch):
    options = argparse.Namespace(sensors=2, rate=20.0, points=100, seconds=1.0, alone=True, batch=batch)

    found = ingest.over_http(options)

    assert set(found["statuses"]) == {202}
    assert found["frames_per_request"] == batch
    assert found["accepted_per_s"] == pytest.approx(
        batch * found["statuses"][202] / found["seconds"], rel=0.3
    )
    assert found["accepted_per_s"] > 20
    assert found["server_cpu_us_per_frame"] > 0
    assert found["reply_ms"]["p99"] > 0


@pytest.mark.slow
def test_streams_long_polls_and_an_export_are_served_beside_posts(tmp_path):
    out = tmp_path / "delivery.json"
    command = ["--sensors", "2", "--streams", "6", "--polls", "2", "--rows", "6000", "--seconds", "2"]
    subprocess.run(
        [sys.executable, ROOT / "benchmarks/delivery.py", *command, "--json", out],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip

    last = json.loads(out.read_text())["posts_readers_and_export"]
    assert set(last["statuses"]) == {"202"}
    assert last["readers"]["streams"]["slowest_reader_hz"] > 0
    assert last["readers"]["polls"]["views_per_s"] > 0
    assert last["export"]["frames"] == 200


@pytest.mark.slow
def test_the_counts_of_a_short_recording_are_held_against_exact_truth():
    whole, broken = (counts.tally(counts.make("motorway", 1, 25.0, gaps=gaps)) for gaps in (False, True))

    found = counts.volumes([whole]) | counts.events([whole])
    assert found["crossings_true"] >= 15
    assert found["recall"] >= 0.85
    assert found["precision"] >= 0.95
    assert found["lane_right"] >= 0.95
    assert abs(found["time_bias_s"]) < 0.05
    assert sum(metres for metres, _ in whole.cells.values()) > 1000
    assert len(broken.crossings) < len(whole.crossings)


def seen(tracks, points=(), merged=()):
    """Return a frame of tracks {number: (x, y, confirmed)} and points (vehicle, owner)."""
    source, owner = np.array(points, dtype=np.int64).reshape(-1, 2).T
    return diagnosis.Step(source, owner, tracks, frozenset(merged))


def held_against_truth(steps, matched, vehicle_at=((7, 0.0, 50.0), (8, 3.5, 50.0))):
    frames, n = len(steps), len(vehicle_at)
    rows = SimpleNamespace(
        start=np.arange(frames + 1) * n,
        vehicle=np.tile([v for v, _, _ in vehicle_at], frames),
        x_m=np.tile([x for _, x, _ in vehicle_at], frames),
        y_m=np.tile([y for _, _, y in vehicle_at], frames),
        heading_rad=np.zeros(frames * n),
    )
    return diagnosis.Diagnosis(SimpleNamespace(rows=rows), steps, None, None, matched, [])


ON, AWAY, ASIDE = (0.0, 50.0, True), (0.0, 62.0, True), (3.4, 50.0, True)


@pytest.mark.parametrize(
    ("last", "points", "here", "merged", "matched", "cause"),
    [
        (ON, [], {}, [], {}, "ended, the vehicle gave no points"),
        (ON, [(7, diagnosis.CLUTTER)] * 2, {}, [], {}, "ended, its points were taken for clutter"),
        (AWAY, [(7, 2)] * 2, {}, [], {}, "ended, away from the vehicle"),
        (ON, [(7, 2)] * 2, {}, [], {}, "ended, points claimed by others"),
        (ON, [(7, 1)] * 2, {}, [], {}, "ended on the vehicle"),
        (ON, [(7, 1)] * 2, {}, [1], {}, "merged into another track"),
        (ON, [(7, 1)] * 2, {1: ASIDE}, [], {8: 1}, "alive, on another vehicle"),
        (ON, [(7, 1)] * 2, {1: AWAY}, [], {}, "alive, off the vehicle"),
    ],
)
def test_a_switch_is_told_by_what_became_of_the_old_track(last, points, here, merged, matched, cause):
    steps = [seen({1: last}, points)] * 3 + [seen({**here, 2: ON}, points, merged)]

    d = held_against_truth(steps, [{7: 1}] * 3 + [{7: 2, **matched}])

    assert d.why_switched(3, 7, 2, 1) == cause


@pytest.mark.parametrize(
    ("tracks", "owner", "cause"),
    [
        ({}, diagnosis.FREE, "points free, nothing born"),
        ({}, diagnosis.CLUTTER, "points taken for clutter"),
        ({}, 5, "points claimed by others"),
        ({1: (0.0, 50.0, False)}, 1, "its track is tentative"),
        ({1: (0.5, 53.0, True)}, 1, "a track is near, but misplaced or of another"),
    ],
)
def test_a_missed_vehicle_is_told_by_what_became_of_its_points(tracks, owner, cause):
    assert held_against_truth([seen(tracks, [(7, owner)] * 2)], [{}]).why_missed(0, 7) == cause


@pytest.mark.parametrize(
    ("points", "matched", "cause"),
    [
        ([], {}, "coasts without points"),
        ([(-2, 1), (-2, 1), (7, 1)], {}, "points of ghost"),
        ([(7, 1)], {7: 2}, "points of a vehicle that has a track"),
        ([(7, 1)], {}, "displaced from its vehicle"),
    ],
)
def test_a_false_track_is_told_by_what_it_lives_on(points, matched, cause):
    assert held_against_truth([seen({1: AWAY}, points)], [matched]).why_false(0, 1) == cause


_HOLDER = """
import mmap, os, sys
own = bytearray(os.urandom(8)) * 2**20
file = mmap.mmap(os.open(sys.argv[1], os.O_RDONLY), 0, prot=mmap.PROT_READ)
touched = sum(file[at] for at in range(0, len(file), mmap.PAGESIZE))
child = os.fork() if sys.argv[2] == "fork" else 1
print(len(own), touched, flush=True)
sys.stdin.read()
"""


def test_memory_counts_a_file_once_and_is_the_same_whoever_else_maps_it(tmp_path):
    path = tmp_path / "library"
    path.write_bytes(bytes(24 * 2**20))

    def hold(file, how):
        command = [sys.executable, "-c", _HOLDER, str(file), how]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        process.stdout.readline()
        return process

    def end(process):
        process.stdin.close()
        process.wait()
        process.stdout.close()

    small = tmp_path / "small"
    small.write_bytes(bytes(4096))
    bare, alone, forked = hold(small, "alone"), hold(path, "alone"), hold(path, "fork")
    try:
        before_mb = resident_mb(alone.pid)
        other = hold(path, "alone")
        beside_mb = resident_mb(alone.pid)
        end(other)

        assert before_mb - resident_mb(bare.pid) == pytest.approx(24.0, abs=1.0)
        assert beside_mb == pytest.approx(before_mb, abs=0.5)
        assert resident_mb(forked.pid) == pytest.approx(before_mb, abs=3.0)  # the fork changes little
    finally:
        for process in (bare, alone, forked):
            end(process)
