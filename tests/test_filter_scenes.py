"""The page of filters on scenes: what is written where, and which filters it recommends."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.filter_scenes import BEGIN, END, advice, page, put, ranked  # noqa: E402


def row(scene, name, hota, speed, us):
    return {
        "scene": scene, "filter": name, "hota": hota, "gospa": 2.0, "vel_rmse_mps": speed, "filter_us": us,
    }  # fmt: skip


ROWS = (
    row("curve", "astekf", 0.890, 1.2, 20.0),
    row("curve", "ekf", 0.884, 1.3, 10.0),
    row("curve", "imm", 0.850, 0.5, 200.0),
    row("wide", "astekf", 0.80, 0.4, 20.0),
    row("wide", "ekf", 0.85, 0.6, 10.0),
    row("wide", "imm", 0.85, 0.5, 200.0),
)


def test_the_best_of_a_scene_is_bold_and_the_best_on_average_comes_first():
    text = page(ROWS, None)

    assert ranked(ROWS) == ["ekf", "imm", "astekf"]
    assert "| `astekf` | **0.890** |     0.800 | 0.845 |" in text
    assert "| `ekf`    |     0.884 | **0.850** | 0.867 |" in text
    assert "whole scenes" in text
    assert "first 40 s of the scenes" in page(ROWS, 40.0)


def test_a_site_gets_the_best_filter_and_those_that_are_as_good():
    assert advice(ROWS).rows == (
        ("free-flowing roads", "`ekf` 0.850", "`imm` 0.850", "`imm` 0.50 m/s", "`ekf` 10 us"),
        ("curves", "`astekf` 0.890", "`ekf` 0.884", "`astekf` 1.20 m/s", "`ekf` 10 us"),  # imm is not as good
    )


def test_the_tables_replace_those_between_the_marks_and_nothing_else(tmp_path):
    path = tmp_path / "page.md"
    path.write_text(f"before\n\n{BEGIN}\n\nold\n{END}\n\nafter\n")

    put(path, "new\n")
    put(path, "newer\n")

    assert path.read_text() == f"before\n\n{BEGIN}\n\nnewer\n\n{END}\n\nafter\n"
    path.write_text("no marks")
    with pytest.raises(SystemExit, match="once each"):
        put(path, "new\n")
    assert (ROOT / "docs" / "papers.md").read_text().count(BEGIN) == 1
