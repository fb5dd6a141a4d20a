"""`wayside compare`: the numbers of `evaluate`, for several filters, with consistency and time."""

import itertools
import json
import math

import numpy as np
import pytest

from service.evaluation.compare import WARM_UP_FRAMES, Watched, compare, mean_nees, with_means
from service.evaluation.compare_plot import draw
from service.evaluation.kinematics import Matches
from service.evaluation.recorded import record
from service.evaluation.reproduce.plots import can_draw
from service.tracking.filters.registry import make_filter
from service.tracking.measurement import predict_measurement

SHARED = ("hota", "gospa", "pos_rmse_m", "vel_rmse_mps", "id_switches", "never_tracked")


def test_each_filter_is_scored_as_track_and_evaluate_score_it(run, scene, tmp_path):
    found = json.loads(run("compare", scene, "--filters", "ekf,imm", "--json").stdout)

    assert [r["filter"] for r in found["results"]] == ["ekf", "imm"]
    for result in found["results"]:
        out = tmp_path / result["filter"]
        run("track", scene / "frames.jsonl.gz", "--site", scene / "site.json", "--filter", result["filter"],
            "--out", out)  # fmt: skip
        alone = json.loads(run("evaluate", out, "--truth", scene, "--json").stdout)["results"][0]
        for key in SHARED:  # tracks.jsonl is rounded to the millimetre
            assert result[key] == pytest.approx(alone[key], abs=2e-3), key
        assert result["step_ms"] > 0.0
        assert result["filter_us"] > 0.0
        assert 0.05 < result["nis"] < 3.0
        assert math.isfinite(result["nees"])


def test_what_is_loaded_when_a_filter_is_first_used_is_not_timed(scene):
    slow = itertools.chain(np.arange(2.0 * WARM_UP_FRAMES), itertools.count(2.0 * WARM_UP_FRAMES, 1e-6))

    result = compare(
        [scene], ["ekf"], settings={}, until=4.0, clock=lambda: float(next(slow)), advance=lambda _: None
    )[0]

    assert 0.0 < result["step_ms"] < 1.0  # the first calls of the clock are a second apart
    assert 0.0 < result["filter_us"] < 10.0


def test_table_json_and_plot_are_written(run, scene, tmp_path):
    shown = run("compare", scene, scene, "--filters", "ekf", "--until", "4", "--out", tmp_path / "out").stdout

    table = (tmp_path / "out" / "compare.md").read_text()
    assert "us/track" in shown
    assert table.startswith("| recording | filter | ")
    assert len(json.loads((tmp_path / "out" / "compare.json").read_text())["results"]) == 2
    assert (tmp_path / "out" / "compare.svg").exists() == can_draw()


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--filters", "ekf,kalman"), "known are ast-ukf, astekf"),
        (("--filters", "ekf,ekf"), "names a filter twice"),
        (("--set", "filters.ekf.nothing=1"), "no such parameter"),
        (("--until", "4", "--set", "nonsense"), "wants KEY=VALUE"),
    ],
)
def test_a_wrong_choice_is_a_sentence(run, scene, options, reason):
    result = run("compare", scene, *options, code=2)

    assert reason in result.output


def test_a_folder_without_truth_is_named(run, tmp_path):
    assert "site.json" in run("compare", tmp_path, "--filters", "ekf", code=2).output


def test_several_recordings_are_followed_by_their_mean():
    row = {"filter": "ekf", "hota": 0.5, "nees": 1.0}
    rows = with_means([{"scene": "a", **row}, {"scene": "b", **row, "hota": 0.7}])

    assert [r["scene"] for r in rows] == ["a", "b", "mean"]
    assert rows[2]["hota"] == pytest.approx(0.6)
    assert with_means([{"scene": "a", **row}]) == [{"scene": "a", **row}]


def test_watching_changes_nothing_and_keeps_the_innovations_that_are_sure():
    rng = np.random.default_rng(1)
    plain = make_filter("ukf")
    watched = Watched(plain, clock=lambda: 0.0)
    mean = rng.normal([-5, 0, 0, 90, -12, 0], [4, 1, 0, 25, 4, 0], (3, 6))
    state = watched.start(mean, np.broadcast_to(np.eye(6), (3, 6, 6)))
    prediction = watched.predict(state, 0.05)
    expected = watched.expected(prediction)
    z = predict_measurement(prediction.mean)[:, None] + [[0.3, 0.001, 0.1]]
    z[1, 0, 2] = np.nan
    R = np.broadcast_to(np.diag([0.1, 1e-5, 0.01]), (3, 1, 3, 3))
    scan = z, R, np.array([[0.9], [0.8], [0.2]]), np.array([0.1, 0.2, 0.8])

    ours, theirs = watched.update(prediction, *scan), plain.update(prediction, *scan)

    np.testing.assert_array_equal(ours.mean, theirs.mean)
    (nis,) = watched.nis
    e = z[0, 0] - expected.z_hat[0]
    assert nis[0] == pytest.approx(e @ np.linalg.solve(expected.S_prior[0] + R[0, 0], e) / 3)
    e, S = (z[1, 0] - expected.z_hat[1])[:2], (expected.S_prior[1] + R[1, 0])[:2, :2]
    assert nis[1] == pytest.approx(e @ np.linalg.solve(S, e) / 2)
    assert len(nis) == 2
    assert (watched.name, watched.memory_size, watched.track_steps) == ("ukf", 1, 3)


def test_the_normalised_error_of_a_known_error_is_known():
    class Rows:
        x_m, y_m, vx_mps, vy_mps = (np.array([v]) for v in (1.0, 2.0, 3.0, 4.0))

    class Scene:
        rows = Rows

    tracks = record([{7: (3.0, 2.0, 3.0, 4.0)}])
    pairs = Matches(*(np.zeros(1, np.int64) for _ in range(3)), np.array([2.0]), 0)

    assert mean_nees(Scene, tracks, np.diag([4.0, 1, 1, 1])[None], pairs) == pytest.approx(0.25)
    none = Matches(*(np.zeros(0, np.int64) for _ in range(3)), np.zeros(0), 0)
    assert math.isnan(mean_nees(Scene, tracks, np.zeros((0, 4, 4)), none))


@pytest.mark.skipif(not can_draw(), reason="matplotlib, an extra, is not installed")
def test_equal_results_give_equal_plots(tmp_path):
    row = {"vel_rmse_mps": 0.3, "pos_rmse_m": 0.4, "hota": 0.9}
    rows = [{"scene": s, "filter": f, **row} for s in "ab" for f in ("ekf", "imm")]

    for name in ("one.svg", "two.svg"):
        draw(rows, tmp_path / name)

    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
    assert "imm" in (tmp_path / "one.svg").read_text()
