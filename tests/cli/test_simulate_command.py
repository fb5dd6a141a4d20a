"""`wayside simulate` writes a scene that the other commands read."""

from __future__ import annotations

import json

import service


def test_a_scene_is_written_with_its_summary(run, tmp_path):
    result = run(
        "simulate", "motorway", "--out", tmp_path / "scene", "--duration", "2", "--seed", "5", "--json"
    )

    told = json.loads(result.stdout)
    written = json.loads((tmp_path / "scene" / "summary.json").read_text())
    assert (told["version"], told["seed"], told["frames"]) == (service.__version__, 5, 40)
    assert told == written | {"out": str(tmp_path / "scene")}
    assert {path.name for path in (tmp_path / "scene").iterdir()} == {
        "site.json",
        "frames.jsonl.gz",
        "labels.jsonl.gz",
        "truth.csv.gz",
        "road_truth.json",
        "summary.json",
    }


def test_equal_seeds_give_equal_files(run, tmp_path):
    for name in ("a", "b"):
        run("simulate", "motorway", "--out", tmp_path / name, "--duration", "1")

    first, second = ((tmp_path / name / "frames.jsonl.gz").read_bytes() for name in ("a", "b"))
    assert first == second


def test_an_unknown_scenario_is_a_sentence_that_names_the_known(run, tmp_path):
    result = run("simulate", "rush_hour", "--out", tmp_path / "scene", code=2)

    assert "motorway" in result.stderr
    assert not (tmp_path / "scene").exists()


def test_progress_goes_to_standard_error_and_only_when_wanted(run, tmp_path):
    quiet = run("simulate", "motorway", "--out", tmp_path / "scene", "--duration", "1", "--json")
    shown = run(
        "simulate", "motorway", "--out", tmp_path / "scene", "--duration", "1", "--json", "--progress"
    )

    assert quiet.stderr == ""
    assert "20/20" in shown.stderr
    assert json.loads(shown.stdout) == json.loads(quiet.stdout)
