import math

import numpy as np
import pytest

from service.simulation.manoeuvres import cruise
from service.simulation.point_radar import PointNoise, measure
from service.tracking.measurement import innovation, predict_measurement

TRUTH = np.repeat(cruise()[:, None], 80, axis=1)  # 20,080 measurements
DEFECTIVE = PointNoise(velocity_std_mps=0.25, outlier_share=0.05, miss_share=0.1)


def test_noise_has_the_spread_that_is_asked_for():
    noise = PointNoise(velocity_std_mps=0.25)

    e = innovation(measure(TRUTH, noise, np.random.default_rng(1)), predict_measurement(TRUTH)).reshape(-1, 3)

    # five standard errors of a variance from 20,080 samples are 5 %
    np.testing.assert_allclose(np.cov(e.T), noise.covariance(), atol=0.05 * 0.75**2)
    np.testing.assert_allclose(e.std(axis=0), [0.75, math.radians(0.5), 0.25], rtol=0.03)


def test_outliers_and_misses_come_as_often_as_asked_for_but_not_in_the_first_two_frames():
    z = measure(TRUTH, DEFECTIVE, np.random.default_rng(2))
    missed = np.isnan(z[..., 0])
    far = np.abs(innovation(z, predict_measurement(TRUTH))[..., 0]) > 5 * 0.75

    # five standard errors: 0.011 and 0.008
    assert missed[2:].mean() == pytest.approx(0.1, abs=0.011)
    assert far[2:][~missed[2:]].mean() == pytest.approx(0.05, abs=0.008)
    assert not missed[:2].any()
    assert not far[:2].any()


def test_a_radar_without_doppler_has_none():
    z = measure(TRUTH, PointNoise(), np.random.default_rng(3))

    assert np.isnan(z[..., 2]).all()
    assert np.isfinite(z[..., :2]).all()


def test_the_same_generator_gives_the_same_measurements():
    np.testing.assert_array_equal(
        measure(TRUTH, DEFECTIVE, np.random.default_rng(4)),
        measure(TRUTH, DEFECTIVE, np.random.default_rng(4)),
    )
