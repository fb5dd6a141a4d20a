from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from service.evaluation.counted import count
from service.evaluation.crossings import countable
from service.evaluation.kinematics import match
from service.evaluation.lanes import score_changes, score_lanes
from service.evaluation.polyline import feet
from service.evaluation.recorded import FoundChange, FoundLane, read_tracks
from service.evaluation.rules import RULES
from service.evaluation.truth import TruthChange, read_scene
from tests.evaluation.small_scene import SmallScene, Vehicle, write_lines


@pytest.fixture
def busy():
    """Return a scene whose first lane was used by six vehicles, the second by one."""
    cars = [Vehicle(id=k, x=-2.0, y0=90.0 + 8.0 * k, vy=-16.0) for k in range(1, 7)]
    return SmallScene([*cars, Vehicle(id=9, x=2.0, y0=100.0, vy=-8.0)])


def line(x, start=20.0, stop=150.0):
    return np.array([[x, y] for y in np.arange(start, stop, 5.0)])


def test_feet_beyond_an_end_are_told_from_feet_beside():
    path = np.array([[0.0, 0.0], [0.0, 10.0], [10.0, 10.0]])

    foot = feet(path, np.array([[1.0, 4.0], [0.0, -3.0], [14.0, 13.0], [5.0, 12.0]]))

    np.testing.assert_allclose(foot.distance_m, [1.0, 3.0, 5.0, 2.0])
    np.testing.assert_array_equal(foot.beyond, [False, True, True, False])
    np.testing.assert_allclose(foot.direction, [[0, 1], [0, 1], [1, 0], [1, 0]])


def test_a_lane_that_was_hardly_used_is_neither_wanted_nor_extra(busy, tmp_path):
    scene = read_scene(busy.write(tmp_path))

    scores, partner = score_lanes(scene, [FoundLane("a", line(-1.7)), FoundLane("b", line(2.1))], RULES)

    assert (scores["lanes_true"], scores["lanes_right"], scores["lanes_extra"]) == (1, 1, 0)
    assert scores["lane_count_exact"] is True
    assert scores["lane_offset_mean_m"] == pytest.approx(0.3)
    assert partner == {"a": "L1", "b": "L2"}


@pytest.mark.parametrize(
    ("points", "why"),
    [
        (line(-0.7), "1.3 m beside"),
        (line(-2.0, 20.0, 60.0), "less than half of it"),
        (np.array([[-30.0, 60.0], [30.0, 60.0]]), "across"),
    ],
)
def test_a_line_that_is_no_lane_is_extra(busy, tmp_path, points, why):
    scene = read_scene(busy.write(tmp_path))

    scores, partner = score_lanes(scene, [FoundLane(1, points)], RULES)

    assert (scores["lanes_right"], scores["lanes_extra"], partner) == (0, 1, {}), why
    assert np.isnan(scores["lane_offset_mean_m"])


def test_crossings_that_nobody_could_have_seen_coming_are_not_countable(tmp_path):
    scene = SmallScene(
        [
            Vehicle(id=1, x=-2.0, y0=128.0, vy=-8.0),  # crosses at 6.0 s, seen all the time
            Vehicle(id=2, x=2.0, y0=128.0, vy=-8.0, seen_from=112),  # seen in 9 frames before 6.0 s
            Vehicle(id=3, x=2.0, y0=128.4, vy=-8.0, seen_from=111),  # seen in 10 before 6.05 s
            Vehicle(id=4, x=2.0, y0=112.0, vy=-8.0),  # crosses at 4.0 s
            Vehicle(id=5, x=2.0, y0=155.6, vy=-8.0),  # crosses at 9.45 s of 9.95 s
            Vehicle(id=6, x=2.0, y0=156.0, vy=-8.0),  # crosses at 9.5 s
        ]
    )
    truth = read_scene(scene.write(tmp_path))

    found = {crossing.vehicle for crossing, fair in countable(truth, RULES).items() if fair}

    assert found == {1, 2, 3, 5} - {2}


def test_a_lane_change_is_right_for_the_same_vehicle_near_the_manoeuvre(busy, tmp_path):
    scene = read_scene(busy.write(tmp_path))
    scene = dataclasses.replace(scene, changes=(TruthChange(9, 4.0, 3.0, 5.0), TruthChange(1, 1.0, 0.5, 1.5)))
    tracks = read_tracks(write_lines(tmp_path / "tracks.jsonl", busy.tracks()), scene)
    counted = count(scene, tracks, RULES)
    found = [
        FoundChange(6.9, 9),  # within 2 s of its end
        FoundChange(4.0, 9),  # the same again
        FoundChange(1.0, 2),  # another vehicle
        FoundChange(1.0, "nobody"),
    ]

    scores = score_changes(scene, found, tracks, match(counted, tracks, RULES), RULES)

    assert scores["changes_recall"] == pytest.approx(1 / 2)
    assert scores["changes_precision"] == pytest.approx(1 / 4)
