from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest

from service.evaluation.distance import near_face_centres, segment_distances
from service.evaluation.gospa import gospa, ospa

VECTORS = Path(__file__).parents[1] / "data" / "evaluation" / "gospa_vectors.json"


def between(a, b):
    return np.linalg.norm(np.array(a)[:, None] - np.array(b)[None, :], axis=2)


@pytest.mark.parametrize(
    "case", json.loads(VECTORS.read_text())["cases"], ids=lambda c: f"c{c['c']:g}p{c['p']}"
)
def test_gospa_and_ospa_agree_with_stone_soup(case):
    distance = between(case["truth"], case["estimates"])
    c, p = case["c"], case["p"]

    parts, cardinal = gospa(distance, c, p), ospa(distance, c, p)

    # 2e-6: the vectors' points are rounded to a millimetre, their results to nine decimals
    assert parts.distance_m == pytest.approx(case["gospa"]["distance"], abs=2e-6)
    assert parts.localisation == pytest.approx(case["gospa"]["localisation"], abs=2e-6)
    assert parts.missed * c**p / 2 == pytest.approx(case["gospa"]["missed"], abs=2e-6)
    assert parts.false * c**p / 2 == pytest.approx(case["gospa"]["false"], abs=2e-6)
    assert cardinal.distance_m == pytest.approx(case["ospa"], abs=2e-6)


def test_gospa_and_ospa_agree_with_all_assignments_tried():
    rng = np.random.default_rng(1)
    c = 4.0
    for _ in range(100):
        vehicles, tracks = rng.integers(0, 5, 2)
        distance = rng.uniform(0, 8, (vehicles, tracks))
        best, best_full = math.inf, math.inf
        for size in range(min(vehicles, tracks) + 1):
            for rows in itertools.combinations(range(vehicles), size):
                for columns in itertools.permutations(range(tracks), size):
                    pairs = [distance[i, j] for i, j in zip(rows, columns, strict=True)]
                    cost = sum(d**2 for d in pairs) + c**2 / 2 * (vehicles + tracks - 2 * size)
                    best = min(best, cost)
                    if size == min(vehicles, tracks):
                        full = sum(min(d, c) ** 2 for d in pairs) + c**2 * abs(vehicles - tracks)
                        best_full = min(best_full, full)
        larger = max(vehicles, tracks)

        assert gospa(distance, c).distance_m == pytest.approx(math.sqrt(best), abs=1e-12)
        expected = math.sqrt(best_full / larger) if larger else 0.0
        assert ospa(distance, c).distance_m == pytest.approx(expected, abs=1e-12)


def test_the_parts_of_gospa_and_ospa_add_up():
    distance = between([[0, 0], [10, 0], [20, 0]], [[0, 1], [10.5, 0], [30, 0], [40, 0], [50, 0]])

    whole, cardinal = gospa(distance, 4.0), ospa(distance, 4.0)

    assert (whole.missed, whole.false, whole.localisation) == (1, 3, pytest.approx(1.25))
    assert whole.distance_m**2 == pytest.approx(1.25 + 8.0 * 4)
    assert cardinal.localisation_m**2 + cardinal.cardinality_m**2 == pytest.approx(cardinal.distance_m**2)
    assert cardinal.cardinality_m**2 == pytest.approx(16.0 * 2 / 5)


def test_the_near_face_of_a_car_ahead_is_its_rear_or_front():
    x, y = np.array([0.0, 40.0]), np.array([50.0, 0.0])
    heading = np.array([0.0, math.pi / 2])  # both drive away from the radar
    length, width = np.array([4.0, 6.0]), np.array([2.0, 2.0])

    faces = near_face_centres(x, y, heading, length, width)

    np.testing.assert_allclose(faces, [[0.0, 48.0], [37.0, 0.0]], atol=1e-12)


def test_a_long_vehicle_across_the_view_shows_its_side():
    faces = near_face_centres(*(np.array([v]) for v in (0.0, 30.0, math.pi / 2, 12.0, 2.5)))

    np.testing.assert_allclose(faces, [[0.0, 28.75]], atol=1e-12)


def test_the_distance_is_to_the_segment_and_not_to_its_line():
    start, end = np.array([[0.0, 48.0]]), np.array([[0.0, 50.0]])
    points = np.array([[0.0, 49.0], [0.3, 49.0], [0.0, 47.0], [3.0, 54.0]])

    np.testing.assert_allclose(segment_distances(start, end, points), [[0.0, 0.3, 1.0, 5.0]], atol=1e-12)


def test_a_segment_without_length_is_a_point():
    place = np.array([[1.0, 2.0]])

    np.testing.assert_allclose(segment_distances(place, place, np.array([[4.0, 6.0]])), [[5.0]], atol=1e-12)
