"""A written scene is whole, repeatable, readable by our parser, and its truth is scored as perfect."""

from __future__ import annotations

import csv
import gzip
import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from service.evaluation.scores import score_scene
from service.formats.json_frames import read_frames
from service.formats.sensor import SensorConfig
from service.simulation.scenario import simulate
from service.simulation.scene_files import write_scene

SCORER = Path(__file__).parents[2] / ".." / "shared" / "scenes" / "score.py"
FILES = ("site.json", "frames.jsonl.gz", "truth.csv.gz", "labels.jsonl.gz", "road_truth.json")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenes") / "dense"
    summary = write_scene("dense", folder, seed=11, duration_s=6.0)
    return folder, summary


def lines(path: Path) -> list[str]:
    return gzip.decompress(path.read_bytes()).decode().splitlines()


def truth(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(lines(folder / "truth.csv.gz")))


@pytest.mark.slow
def test_equal_seeds_write_equal_bytes(scene, tmp_path):
    folder, summary = scene
    again = write_scene("dense", tmp_path / "again", seed=11, duration_s=6.0)

    assert again == summary
    for name in FILES:
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes()


def test_progress_is_told_frame_by_frame(tmp_path):
    told = []
    write_scene(
        "motorway", tmp_path, seed=1, duration_s=0.5, progress=lambda done, total: told.append((done, total))
    )

    assert told == [(k, 10) for k in (*range(1, 10), 9, 10)]  # the last only when all files are written


def test_the_site_is_a_sensor_configuration(scene):
    config = SensorConfig.model_validate_json((scene[0] / "site.json").read_bytes())

    assert config.region.range_min_m == 20.0
    assert config.region.azimuth_max_deg == 45.0
    assert [line.line_id for line in config.count_lines] == ["C40", "C80", "C120"]
    assert config.noise_std.azimuth_deg == 0.3


def test_written_frames_read_back_equal_to_the_bit(scene):
    config = SensorConfig.model_validate_json((scene[0] / "site.json").read_bytes())
    read = read_frames([scene[0] / "frames.jsonl.gz"], config)
    for ours, theirs in zip(simulate("dense", seed=11, duration_s=1.0), read, strict=False):
        assert ours.frame.time_us == theirs.time_us
        assert ours.frame.sequence == theirs.sequence
        for column in ("range_m", "azimuth_rad", "radial_velocity_mps", "snr_db"):
            assert np.array_equal(getattr(ours.frame, column), getattr(theirs, column))


def test_labels_and_truth_count_the_same_points(scene):
    counted: dict[tuple[int, int], int] = {}
    for frame, label in zip(
        lines(scene[0] / "frames.jsonl.gz"), lines(scene[0] / "labels.jsonl.gz"), strict=True
    ):
        row = json.loads(label)
        assert len(row["src"]) == len(json.loads(frame)["detections"])
        for source in row["src"]:
            counted[row["frame"], source] = counted.get((row["frame"], source), 0) + 1
    rows = truth(scene[0])

    assert len(rows) > 500
    for r in rows:
        assert int(r["n_det"]) == counted.get((int(r["frame"]), int(r["id"])), 0)


def test_truth_is_inside_its_limits_and_in_known_lanes(scene):
    road = json.loads((scene[0] / "road_truth.json").read_text())
    rows = truth(scene[0])
    ground = np.array([np.hypot(float(r["x"]), float(r["y"])) for r in rows])

    assert ground.min() > 11.9
    assert ground.max() < 160.1
    assert {r["lane"] for r in rows} <= {lane["lane_id"] for lane in road["lanes"]}
    assert {r["class"] for r in rows} <= {"car", "truck", "bus", "motorcycle"}


def test_crossings_lie_on_their_lines_and_make_up_the_counts(scene):
    road = json.loads((scene[0] / "road_truth.json").read_text())
    total: dict[str, int] = {}
    for q in road["crossings"]:
        assert q["y"] == pytest.approx(float(q["line_id"][1:]), abs=0.02)
        total[q["line_id"]] = total.get(q["line_id"], 0) + 1

    assert len(road["crossings"]) > 5
    assert {line: sum(lanes.values()) for line, lanes in road["counts"].items()} == total


@pytest.mark.slow
def test_lane_changes_name_the_lanes_before_and_after(tmp_path):
    write_scene("two_way", tmp_path, seed=3, duration_s=20.0)
    road = json.loads((tmp_path / "road_truth.json").read_text())
    lane = {(r["id"], r["time"]): r["lane"] for r in truth(tmp_path)}

    assert len(road["lane_changes"]) >= 2
    for q in road["lane_changes"]:
        assert q["t_start"] <= q["t"] <= q["t_end"]
        assert lane[str(q["id"]), q["timestamp"][11:-1]] == q["to_lane"]
        assert q["from_lane"][0] == q["to_lane"][0]


def perfect_tracks(folder: Path) -> Path:
    """Write the truth as tracks."""
    tracks = folder / "tracks.jsonl"
    with tracks.open("w") as out:
        for r in truth(folder):
            row = {"frame": int(r["frame"]), "track_id": int(r["id"])}
            out.write(json.dumps(row | {k: float(r[k]) for k in ("x", "y", "vx", "vy")}) + "\n")
    return tracks


def assert_perfect(result):
    assert result["gospa"] == pytest.approx(0.0, abs=1e-9)
    assert result["mota"] == pytest.approx(1.0)
    assert result["idf1"] == pytest.approx(1.0)
    assert result["id_switches"] == result["false_tracks"] == result["never_tracked"] == 0
    assert result["vel_rmse_mps"] == pytest.approx(0.0, abs=1e-9)
    assert result["crossing_recall"] >= 0.98
    assert result["crossing_precision"] == 1.0
    assert result["lane_right"] >= 0.98
    assert result["lanes_right"] == result["lanes_true"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["curve", "wide"])
def test_tracks_made_from_the_truth_score_as_perfect(name, tmp_path):
    write_scene(name, tmp_path, seed=5, duration_s=12.0)

    assert_perfect(score_scene(tmp_path, perfect_tracks(tmp_path), lanes=tmp_path / "road_truth.json"))


@pytest.mark.slow
@pytest.mark.skipif(not SCORER.exists(), reason="the independent scorer is not beside the repository")
@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # the scorer does not close its files
def test_an_independent_scorer_reads_the_scene_and_finds_its_crossings(tmp_path, monkeypatch):
    write_scene("two_way", tmp_path, seed=6, duration_s=12.0)
    score = load_scorer(monkeypatch)
    site, road, order, times, rows = score.read_truth(str(tmp_path))
    tracks = {f: {g[0]: g[1:5] for g in rows[f]} for f in order}
    found = score.crossings_from_tracks(site, order, times, tracks)
    result = score.score_flow(road, found, times[order[0]])
    lanes, _ = score.score_lanes(road, road)

    assert result["crossing_recall"] >= 0.98
    assert result["crossing_precision"] == 1.0
    assert result["lane_right"] >= 0.98
    assert lanes["lane_count_exact"]


def load_scorer(monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # the scorer's folder is not ours to write in
    spec = importlib.util.spec_from_file_location("scene_scorer", SCORER)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
