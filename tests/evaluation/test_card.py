from __future__ import annotations

import dataclasses
import math
from xml.etree import ElementTree as ET

import pytest

from service.errors import InvalidInput
from service.evaluation import card, plots, scene_runs
from service.evaluation.card import Card
from service.evaluation.meanings import MEANINGS
from service.evaluation.measures import MEASURES, SPEED
from service.simulation.scene_files import write_scene

RESULTS = (
    {"scene": "ring <1>", "hota": 0.9, "gospa": 1.5, "id_switches": 2, "vehicles": 50, "false_tracks": 3,
     "track_ids": 60, "ms_p99": 2.5, "lane_offset_mean_m": math.nan},
    {"scene": "pass", "hota": 0.8, "gospa": 2.5, "id_switches": 0, "vehicles": 40, "false_tracks": 0,
     "track_ids": 40, "ms_p99": 3.5, "lane_offset_mean_m": math.nan},
)  # fmt: skip
EXAMPLE = Card(RESULTS, {"version": "1.2.3", "parameters_digest": "0123456789ab", "profile": "default"})


def test_every_measure_has_a_meaning():
    assert set(MEANINGS) == {measure.key for measure in (*MEASURES, *SPEED)}


def test_the_summary_names_the_worst_scene_whichever_way_is_better():
    rows = {row[0]: row[1:] for row in card.summary(EXAMPLE).rows}

    assert rows["HOTA"] == ("0.850", "0.900", "0.800", "pass")
    assert rows["GOSPA, m"] == ("2.00", "1.50", "2.50", "pass")
    assert rows["switches per 100 vehicles"] == ("2.0", "0.0", "4.0", "ring <1>")
    assert rows["CPU ms, 99th percentile"] == ("3.00", "2.50", "3.50", "pass")
    assert "lane offset, mean, m" not in rows


def test_the_files_hold_every_measure_and_what_made_them(tmp_path):
    written = {path.name: path.read_text() for path in card.write(EXAMPLE, tmp_path / "out")}

    for text in (written["accuracy.md"], written["accuracy.html"]):
        for part in ("0123456789ab", "1.2.3", "HOTA", "share of false tracks", "misses the floor of 0.02"):
            assert part in text
    for file in ("hota.svg", "gospa.svg"):
        assert f"(plots/{file})" in written["accuracy.md"]
        assert (tmp_path / "out" / "plots" / file).is_file()
    page = written["accuracy.html"]
    assert "ring &lt;1&gt;" in page
    assert "ring <1>" not in page
    assert "http://" not in page.replace("http://www.w3.org/2000/svg", "")  # needs nothing from elsewhere


def test_bars_are_as_long_as_their_values_and_leave_out_what_is_not_known():
    picture = ET.fromstring(plots.bars("A < B", ["a", "b", "c"], [1.0, 2.0, math.nan], decimals=1, bar=1.5))  # noqa: S314 - our own
    space = "{http://www.w3.org/2000/svg}"
    first, second = (float(bar.get("width")) for bar in picture.iter(f"{space}rect"))

    assert second == pytest.approx(2 * first, abs=0.1)  # rounded to a tenth of a pixel
    assert [text.text for text in picture.iter(f"{space}text")] == ["A < B", "a", "1.0", "b", "2.0", "c", "-"]
    assert len(list(picture.iter(f"{space}path"))) == 1


@pytest.mark.slow
def test_a_scene_is_tracked_and_scored_and_its_configuration_named(tmp_path):
    write_scene("motorway", tmp_path / "scene", seed=3, duration_s=6.0)
    job = scene_runs.Job(tmp_path / "scene", until_s=5.0)
    other = dataclasses.replace(job, settings=("clustering.min_points=4",))

    (plain, changed) = scene_runs.run_all([job, other])

    assert plain["hota"] > 0.5
    assert plain["ms_p99"] >= plain["ms_per_frame"] > 0.0
    assert plain["parameters"] != changed["parameters"]


def test_a_folder_without_a_scene_is_refused(tmp_path):
    with pytest.raises(InvalidInput):
        scene_runs.run(scene_runs.Job(tmp_path))
