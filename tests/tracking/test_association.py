"""The exact recursion against plain enumeration, and what holds for all association probabilities."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.errors import InvalidInput
from service.tracking.association import Marginals, assign_maximum, marginals

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = ROOT / ".." / "shared" / "data" / "reference_vectors" / "jpda.json"


def _load_scenes() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "association_scenes", ROOT / "benchmarks" / "association_scenes.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


scenes = _load_scenes()


def enumerate_hypotheses(log_weight, log_miss, temper=1.0):
    """Every joint hypothesis one by one, in the order of the tracks; the slow and obvious way."""
    tracks, measurements = log_weight.shape
    gate = np.isfinite(log_weight)
    shares = (gate & (gate.sum(axis=0) > 1)).any(axis=1)
    power = np.where(shares, temper, 1.0)  # a track on its own is not tempered
    log_weight, log_miss = log_weight * power[:, None], log_miss * power
    hypotheses: list[tuple[float, list[int]]] = []

    def choose(track: int, used: set[int], log_total: float, choice: list[int]) -> None:
        if track == tracks:
            hypotheses.append((log_total, choice))
            return
        choose(track + 1, used, log_total + log_miss[track], [*choice, -1])
        for j in range(measurements):
            if j not in used and log_weight[track, j] > -np.inf:
                choose(track + 1, used | {j}, log_total + log_weight[track, j], [*choice, j])

    choose(0, set(), 0.0, [])
    log_totals = np.array([log_total for log_total, _ in hypotheses])
    weight = np.exp(log_totals - log_totals.max())
    choices = np.array([choice for _, choice in hypotheses])
    table = np.zeros((tracks, measurements + 1))  # the last column, index -1, is the miss
    for track in range(tracks):
        np.add.at(table[track], choices[:, track], weight)
    return table / weight.sum()


def table(result: Marginals):
    return np.column_stack([result.beta, result.miss])


def random_cluster(rng, tracks, measurements, *, density, log_span):
    """Random log weights; gates are open with probability `density`."""
    log_weight = rng.uniform(-log_span, log_span, (tracks, measurements))
    log_weight[rng.random((tracks, measurements)) > density] = -np.inf
    return log_weight, rng.uniform(-log_span, 0.0, tracks)


def log_hypotheses(log_weight):
    return np.log1p(np.isfinite(log_weight).sum(axis=1)).sum()


def some_clusters(rng, count, *, most_tracks, most_hypotheses):
    """Clusters of all densities, sizes and spans of weight, as long as they can be enumerated."""
    found = 0
    while found < count:
        cluster = random_cluster(
            rng,
            int(rng.integers(1, most_tracks + 1)),
            int(rng.integers(0, most_tracks + 4)),
            density=rng.choice([0.15, 0.3, 0.6, 1.0]),
            log_span=rng.choice([0.5, 5.0, 50.0, 700.0, 5000.0]),
        )
        if log_hypotheses(cluster[0]) <= np.log(most_hypotheses):
            found += 1
            yield cluster


def assert_equals_enumeration(log_weight, log_miss, temper=1.0, *, atol=1e-12):
    result = marginals(log_weight, log_miss, temper=temper)

    assert result.approximated == 0
    np.testing.assert_allclose(
        table(result), enumerate_hypotheses(log_weight, log_miss, temper), rtol=0, atol=atol
    )


def test_the_marginals_equal_enumeration():
    # Weights of up to e^5000 leave 5000 * 2^-52 = 1e-12 of relative rounding in each logarithm.
    rng = np.random.default_rng(1)

    for log_weight, log_miss in some_clusters(rng, 60, most_tracks=5, most_hypotheses=400):
        span = max(1.0, np.abs(log_miss).max())
        assert_equals_enumeration(log_weight, log_miss, atol=max(1e-12, 8 * span * 2.0**-52))


@pytest.mark.slow
def test_the_marginals_of_a_thousand_clusters_up_to_eight_tracks_equal_enumeration():
    rng = np.random.default_rng(2)

    for number in range(1000):
        while True:
            cluster = random_cluster(
                rng,
                int(rng.integers(2, 9)),
                int(rng.integers(1, 12)),
                density=rng.choice([0.2, 0.35, 0.6]),
                log_span=rng.choice([1.0, 5.0, 30.0]),
            )
            if log_hypotheses(cluster[0]) <= np.log(8000):
                break
        assert_equals_enumeration(*cluster, temper=[1.0, 1.5, 2.0][number % 3] if number % 2 else 1.0)


def test_rows_sum_to_one_and_columns_to_at_most_one():
    rng = np.random.default_rng(3)

    for log_weight, log_miss in some_clusters(rng, 200, most_tracks=12, most_hypotheses=np.inf):
        result = marginals(log_weight, log_miss)

        np.testing.assert_allclose(table(result).sum(axis=1), 1.0, rtol=0, atol=1e-12)
        assert (result.beta.sum(axis=0) <= 1.0 + 1e-9).all()  # 1e-9: weights of e^5000 round to 1e-12 each
        assert (result.beta[~np.isfinite(log_weight)] == 0.0).all()
        assert (table(result) >= 0.0).all()


@pytest.mark.parametrize("tracks", [16, 32])
def test_reversed_order_of_the_tracks_gives_the_same(tracks):
    rng = np.random.default_rng(4)

    for clutter_per_m2 in (2e-3, 2e-2):
        for _ in range(5):
            log_weight, log_miss = scenes.queue(rng, tracks, clutter_per_m2=clutter_per_m2)

            forward = marginals(log_weight, log_miss)
            backward = marginals(log_weight[::-1], log_miss[::-1])

            assert forward.approximated == 0
            np.testing.assert_allclose(forward.beta, backward.beta[::-1], rtol=0, atol=1e-10)
            np.testing.assert_allclose(forward.miss, backward.miss[::-1], rtol=0, atol=1e-10)


@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, 2.0]))
@settings(max_examples=60, deadline=None)
def test_the_order_of_tracks_and_measurements_does_not_matter(seed, temper):
    rng = np.random.default_rng(seed)
    log_weight, log_miss = random_cluster(rng, 6, 7, density=0.4, log_span=8.0)
    rows, columns = rng.permutation(6), rng.permutation(7)

    result = marginals(log_weight, log_miss, temper=temper)
    shuffled = marginals(log_weight[np.ix_(rows, columns)], log_miss[rows], temper=temper)

    np.testing.assert_allclose(shuffled.beta, result.beta[np.ix_(rows, columns)], rtol=0, atol=1e-12)
    np.testing.assert_allclose(shuffled.miss, result.miss[rows], rtol=0, atol=1e-12)


def test_a_factor_on_a_whole_row_changes_nothing():
    rng = np.random.default_rng(5)
    log_weight, log_miss = random_cluster(rng, 5, 6, density=0.7, log_span=4.0)
    shift = np.array([-800.0, 300.0, 0.0, 2000.0, -1e4])

    result = marginals(log_weight, log_miss)
    shifted = marginals(log_weight + shift[:, None], log_miss + shift)

    np.testing.assert_allclose(table(shifted), table(result), rtol=0, atol=1e-11)  # 1e4 rounds to 2e-12


def test_two_tracks_that_both_insist_on_one_measurement_share_it():
    # Either takes it at e^2000 to one: with rows scaled to their maximum every hypothesis weighs 0.
    result = marginals(np.array([[2000.0], [2000.0]]), np.zeros(2))

    np.testing.assert_allclose(table(result), [[0.5, 0.5], [0.5, 0.5]], rtol=0, atol=1e-12)


def test_a_chain_of_32_tracks_stays_exact():
    # Track k sees measurements k and k + 1: small enough for a transfer matrix over "k's second one is used".
    rng = np.random.default_rng(6)
    log_weight = np.full((32, 33), -np.inf)
    for k in range(32):
        log_weight[k, k : k + 2] = rng.normal(0.0, 3.0, 2)
    log_miss = rng.normal(0.0, 1.0, 32)

    def total(log_weight):
        vector = np.array([1.0, 0.0])
        for k in range(32):
            stay, left, right = np.exp([log_miss[k], log_weight[k, k], log_weight[k, k + 1]])
            vector = np.array([vector.sum() * stay + vector[0] * left, vector.sum() * right])
        return vector.sum()

    result = marginals(log_weight, log_miss)

    assert (result.components, result.approximated) == (1, 0)
    for k in (0, 7, 31):
        for j in (k, k + 1):
            without = log_weight.copy()
            without[k, j] = -np.inf
            assert result.beta[k, j] == pytest.approx(1.0 - total(without) / total(log_weight), abs=1e-12)


def test_a_component_that_is_too_wide_is_approximated_and_counted():
    rng = np.random.default_rng(7)
    log_weight, log_miss = random_cluster(rng, 24, 24, density=1.0, log_span=3.0)

    result = marginals(log_weight, log_miss)

    assert (result.components, result.approximated) == (1, 1)
    np.testing.assert_allclose(table(result).sum(axis=1), 1.0, rtol=0, atol=1e-12)
    assert (result.beta.sum(axis=0) <= 1.0 + 1e-3).all()


def test_only_the_component_that_is_too_wide_is_approximated():
    log_weight = np.full((5, 4), -np.inf)
    log_weight[:2, 0] = 1.0
    log_weight[2:4, 1:3] = 1.0

    result = marginals(log_weight, np.zeros(5), max_width=1)

    assert result.component.tolist() == [0, 0, 1, 1, 2]
    assert (result.components, result.approximated) == (3, 1)
    np.testing.assert_allclose(result.beta[:2, 0], np.e / (1 + 2 * np.e), rtol=0, atol=1e-15)


@pytest.mark.parametrize(("clutter_per_m2", "detection", "bound"), [(2e-3, 0.9, 0.35), (2e-2, 0.7, 0.10)])
def test_belief_propagation_stays_near_the_exact_marginals(clutter_per_m2, detection, bound, record_property):
    rng = np.random.default_rng(8)
    worst = 0.0
    for tracks in (2, 4, 8, 16):
        for _ in range(10):
            cluster = scenes.queue(rng, tracks, detection=detection, clutter_per_m2=clutter_per_m2)
            exact, approximate = marginals(*cluster), marginals(*cluster, max_width=0)
            assert (exact.approximated, approximate.approximated) == (0, 1)
            worst = max(worst, np.abs(table(exact) - table(approximate)).max())
    record_property("worst_error", float(worst))

    assert worst <= bound


def test_belief_propagation_is_exact_on_a_tree():
    log_weight = np.full((4, 3), -np.inf)
    log_weight[[0, 1, 1, 2, 2, 3], [0, 0, 1, 1, 2, 2]] = [1.0, 2.0, 0.5, 1.5, -1.0, 0.7]
    log_miss = np.array([-2.0, -1.0, 0.0, -3.0])

    result = marginals(log_weight, log_miss, max_width=0)

    np.testing.assert_allclose(table(result), enumerate_hypotheses(log_weight, log_miss), rtol=0, atol=1e-5)


def test_queues_of_32_tracks_need_no_approximation():
    rng = np.random.default_rng(9)

    for clutter_per_m2 in (2e-3, 2e-2):
        for _ in range(5):
            assert marginals(*scenes.queue(rng, 32, clutter_per_m2=clutter_per_m2)).approximated == 0


@pytest.mark.parametrize(("tracks", "measurements"), [(0, 0), (0, 3), (3, 0), (3, 4)])
@pytest.mark.parametrize("associate", [marginals, assign_maximum])
def test_tracks_without_a_measurement_in_their_gates_miss(associate, tracks, measurements):
    result = associate(np.full((tracks, measurements), -np.inf), np.full(tracks, -2.0))

    assert result.beta.shape == (tracks, measurements)
    assert not result.beta.any()
    assert (result.miss == 1.0).all()
    assert result.components == tracks
    assert result.component.tolist() == list(range(tracks))


def test_a_lone_track_has_the_weights_as_odds_and_is_not_tempered():
    log_weight = np.log([[3.0, 1.0, 0.5]])

    result = marginals(log_weight, np.log([0.5]), temper=2.0)

    np.testing.assert_allclose(table(result), [[0.6, 0.2, 0.1, 0.1]], rtol=0, atol=1e-15)


def test_tempering_sharpens_the_competition():
    log_weight, log_miss = np.log([[9.0, 3.0], [3.0, 9.0]]), np.log([0.1, 0.1])

    plain, sharp = (marginals(log_weight, log_miss, temper=t) for t in (1.0, 2.0))

    np.testing.assert_allclose(
        table(sharp), enumerate_hypotheses(log_weight, log_miss, 2.0), rtol=0, atol=1e-15
    )
    assert sharp.beta[0, 0] > plain.beta[0, 0]


def test_the_reference_vectors_of_other_programs_agree():
    if not REFERENCE.exists():
        pytest.skip("reference vectors are not beside the repository")
    reference = json.loads(REFERENCE.read_text())

    for case in reference["cases"]:
        matrix, tracks = np.array(case["likelihood_ratio_matrix"]), len(case["tracks"])
        weight = matrix[:, :-tracks]
        log_weight = np.log(weight, out=np.full(weight.shape, -np.inf), where=weight > 0)

        result = marginals(log_weight, np.log(np.diag(matrix[:, -tracks:])))

        np.testing.assert_allclose(table(result), case["beta_nrl_permanent"], rtol=0, atol=1e-11)


def test_assign_maximum_takes_the_best_hypothesis():
    rng = np.random.default_rng(10)

    for log_weight, log_miss in some_clusters(rng, 60, most_tracks=5, most_hypotheses=400):
        best = enumerate_hypotheses(log_weight, log_miss, temper=1e6)  # all the weight on one hypothesis
        lone = marginals(log_weight, log_miss).component
        result = assign_maximum(log_weight, log_miss)

        competing = np.bincount(lone)[lone] > 1  # the enumeration does not temper lone tracks
        np.testing.assert_array_equal(table(result)[competing], np.rint(best[competing]))
        options = np.column_stack([log_weight, log_miss])[~competing]
        np.testing.assert_array_equal(table(result)[~competing].argmax(axis=1), options.argmax(axis=1))


@pytest.mark.parametrize("associate", [marginals, assign_maximum])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_weights_that_are_not_numbers_are_refused(associate, bad):
    with pytest.raises(InvalidInput, match="log_weight"):
        associate(np.array([[0.0, bad]]), np.zeros(1))
    with pytest.raises(InvalidInput, match="log_miss"):
        associate(np.zeros((1, 2)), np.array([bad]))


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(InvalidInput, match=r"\(2, 3\) and \(3,\)"):
        marginals(np.zeros((2, 3)), np.zeros(3))


@pytest.mark.parametrize(
    "options", [{"temper": 0.0}, {"temper": np.nan}, {"max_width": -1}, {"max_width": 60}]
)
def test_options_out_of_range_are_refused(options):
    with pytest.raises(InvalidInput, match="want"):
        marginals(np.zeros((1, 1)), np.zeros(1), **options)
