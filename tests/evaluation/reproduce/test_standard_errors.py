"""Every sampled number of every paper says how sure it is."""

import json
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from service.evaluation.reproduce.form import Settings, median_and_error, ratio_of_rms
from service.evaluation.reproduce.mast_study import SETTLED, rms_of_mean
from service.evaluation.reproduce.papers import PAPERS

MEASURED = Path(__file__).parents[3] / "docs" / "measured"


@cache
def reproduced(name):
    return PAPERS[name].reproduce(Settings(4))


def is_error(value):
    return value is not None and math.isfinite(value) and value >= 0.0


@pytest.mark.parametrize("name", PAPERS)
def test_every_cell_has_a_standard_error_or_says_why_not(name):
    cells = [
        (f"{table.number}: {cell.row}, {cell.column}", cell)
        for table in reproduced(name).tables
        for cell in table.cells
    ]

    assert len(cells) > 50
    assert not [where for where, c in cells if c.ours is not None and not (is_error(c.error) or c.exact)]
    assert not [where for where, c in cells if c.literal is not None and not is_error(c.literal_error)]
    assert not [where for where, c in cells if c.ours is None and not (c.remark or c.exact)]


@pytest.mark.parametrize("name", PAPERS)
def test_every_published_cell_has_a_standard_error(name):
    published = json.loads((MEASURED / f"reproduce-{name}.json").read_text())

    cells = [cell for table in published["tables"] for cell in table["cells"]]

    assert len(cells) > 50
    assert all(is_error(c["std_error"]) for c in cells)
    assert all(c["literal"] is None or is_error(c["literal_std_error"]) for c in cells)


def test_heavy_clutter_is_judged_with_both_readings_of_the_likelihood():
    bars = {bar.name: bar for bar in reproduced("hpff").bars}

    for tracker in ("HPFF", "PDAF"):
        printed, corrected = (
            bars[f"M4-M6 heavy: {tracker} lost (%), eq. 15 {reading}"]
            for reading in ("as printed, |R|", "as corrected, |S|")
        )
        assert (printed.low, printed.high) == (corrected.low, corrected.high)
        assert is_error(printed.error)
        assert is_error(corrected.error)


def test_the_errors_of_ratios_medians_and_averaged_tracks_are_the_spread_over_repeated_studies():
    def study(seed):
        rng = np.random.default_rng(seed)
        shared = rng.lognormal(0.0, 0.5, 200)
        ours, theirs = shared * rng.lognormal(0.0, 0.2, 200), shared * rng.lognormal(0.0, 0.2, 200)
        tracks = 0.3 + rng.standard_normal((1, 200, 2)) * np.ones((SETTLED + 3, 1, 1))
        return ratio_of_rms(ours, theirs), median_and_error(shared), [v[0] for v in rms_of_mean(tracks)]

    for values in np.array([study(seed) for seed in range(150)]).transpose(1, 0, 2):
        assert values[:, 1].mean() == pytest.approx(values[:, 0].std(ddof=1), rel=0.15)
