from __future__ import annotations

import io
import json
import math

import pytest
from rich.console import Console

from service.evaluation import report
from service.evaluation.measures import MEASURES, select, with_rates

GOOD = {
    "scene": "good", "hota": 0.91, "id_switches": 0, "vehicles": 50, "ids_per_vehicle": 1.02,
    "false_tracks": 0, "track_ids": 51, "count_net_error": 0.015, "count_lane_error": 0.0,
    "lane_offset_mean_m": math.nan,
}  # fmt: skip
BAD = {
    "scene": "bad", "hota": 0.5, "id_switches": 6, "vehicles": 50, "ids_per_vehicle": 1.21, "false_tracks": 4,
    "track_ids": 50, "count_net_error": 0.03, "count_lane_error": 0.01, "lane_offset_mean_m": 0.1,
}  # fmt: skip


def test_rates_follow_from_the_scores_and_leave_them_alone():
    full = with_rates(BAD)

    assert full["switches_per_100"] == 12.0
    assert full["ghost_share"] == 0.08
    assert "ghost_share" not in BAD
    assert math.isnan(with_rates({"scene": "empty", "false_tracks": 0, "track_ids": 0})["ghost_share"])


def test_notes_name_each_missed_floor_worst_first():
    notes = report.notes([GOOD, BAD])

    assert notes == [
        "bad: switches per 100 vehicles 12.0 misses the floor of 3 by 300 %",
        "bad: share of false tracks 0.080 misses the floor of 0.02 by 300 %",
        "bad: count error of the lines 0.030 misses the floor of 0.02 by 50 %",
        "bad: tracks per vehicle 1.21 misses the floor of 1.1 by 10 %",
    ]


def test_a_verdict_tells_aim_from_floor():
    sentences = {v.measure.key: v.sentence() for v in report.verdicts([GOOD])}

    assert sentences["ids_per_vehicle"] == "good: tracks per vehicle 1.02 reaches the aim of 1.03"
    assert sentences["count_net_error"].endswith("0.015 keeps the floor of 0.02, not the aim of 0.01")
    assert "lane_offset_mean_m" not in sentences  # not measured


def test_rows_are_scenes_or_measures():
    narrow = report.by_scene([GOOD, BAD], select(["hota", "switches_per_100", "lane_offset_mean_m"]))
    long = report.by_measure([GOOD, BAD])

    assert narrow.heads == ("scene", "HOTA", "sw/100", "offset")
    assert narrow.rows == (("good", "0.910", "0.0", "-"), ("bad", "0.500", "12.0", "0.10"))
    assert long.heads == ("measure", "good", "bad", "floor", "aim")
    assert ("tracks per vehicle", "1.02", "1.21", "1.1", "1.03") in long.rows
    assert not any(row[0] == "GOSPA, m" for row in long.rows)  # nobody has it


def test_markdown_columns_are_aligned():
    text = report.markdown(report.Grid(("scene", "HOTA"), (("a", "0.910"), ("longer name", "1"))))

    assert text == (
        "| scene       |  HOTA |\n| ----------- | ----: |\n| a           | 0.910 |\n| longer name |     1 |\n"
    )


def test_the_terminal_table_shows_every_cell():
    console = Console(file=io.StringIO(), width=200)

    console.print(report.rich_table(report.by_scene([BAD], select(["hota"])), title="scores"))

    shown = console.file.getvalue()
    for word in ("scores", "scene", "HOTA", "bad", "0.500"):
        assert word in shown


def test_json_holds_scores_and_bars_and_no_nan():
    content = json.loads(report.to_json([GOOD, BAD]), parse_constant=pytest.fail)

    assert content["results"][0]["lane_offset_mean_m"] is None
    assert content["results"][1]["switches_per_100"] == 12.0
    worst = content["bars"][0]
    assert (worst["scene"], worst["measure"], worst["holds"]) == ("bad", "switches_per_100", False)


def test_every_aim_is_harder_than_its_floor():
    for measure in MEASURES:
        if measure.floor is not None and measure.aim is not None:
            assert (measure.aim > measure.floor) == measure.higher_is_better, measure.key
