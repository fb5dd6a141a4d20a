from __future__ import annotations

import itertools

import numpy as np
import pytest

from service.cli.fold_bench import FoldRun
from service.evaluation import bench, peer_bench, steady
from service.evaluation.bench import LOADS, Timing
from service.evaluation.steady import Load
from service.tracking.parameters import SensorModel, TrackerParameters

SMALLEST = LOADS[0]


def frames(load=SMALLEST, count=4, seed=1):
    return steady.steady_frames(load, count, SensorModel(), np.random.default_rng(seed))


@pytest.mark.parametrize("load", LOADS)
def test_every_frame_of_a_load_has_its_points_in_view(load):
    for frame in frames(load):
        azimuth = np.degrees(np.abs(frame.azimuth_rad))

        assert len(frame) == load.points
        assert np.all(np.diff(frame.range_m) >= 0)
        assert 18.0 < frame.range_m.min() < frame.range_m.max() < 155.0
        assert azimuth.max() < 45.0


def test_vehicles_keep_apart_and_come_nearer():
    load = Load(120, 500)
    first, second = frames(load, 2)

    moving = first.radial_velocity_mps < -5.0
    assert np.count_nonzero(moving) == 4 * load.vehicles
    assert second.time_us - first.time_us == 50_000
    assert np.count_nonzero(second.radial_velocity_mps < -5.0) == 4 * load.vehicles


def test_equal_arguments_give_equal_frames():
    for a, b in zip(frames(), frames(), strict=True):
        assert a.time_us == b.time_us
        np.testing.assert_array_equal(a.range_m, b.range_m)
        np.testing.assert_array_equal(a.azimuth_rad, b.azimuth_rad)


def test_too_few_points_for_the_vehicles_are_refused():
    with pytest.raises(ValueError, match="10 points are too few for 3 vehicles"):
        frames(Load(3, 10))


def timing(vehicles, median_s):
    return Timing(Load(vehicles, 5 * vehicles), vehicles, median_s, 2 * median_s, 1e-6)


def test_growth_is_the_power_of_the_number_of_vehicles():
    timings = [timing(30, 0.002), timing(60, 0.004), timing(120, 0.016)]

    assert bench.growth(timings) == pytest.approx([1.0, 2.0])
    assert bench.grid(timings).rows[2] == (
        "120", "600", "120", "16.00", "32.00", "1.00", "16000", "n^2.00",
    )  # fmt: skip


@pytest.mark.slow  # compiles the kernels when no compiled ones are stored
def test_a_step_and_its_stages_are_timed_by_the_clock_that_is_given():
    ticks = itertools.count()

    (result,) = bench.bench(
        [Load(3, 20)], warm_up=30, steps=10, clock=lambda: float(next(ticks)), fold=FoldRun
    )

    readings = [stage.median_s for stage in result.stages]  # one reading after each part of a stage
    assert dict(zip(bench.STAGES, readings, strict=True)) == dict.fromkeys(bench.STAGES, 1.0) | {
        "clutter": 2.0, "filter": 2.0, "fold": 2.0,
    }  # fmt: skip
    assert (result.median_s, result.p99_s) == (12.0, 12.0)
    assert result.product_s == pytest.approx(1.0 / 100)
    assert result.products == pytest.approx(1200.0)
    assert result.tracks == 3
    assert bench.stage_grid([result]).rows[0] == ("points", "1000000", "1000000", "100")


@pytest.mark.slow
def test_recorded_frames_are_timed_as_their_usual_load():
    result = bench.bench_frames(frames(Load(3, 20), 40), TrackerParameters(), warm_up=30)

    assert result.load == Load(3, 20)
    assert result.p99_s >= result.median_s > 0.0


@pytest.mark.slow
def test_stone_soup_tracks_the_same_vehicles_and_is_compared():
    compared = peer_bench.compare(frames(Load(3, 20), 40), TrackerParameters())

    assert compared.frames == 20
    assert compared.tracks == 3
    assert compared.peer_tracks >= 3
    assert compared.ratio > 2.0  # some twenty: a small load, on a machine that does other things
    assert f"{compared.ratio:.0f} times as long" in compared.sentence()


@pytest.mark.slow
def test_the_profile_names_the_tracker():
    assert "tracker.py" in bench.profile(Load(3, 20), warm_up=2, steps=2)
