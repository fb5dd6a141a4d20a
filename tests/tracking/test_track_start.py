import math

import numpy as np
import pytest

from service.tracking.measurement import predict_measurement
from service.tracking.start import directed_prior, initial_state, two_point_state, undirected_prior

R = np.diag([0.75**2, math.radians(0.5) ** 2, 0.25**2])
NO_DOPPLER = np.array([1.0, 1.0, np.nan])


def along(vector, direction):
    return float(vector @ direction)


def test_one_measurement_gives_the_position_and_the_radial_velocity():
    z = np.array([100.0, 0.3, -14.0])
    u, t = np.array([math.sin(0.3), math.cos(0.3)]), np.array([math.cos(0.3), -math.sin(0.3)])

    mean, cov = initial_state(z, R, undirected_prior())

    np.testing.assert_allclose(mean[[0, 3]], 100.0 * u, atol=1e-9)
    velocity_cov = cov[np.ix_([1, 4], [1, 4])]
    assert along(mean[[1, 4]], u) == pytest.approx(-14.0, rel=1e-3)
    assert u @ velocity_cov @ u == pytest.approx(0.25**2, rel=1e-3)
    assert t @ velocity_cov @ t == pytest.approx(20.0**2, rel=1e-9)
    position_cov = cov[np.ix_([0, 3], [0, 3])]
    assert u @ position_cov @ u == pytest.approx(0.75**2)
    assert t @ position_cov @ t == pytest.approx((100.0 * math.radians(0.5)) ** 2)
    assert cov[2, 2] == cov[5, 5] == 9.0


def test_without_doppler_the_velocity_is_the_prior():
    mean, cov = initial_state(np.array([100.0, 0.3, np.nan]), R, undirected_prior(12.0))

    np.testing.assert_array_equal(mean[[1, 4]], 0.0)
    np.testing.assert_allclose(cov[np.ix_([1, 4], [1, 4])], 144.0 * np.eye(2))


def test_the_heading_of_a_lane_turns_doppler_into_the_whole_velocity():
    z = np.array([60.0, 0.5, -10.0])
    lane = math.pi  # towards the radar

    mean, cov = initial_state(z, R, directed_prior(lane, along_std_mps=20.0, across_std_mps=0.3))

    assert mean[4] == pytest.approx(-10.0 / math.cos(0.5), abs=0.2)
    assert abs(mean[1]) < 0.1
    assert math.sqrt(cov[4, 4]) < 0.5


def test_tangential_velocity_has_the_spread_that_is_given():
    z = np.array([60.0, 0.5, -10.0])
    t = np.array([math.cos(0.5), -math.sin(0.5)])

    _, cov = initial_state(z, R, directed_prior(0.5, along_std_mps=30.0, across_std_mps=2.5))

    assert math.sqrt(t @ cov[np.ix_([1, 4], [1, 4])] @ t) == pytest.approx(2.5)


@pytest.mark.parametrize("doppler", [True, False])
def test_two_point_starts_are_as_far_off_as_they_say(doppler):
    rng = np.random.default_rng(3)
    runs, dt_s = 4000, 0.05
    truth = np.zeros((runs, 6))
    truth[:, [0, 3]] = [-6.0, 120.0]
    truth[:, [1, 4]] = rng.normal(0.0, 20.0, (runs, 2))
    truth[:, [2, 5]] = rng.normal(0.0, 3.0, (runs, 2))
    before = truth.copy()
    before[:, [0, 3]] -= dt_s * truth[:, [1, 4]] - dt_s**2 / 2 * truth[:, [2, 5]]
    std = np.sqrt(np.diag(R))
    keep = np.ones(3) if doppler else NO_DOPPLER
    z0 = (predict_measurement(before) + std * rng.standard_normal((runs, 3))) * keep
    z1 = (predict_measurement(truth) + std * rng.standard_normal((runs, 3))) * keep
    all_R = np.broadcast_to(R, (runs, 3, 3))

    mean, cov = two_point_state(z0, all_R, z1, all_R, dt_s=dt_s, prior=undirected_prior())

    e = (mean - truth)[..., None]
    nees = float(np.mean(e.swapaxes(1, 2) @ np.linalg.solve(cov, e)))
    # chi-square with 6 degrees of freedom: the mean of 4000 has std 0.055; 6 % for the curvature of polar
    # coordinates
    assert nees == pytest.approx(6.0, abs=0.35)
    np.testing.assert_array_equal(cov, cov.swapaxes(1, 2))


def test_a_bank_mixes_tracks_with_and_without_doppler():
    z = np.array([[100.0, 0.3, -14.0], [100.0, 0.3, np.nan]])
    mean, cov = initial_state(z, np.stack([R, R]), undirected_prior())

    for i in range(2):
        one = initial_state(z[i], R, undirected_prior())
        np.testing.assert_allclose(mean[i], one[0], atol=1e-12)
        np.testing.assert_allclose(cov[i], one[1], atol=1e-12)
