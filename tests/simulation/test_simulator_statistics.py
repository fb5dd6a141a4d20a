"""Our radar sees vehicles as richly, and loses them for as long, as the radar of recorded scenes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from service.simulation.scene_replay import compare_scene, join
from service.simulation.statistics import RangeStatistics, Share, Sightings, miss_runs, range_statistics
from service.simulation.vehicles import VehicleKind

SCENES = Path(__file__).parents[2] / ".." / "shared" / "scenes" / "data"
AZIMUTH_MAX_RAD = math.radians(45.0)
BAR = 0.20
GROUPS = {
    "car": [VehicleKind.CAR],
    "truck": [VehicleKind.TRUCK, VehicleKind.BUS],
    "motorcycle": [VehicleKind.MOTORCYCLE],
}


def rows(points: list[int], *, vehicle: int = 1, first: int = 0, range_m: float = 50.0) -> Sightings:
    n = len(points)
    frame = np.arange(first, first + n)
    same = np.full(n, range_m)
    return Sightings(frame, np.full(n, vehicle), np.zeros(n, np.uint8), same, 0 * same, np.array(points))


def test_runs_of_misses_end_at_points_gaps_and_vehicles():
    parts = [rows([0, 0, 2, 0, 1]), rows([0, 0, 0], first=9), rows([0, 1], vehicle=2, range_m=120.0)]
    vehicle, length, middle = miss_runs(join(parts))

    assert vehicle.tolist() == [1, 1, 1, 2]
    assert length.tolist() == [2, 1, 3, 1]
    assert middle.tolist() == [50.0, 50.0, 50.0, 120.0]


def test_a_radar_that_misses_nothing_has_no_runs():
    vehicle, length, _ = miss_runs(rows([1, 4, 2]))

    assert len(vehicle) == len(length) == 0


def test_means_and_their_standard_errors_are_over_vehicles():
    stats = range_statistics(
        join([rows([3, 3]), rows([5, 5], vehicle=2), rows([0], vehicle=3, range_m=110.0)])
    )

    assert stats.points.value[1] == 4.0
    # two vehicles of 2 rows each, one row-sum 2 below and one 2 above: sqrt(4 + 4) / 4
    assert stats.points.std_error[1] == pytest.approx(math.sqrt(8.0) / 4)
    assert stats.points.count.tolist() == [0, 4, 0, 1, 0]
    assert stats.seen.value[3] == 0.0
    assert stats.run.value[3] == 1.0
    assert np.isnan(stats.points.value[0])


@pytest.fixture(scope="module")
def scenes():
    """Return for each scene what its radar recorded and what ours sees of the same vehicles."""
    return {d.name: compare_scene(d, seed=0) for d in sorted(SCENES.iterdir())}


def pooled(scenes, side: int, kinds: list[VehicleKind]) -> RangeStatistics:
    together = join([pair[side] for pair in scenes.values()], same_vehicles=False)
    return range_statistics(together.take(np.isin(together.kind, kinds)).in_view(AZIMUTH_MAX_RAD))


def outside(recorded: Share, simulated: Share) -> np.ndarray:
    """Return which bins differ by more than the bar and by more than three standard errors."""
    off = np.abs(simulated.value - recorded.value)
    chance = 3 * np.hypot(recorded.std_error, simulated.std_error)
    return off > np.maximum(BAR * recorded.value, chance)


needs_scenes = pytest.mark.skipif(
    not SCENES.exists(), reason="the recorded scenes are not beside the repository"
)


@pytest.mark.slow
@needs_scenes
@pytest.mark.parametrize("group", GROUPS)
def test_points_of_a_vehicle_are_within_a_fifth_at_every_range(scenes, group):
    recorded, simulated = (pooled(scenes, side, GROUPS[group]).points for side in (0, 1))

    # 800 to 31,000 vehicle-frames a bin
    assert np.all(np.abs(simulated.value / recorded.value - 1) < BAR)


@pytest.mark.slow
@needs_scenes
@pytest.mark.parametrize("scene", ["curve", "dense", "free_flow", "stop_and_go", "two_way", "wide"])
def test_points_of_cars_are_within_a_fifth_scene_by_scene(scenes, scene):
    recorded, simulated = (
        range_statistics(q.take(q.kind == VehicleKind.CAR).in_view(AZIMUTH_MAX_RAD)).points
        for q in scenes[scene]
    )

    assert np.all(np.abs(simulated.value / recorded.value - 1) < BAR)


@pytest.mark.slow
@needs_scenes
def test_runs_of_misses_are_within_a_fifth_where_there_are_many(scenes):
    recorded, simulated = (pooled(scenes, side, list(VehicleKind)).run for side in (0, 1))
    many = recorded.count > 200

    assert many.tolist() == [False, True, True, True, True]
    assert np.all(np.abs(simulated.value / recorded.value - 1)[many] < BAR)


@pytest.mark.slow
@needs_scenes
@pytest.mark.parametrize("group", GROUPS)
def test_nothing_differs_by_more_than_a_fifth_beyond_chance(scenes, group):
    recorded, simulated = (pooled(scenes, side, GROUPS[group]) for side in (0, 1))
    pairs = [
        (recorded.points, simulated.points),
        (recorded.seen, simulated.seen),
        (recorded.run, simulated.run),
        *zip(recorded.run_longer, simulated.run_longer, strict=True),
    ]
    for theirs, ours in pairs:
        counted = (theirs.count >= 30) & (ours.count >= 30)
        assert not np.any(outside(theirs, ours)[counted])
