"""`wayside track` on a simulated scene: whole results, the same twice, and sentences for what is wrong."""

from __future__ import annotations

import gzip
import json
import shutil
from pathlib import Path

import pytest

import service
from service.formats.sensor import SensorConfig


@pytest.fixture
def tracked(run, scene: Path, tmp_path: Path) -> Path:
    run("track", scene / "frames.jsonl.gz", "--site", scene / "site.json", "--out", tmp_path / "out")
    return tmp_path / "out"


def records(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_every_frame_has_a_line_and_every_track_a_summary(tracked, scene):
    frames = records_of_gzip(scene / "frames.jsonl.gz")
    lines = records(tracked / "tracks.jsonl")
    summaries = records(tracked / "track_summaries.jsonl")

    assert [(line["frame"], line["timestamp"]) for line in lines] == [
        (frame["frame"], frame["timestamp"]) for frame in frames
    ]
    seen = {state["track_id"] for line in lines for state in line["tracks"]}
    assert seen
    assert seen == {summary["track_id"] for summary in summaries}


def records_of_gzip(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in gzip.decompress(path.read_bytes()).splitlines()]


def test_the_summary_names_version_parameters_and_counts(tracked, scene):
    summary = json.loads((tracked / "summary.json").read_text())

    config = SensorConfig.model_validate_json((scene / "site.json").read_bytes())
    lines = records(tracked / "tracks.jsonl")
    assert summary["version"] == service.__version__
    assert summary["parameters_digest"] == config.tracker_parameters().digest()
    assert (summary["profile"], summary["filter"]) == ("default", "astekf")
    assert summary["frames"] == len(lines) == 120
    assert summary["states"] == sum(len(line["tracks"]) for line in lines)
    assert summary["tracks"] == len(records(tracked / "track_summaries.jsonl"))
    assert summary["start"] == lines[0]["timestamp"]
    assert summary["end"] == lines[-1]["timestamp"]


def test_the_same_frames_give_the_same_bytes(run, tracked, scene, tmp_path):
    run("track", scene / "frames.jsonl.gz", "--site", scene / "site.json", "--out", tmp_path / "again")

    for name in ("tracks.jsonl", "track_summaries.jsonl", "changes.jsonl", "lanes.json", "lanes.geojson"):
        assert (tmp_path / "again" / name).read_bytes() == (tracked / name).read_bytes()


def test_a_recording_in_two_files_is_one_recording(run, tracked, scene, tmp_path):
    lines = gzip.decompress((scene / "frames.jsonl.gz").read_bytes()).splitlines(keepends=True)
    (tmp_path / "first.jsonl").write_bytes(b"".join(lines[:50]))
    (tmp_path / "second.jsonl.gz").write_bytes(gzip.compress(b"".join(lines[50:])))

    run(
        "track", tmp_path / "first.jsonl", tmp_path / "second.jsonl.gz",
        "--site", scene / "site.json", "--out", tmp_path / "joined",
    )  # fmt: skip

    assert (tmp_path / "joined" / "tracks.jsonl").read_bytes() == (tracked / "tracks.jsonl").read_bytes()


def test_a_recording_too_short_for_a_live_map_has_lanes_in_its_crossings_and_changes(run, tmp_path):
    simulated, out = tmp_path / "dense", tmp_path / "out"
    run("simulate", "dense", "--duration", "15", "--seed", "3", "--out", simulated)

    run(
        "track", simulated / "frames.jsonl.gz", "--site", simulated / "site.json", "--out", out,
        "--set", "traffic.mapping.ready_after=400",  # frames: more than there are
    )  # fmt: skip

    lanes = json.loads((out / "lanes.json").read_text())
    crossings, changes = records(out / "crossings.jsonl"), records(out / "changes.jsonl")
    named = {lane["lane_id"] for lane in lanes["lanes"]}
    assert lanes["from_version"] == 0
    assert len(named) == 3
    assert {crossing["lane_id"] for crossing in crossings} == named
    assert {crossing["lane_map_version"] for crossing in crossings} == {1}
    assert changes
    assert {change["from_lane"] for change in changes} <= named
    by_lane = {row["lane_id"] for row in records(out / "flow.jsonl") if row["n"]}
    assert named <= by_lane
    assert json.loads((out / "summary.json").read_text())["lane_changes"] == len(changes)


def test_another_filter_is_another_set_of_parameters(run, tracked, scene, tmp_path):
    result = run(
        "track", scene / "frames.jsonl.gz", "--site", scene / "site.json", "--out", tmp_path / "ekf",
        "--profile", "fast", "--filter", "ekf", "--set", "clustering.window_frames=4", "--json",
    )  # fmt: skip

    told = json.loads(result.stdout)
    assert (told["profile"], told["filter"]) == ("fast", "ekf")
    assert (
        told["parameters_digest"] != json.loads((tracked / "summary.json").read_text())["parameters_digest"]
    )


def test_a_damaged_frame_is_named_and_nothing_is_written(run, scene, tmp_path):
    lines = gzip.decompress((scene / "frames.jsonl.gz").read_bytes()).splitlines()[:3]
    lines[1] = (
        b'{"timestamp": "2025-05-12T06:00:00.050Z", "detections": {"range_m": [-4], "azimuth_deg": [0]}}'
    )
    (tmp_path / "frames.jsonl").write_bytes(b"\n".join(lines))

    result = run(
        "track", tmp_path / "frames.jsonl", "--site", scene / "site.json", "--out", tmp_path / "out", code=2
    )

    assert "frames.jsonl, line 2: /detections/range_m/0" in result.stderr
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--filter", "kalman"], "kalman"),
        (["--set", "clustering.window=4"], "no such parameter"),
        (["--set", "filter"], "KEY=VALUE"),
        (["--set", "traffic.mapping.each_s=4"], "/traffic.mapping.each_s: no such parameter"),
    ],
)
def test_a_wrong_setting_is_a_sentence(run, scene, tmp_path, options, reason):
    result = run(
        "track", scene / "frames.jsonl.gz", "--site", scene / "site.json", "--out", tmp_path / "out",
        *options, code=2,
    )  # fmt: skip

    assert reason in result.stderr
    assert not (tmp_path / "out").exists()


def test_missing_files_are_named(run, scene, tmp_path):
    missing = tmp_path / "nowhere"
    frames, site = scene / "frames.jsonl.gz", scene / "site.json"

    assert "nowhere" in run("track", missing, "--site", site, "--out", tmp_path / "out", code=2).stderr
    assert "nowhere" in run("track", frames, "--site", missing, "--out", tmp_path / "out", code=2).stderr


def test_evaluate_scores_the_tracks_and_names_their_parameters(run, tracked, scene):
    told = json.loads(run("evaluate", tracked, "--truth", scene, "--json").stdout)
    table = run("evaluate", tracked, "--truth", scene).stdout

    summary = json.loads((tracked / "summary.json").read_text())
    assert told["parameters_digest"] == summary["parameters_digest"]
    assert 0.0 < told["results"][0]["hota"] <= 1.0
    assert "HOTA" in table
    assert summary["parameters_digest"] in table


def test_evaluate_says_what_is_missing(run, tracked, scene, tmp_path):
    shutil.copy(tracked / "summary.json", tmp_path)

    assert "tracks.jsonl" in run("evaluate", tmp_path, "--truth", scene, code=2).stderr
    run("evaluate", tracked, "--truth", tmp_path, code=2)


def test_bench_times_each_load(run):
    told = json.loads(run("bench", "--steps", "10", "--warm-up", "2", "--no-peer", "--json").stdout)

    assert [timing["load"]["vehicles"] for timing in told["timings"]] == [30, 60, 120]
    assert all(timing["median_s"] > 0 for timing in told["timings"])
    assert [stage["name"] for stage in told["timings"][0]["stages"]][-2:] == ["fold", "traffic"]
    assert told["peer"] is None
    assert told["version"] == service.__version__


def test_bench_times_a_recorded_scene(run, scene, tmp_path):
    arguments = ("bench", "--scene", scene, "--until", "1.5", "--no-peer")
    told = json.loads(run(*arguments, "--json").stdout)

    assert told["steps"] == 30
    assert told["timings"][0]["load"]["points"] > 0
    assert "existence" in run(*arguments).stdout
    assert "site.json" in run("bench", "--scene", tmp_path, code=2).stderr


def test_a_card_of_given_tracks_says_by_which_parameters(run, scene, tracked, tmp_path):
    (tmp_path / "given").mkdir()
    tracked.rename(tmp_path / "given" / scene.name)

    arguments = ("evaluate", "--card", tmp_path / "card", scene, "--tracks", tmp_path / "given")
    listed = run(*arguments, "--jobs", "1").stdout.split()

    assert [Path(name).name for name in listed] == ["accuracy.md", "accuracy.html", "accuracy.json"]
    digest = json.loads((tmp_path / "given" / scene.name / "summary.json").read_text())["parameters_digest"]
    assert digest in (tmp_path / "card" / "accuracy.md").read_text()
    assert "leave --truth out" in run(*arguments, "--truth", scene, code=2).stderr
    assert "--card OUT_DIR" in run("evaluate", scene, code=2).stderr
