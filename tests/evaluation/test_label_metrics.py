from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from service.evaluation.clear import clear
from service.evaluation.hota import ALPHAS, hota
from service.evaluation.identity import identity
from service.evaluation.sequence import labelled

VECTORS = Path(__file__).parents[1] / "data" / "evaluation" / "mot_vectors.json"


@pytest.fixture(scope="module")
def vectors():
    return json.loads(VECTORS.read_text())


def sequence_of(vectors, cutoff_m):
    truth, found = np.array(vectors["truth"]), np.array(vectors["hypothesis"])
    times = np.unique(truth[:, 0])
    rows = [(truth[truth[:, 0] == t], found[found[:, 0] == t]) for t in times]
    distance = [np.linalg.norm(a[:, None, 2:] - b[None, :, 2:], axis=2) for a, b in rows]
    ids = [(a[:, 1].astype(np.int64), b[:, 1].astype(np.int64)) for a, b in rows]
    return labelled([a for a, _ in ids], [b for _, b in ids], distance, cutoff_m)


def test_clear_and_identity_agree_with_py_motmetrics(vectors):
    expected = vectors["motmetrics"]
    sequence = sequence_of(vectors, 2 * vectors["d_max_m"])  # so that the threshold is not the cut-off

    mot, ids = clear(sequence, 0.5), identity(sequence, 0.5)

    assert mot.id_switches == expected["num_switches"]
    assert (mot.missed, mot.false) == (expected["num_misses"], expected["num_false_positives"])
    assert mot.matches == expected["num_matches"] + expected["num_switches"]
    for found, name in ((mot.mota, "mota"), (mot.recall, "recall"), (mot.precision, "precision")):
        assert found == pytest.approx(expected[name], abs=1e-6), name
    assert (1 - mot.motp) * 2 * vectors["d_max_m"] == pytest.approx(expected["motp"], abs=1e-6)
    assert mot.mostly_tracked * sequence.vehicle_ids == expected["mostly_tracked"]
    assert (ids.idf1, ids.precision, ids.recall) == pytest.approx(
        (expected["idf1"], expected["idp"], expected["idr"]), abs=1e-6
    )


def test_hota_agrees_with_trackeval_at_every_threshold(vectors):
    result = hota(sequence_of(vectors, vectors["d_max_m"]))

    np.testing.assert_allclose(ALPHAS, vectors["hota"]["alphas"], atol=1e-12)
    for found, name in ((result.hota, "HOTA"), (result.deta, "DetA"), (result.assa, "AssA")):
        np.testing.assert_allclose(found, vectors["hota"][name], atol=1e-6, err_msg=name)


def frames(*pairs: tuple[list, list, list]):
    """Return the sequence of frames given as (vehicles, tracks, distances in metres)."""
    columns = [
        (
            np.array(v, dtype=np.int64),
            np.array(t, dtype=np.int64),
            np.array(d, dtype=float).reshape(len(v), len(t)),
        )
        for v, t, d in pairs
    ]
    return labelled([c[0] for c in columns], [c[1] for c in columns], [c[2] for c in columns], 4.0)


def test_a_partner_is_kept_although_another_track_comes_nearer():
    sequence = frames(([1], [7], [[0.5]]), ([1], [7, 8], [[1.5, 0.1]]))

    assert clear(sequence, 0.5).id_switches == 0


def test_a_partner_out_of_reach_is_left_and_that_is_a_switch():
    sequence = frames(([1], [7], [[0.5]]), ([1], [7, 8], [[2.5, 0.1]]))

    mot = clear(sequence, 0.5)

    assert (mot.id_switches, mot.matches, mot.false) == (1, 2, 1)
    assert mot.mota == pytest.approx(1 - 2 / 2)


def test_a_switch_is_counted_after_any_gap():
    sequence = frames(([1], [7], [[0.0]]), *([([1], [], [])] * 30), ([1], [8], [[0.0]]))

    assert clear(sequence, 0.5).id_switches == 1


def test_identity_pairs_each_vehicle_with_the_track_it_was_longest_with():
    sequence = frames(*([([1], [7], [[0.0]])] * 6), *([([1], [8], [[0.0]])] * 4))

    ids = identity(sequence, 0.5)

    assert (ids.idf1, ids.precision, ids.recall) == pytest.approx((0.6, 0.6, 0.6))


def test_hota_of_a_constant_error_falls_to_zero_at_its_similarity():
    result = hota(frames(*([([1], [7], [[1.1]])] * 10)))  # similarity 0.725

    np.testing.assert_allclose(result.hota, (ALPHAS <= 0.725).astype(float))
    assert float(result.hota.mean()) == pytest.approx(14 / 19)


def test_hota_of_one_split_track():
    result = hota(frames(*([([1], [7], [[0.0]])] * 5), *([([1], [8], [[0.0]])] * 5)))

    assert float(result.assa.mean()) == pytest.approx(0.5)
    assert float(result.hota.mean()) == pytest.approx(math.sqrt(0.5))


@pytest.mark.parametrize("pairs", [([1], [], []), ([], [7], []), ([], [], [])])
def test_sequences_without_vehicles_or_tracks_score_zero(pairs):
    sequence = frames(pairs, pairs)

    assert (
        clear(sequence, 0.5).mota == identity(sequence, 0.5).idf1 == float(hota(sequence).hota.max()) == 0.0
    )
