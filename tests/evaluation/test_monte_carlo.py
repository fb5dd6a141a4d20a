import math

import numpy as np
import pytest

from service.evaluation.monte_carlo import (
    Runs,
    lost,
    peak_position_error,
    position_and_velocity_rmse,
    run_filter,
)
from service.simulation.manoeuvres import cruise
from service.simulation.point_radar import PointNoise, measure
from service.tracking.filters.registry import make_filter

TRUTH = np.repeat(cruise()[:30, None], 5, axis=1)


def shifted(by):
    mean = TRUTH.copy()
    mean[..., [0, 3]] += np.asarray(by) * [0.6, 0.8]
    mean[..., 1] -= 2.0
    return Runs(mean, np.broadcast_to(np.eye(6), (*mean.shape, 6)))


def test_errors_of_a_known_shift_are_that_shift():
    assert position_and_velocity_rmse(shifted(3.0), TRUTH, after=5) == pytest.approx((3.0, 2.0))
    assert peak_position_error(shifted(3.0), TRUTH, after=5) == pytest.approx(3.0)


def test_a_track_is_lost_when_it_ends_far_away_or_nowhere():
    off = np.array([[1.0], [9.9], [10.1], [math.nan], [0.0]])

    assert lost(shifted(off), TRUTH).tolist() == [False, False, True, True, False]


def test_a_run_starts_at_the_second_frame_and_covers_the_rest():
    noise = PointNoise()
    z = measure(TRUTH, noise, np.random.default_rng(1))

    runs = run_filter(make_filter("ekf"), z, noise.covariance(), 0.05)

    assert np.isnan(runs.mean[0]).all()
    assert np.isfinite(runs.mean[1:]).all()
    assert np.isfinite(runs.cov[1:]).all()


def test_a_run_from_given_tracks_starts_at_the_first_frame():
    noise = PointNoise()
    z = measure(TRUTH, noise, np.random.default_rng(1))
    chosen = make_filter("ekf")
    start = chosen.start(TRUTH[0], np.broadcast_to(np.eye(6), (5, 6, 6)))

    runs = run_filter(chosen, z, noise.covariance(), 0.05, start)

    np.testing.assert_array_equal(runs.mean[0], TRUTH[0])
