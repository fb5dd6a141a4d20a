"""The common form: ratios, bars, standard errors, and the same numbers in every rendering."""

import json
import math

import numpy as np
import pytest

from service.evaluation.reproduce.form import (
    Bar,
    Cell,
    Figure,
    Kind,
    Line,
    Panel,
    Reproduction,
    Table,
    mean_and_error,
    rms_over_time,
    sentences,
)
from service.evaluation.reproduce.plots import draw, file_names
from service.evaluation.reproduce.render import grid, plain, text


def example():
    ekf = Cell("EKF", "x (m)", 2.0, 3.0, 0.1, bound=1.5, remark="below the bound")
    cells, unpublished = (ekf, Cell("A", "b", None, 4.0)), Table("Table 4", "field", Kind.UNPUBLISHED)
    curve = Line("EKF", np.arange(3.0), np.array([1.0, math.nan, 2.0]))
    drawn = Figure("Figure 3", "curves", Kind.SIMULATED, (Panel("(a)", "time (s)", "m", (curve,)),))
    return Reproduction(
        paper="example",
        citation="Somebody 2020.",
        runs=10,
        seed=1,
        tables=(Table("Table 2", "errors", Kind.SIMULATED, cells, "A note."), unpublished),
        figures=(drawn, Figure("Figure 1", "photo", Kind.NO_RESULT)),
        bars=(Bar("lost (%)", 0.2, high=0.3), Bar("share", math.nan, 0.0, 1.0)),
        holds=("It holds.",),
        fails=("It fails.",),
        changed=(),
    )


def test_a_cell_has_the_ratio_of_ours_to_the_papers():
    cells = example().tables[0].cells

    assert cells[0].ratio == 1.5
    assert cells[1].ratio is None


def test_a_bar_holds_inside_its_interval_only():
    assert [bar.holds for bar in example().bars] == [True, False]


def test_a_table_shows_the_optional_columns_it_needs():
    shown = grid(example().tables[0])

    assert shown.heads == ("", "", "paper", "ours", "std error", "ratio", "bound", "remark")
    assert shown.rows[0] == ("EKF", "x (m)", "2", "3", "0.1", "1.5", "1.5", "below the bound")
    assert shown.rows[1][2] == "-"


def test_markdown_names_every_table_and_figure_and_what_cannot_be_reproduced():
    written = text(example(), {"Figure 3": "curves.png"})

    for expected in ("## Table 2", "## Table 4", "## Figure 3", "## Figure 1", "![curves](curves.png)"):
        assert expected in written
    assert "Not reproducible: data unpublished." in written
    assert "* It fails.\n" in written


def test_json_holds_no_number_that_json_does_not_know():
    value = json.loads(json.dumps(plain(example()), allow_nan=False))

    assert value["figures"][0]["panels"][0]["lines"][0]["y"] == [1.0, None, 2.0]
    assert value["tables"][0]["cells"][0]["ratio"] == 1.5
    assert value["bars"][1] == {
        "name": "share", "value": None, "std_error": None, "low": 0.0, "high": 1.0, "holds": False,
    }  # fmt: skip


def test_figures_with_panels_become_pictures(tmp_path):
    draw(example(), tmp_path)

    assert file_names(example()) == {"Figure 3": "example-figure-3.png"}
    assert (tmp_path / "example-figure-3.png").read_bytes().startswith(b"\x89PNG")


def test_standard_errors_are_those_of_independent_runs():
    samples = np.random.default_rng(1).standard_normal(10_000)
    squared = np.random.default_rng(2).standard_normal((50, 2000)) ** 2

    assert mean_and_error(samples)[1] == pytest.approx(0.01, rel=0.05)
    value, error = rms_over_time(squared)
    # the RMSE of n normal errors has the standard error sigma / sqrt(2 n); 50 independent instants
    assert value == pytest.approx(1.0, abs=5 * error)
    assert error == pytest.approx(1.0 / math.sqrt(2 * 2000 * 50), rel=0.1)


def test_sentences_are_the_paragraphs_of_a_text():
    assert sentences("\nOne\nline.\n\nTwo.\n") == ("One line.", "Two.")
