"""`wayside reproduce`: every table and figure of a paper as tables, Markdown, JSON and plots."""

import json

import pytest
import typer.rich_utils

from service.evaluation.reproduce import mast

EXPECTED = {
    "astekf": (
        {f"Table {k}" for k in range(1, 5)},
        {f"Figure {k}" for k in (3, 4, 5, 7, 8, 10, 11, 12)},
    ),
    "mast-ukf": ({f"Table {k}" for k in range(1, 7)}, {f"Figure {k}" for k in (1, 2, 3, 7)}),
    "isrckf": (
        {"Tables 1, 2", "Figures 7, 8", "Figure 9 in numbers", "Figures 10, 11 in numbers"},
        {f"Figure {k}" for k in range(5, 12)},
    ),
    "hpff": ({f"Table {k}" for k in range(1, 7)}, {f"Figure {k}" for k in range(4, 8)}),
}


@pytest.mark.parametrize("paper", list(EXPECTED))
def test_every_table_and_figure_is_listed_and_written(run, tmp_path, paper, monkeypatch):
    out = tmp_path / "out"
    fewer = {key: mast.READINGS[key] for key in ("printed", "outliers")}  # the others cost time and are alike
    monkeypatch.setattr(mast, "READINGS", fewer)

    shown = run("reproduce", paper, "--runs", "3", "--out", out, "--no-progress").stdout

    written = json.loads((out / f"reproduce-{paper}.json").read_text())
    tables, figures = EXPECTED[paper]
    assert tables <= {table["number"] for table in written["tables"]}
    assert figures <= {figure["number"] for figure in written["figures"]}
    curves = json.loads((out / f"curves-{paper}.json").read_text())["figures"]
    assert any(line["y"] for figure in curves for panel in figure["panels"] for line in panel["lines"])
    assert written["holds"]
    assert written["fails"]
    markdown = (out / f"reproduce-{paper}.md").read_text()
    for number in tables | figures:
        assert f"## {number}: " in markdown
        assert f"{number}: " in shown
    assert list(out.glob(f"{paper}-figure-*.png"))
    assert json.loads((out / "reproduce.json").read_text())["papers"] == [paper]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("nobody",), "no paper 'nobody'; known are "),
        (("hpff", "--plots"), "name a folder with --out"),
    ],
)
def test_what_is_wrong_is_told_in_a_sentence(run, arguments, sentence):
    result = run("reproduce", *arguments, code=2)

    assert sentence in result.stderr


def test_help_names_the_papers_and_the_defaults(run, monkeypatch):
    monkeypatch.setattr(typer.rich_utils, "MAX_WIDTH", 200)
    text = " ".join(run("reproduce", "--help").stdout.replace("│", " ").split())

    assert "astekf, mast-ukf, isrckf, hpff; none: all four." in text
    assert "[default: by paper, 20 to 1000]" in text
    assert "[default: if matplotlib is installed]" in text
