import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.tracking.geometry import (
    amplitude,
    ground_range,
    ground_velocity,
    measured_azimuth,
    noise_std,
    plan_azimuth,
    plan_covariance,
    plan_points,
    plan_to_polar,
    polar_to_plan,
    slant_range,
    slant_velocity,
    wrap_angle,
)
from service.tracking.model import Frame
from service.tracking.parameters import SensorModel

SENSOR = SensorModel(mount_height_m=6.0, scatter_height_m=0.6, azimuth_offset_rad=0.1)


def frame(range_m, azimuth_rad, velocity_mps, snr_db):
    columns = [np.array(c, dtype=np.float32) for c in (range_m, azimuth_rad, velocity_mps, snr_db)]
    return Frame("radar-1", 0, 0, None, *columns)


@given(st.floats(-1e3, 1e3))
def test_a_wrapped_angle_is_the_same_direction_within_half_a_turn(angle):
    wrapped = float(wrap_angle(angle))

    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-12)


def test_half_a_turn_wraps_to_plus_pi():
    assert wrap_angle([math.pi, -math.pi, 3 * math.pi]).tolist() == [math.pi] * 3


def test_ground_range_is_the_leg_of_the_triangle_under_the_radar():
    assert ground_range(math.hypot(40.0, 5.4), SENSOR) == pytest.approx(40.0, abs=1e-12)
    # 0.7 m shorter at 20 m, 0.1 m at 150 m for a height of 5.4 m
    assert 20.0 - ground_range(20.0, SENSOR) == pytest.approx(0.74, abs=0.01)
    assert 150.0 - ground_range(150.0, SENSOR) == pytest.approx(0.10, abs=0.01)


@given(st.floats(1.0, 300.0), st.floats(-math.pi, math.pi), st.floats(-60.0, 60.0))
def test_every_conversion_undoes_its_inverse(range_m, azimuth_rad, velocity_mps):
    slant = slant_range(range_m, SENSOR)
    assert ground_range(slant, SENSOR) == pytest.approx(range_m, rel=1e-12)
    there = slant_velocity(velocity_mps, slant, range_m)
    assert ground_velocity(there, slant, range_m) == pytest.approx(velocity_mps, abs=1e-12)
    turned = wrap_angle(plan_azimuth(measured_azimuth(azimuth_rad, SENSOR), SENSOR) - azimuth_rad)
    assert turned == pytest.approx(0.0, abs=1e-12)
    back = plan_to_polar(*polar_to_plan(range_m, azimuth_rad))
    assert back[0] == pytest.approx(range_m, rel=1e-12)
    assert wrap_angle(back[1] - azimuth_rad) == pytest.approx(0.0, abs=1e-12)


def test_ground_velocity_is_the_derivative_of_the_ground_range():
    before, after = ground_range([30.0 - 1e-4, 30.0 + 1e-4], SENSOR)

    rate = ground_velocity(-12.0, 30.0, ground_range(30.0, SENSOR))

    assert rate == pytest.approx(-12.0 * (after - before) / 2e-4, rel=1e-8)


def test_echoes_nearer_than_the_mast_is_high_stay_finite():
    points = plan_points(frame([0.0, 3.0, 5.4], [0.0] * 3, [-3.0] * 3, [20.0] * 3), SENSOR)

    for column in dataclasses.astuple(points):
        assert np.isfinite(column).all()
    assert (points.range_m == SENSOR.range_resolution_m).all()


def test_azimuth_grows_clockwise_from_the_boresight():
    x, y = polar_to_plan(10.0, math.radians(30.0))

    assert (x, y) == (pytest.approx(5.0), pytest.approx(8.660254))


def test_noise_at_the_reference_snr_is_the_installers_and_grows_tenfold_with_20_db_less():
    at = noise_std([20.0, 0.0, np.nan], SENSOR)

    np.testing.assert_allclose(at[0], [0.15, 1.5, 0.15])
    np.testing.assert_allclose(at[2], [0.1, 1.0, 0.1])
    np.testing.assert_allclose(np.degrees(at[1]), np.hypot(0.1, [0.3, 3.0, 0.3]))


def test_strong_echoes_never_beat_the_floor_of_the_antenna():
    azimuth_std = noise_std(90.0, SENSOR)[1]

    assert SENSOR.azimuth_floor_rad <= azimuth_std < 1.001 * SENSOR.azimuth_floor_rad


def test_weight_is_the_amplitude_and_unknown_snr_counts_as_the_reference():
    np.testing.assert_allclose(amplitude([0.0, 20.0, 40.0, np.nan], SENSOR), [1.0, 10.0, 100.0, 10.0])


def test_a_frame_becomes_points_with_the_offset_of_the_mount_and_unknown_doppler_kept():
    points = plan_points(frame([50.0, 60.0], [0.2, -0.2], [-10.0, np.nan], [20.0, np.nan]), SENSOR)

    stretch = 50.0 / ground_range(50.0, SENSOR)
    np.testing.assert_allclose(points.azimuth_rad, [0.3, -0.1], atol=1e-7)  # float32 columns
    assert points.radial_velocity_mps[0] == pytest.approx(-10.0 * stretch)
    assert np.isnan(points.radial_velocity_mps[1])
    assert points.range_std_m[0] == pytest.approx(0.15 * stretch)
    assert points.velocity_std_mps[0] == pytest.approx(0.1 * stretch)
    np.testing.assert_allclose(points.x_m, points.range_m * np.sin(points.azimuth_rad))
    assert len(points) == 2


def test_covariance_in_the_plane_follows_the_samples():
    rng = np.random.default_rng(5)
    polar_cov = np.array([[0.04, 0.0006], [0.0006, 1e-4]])
    samples = rng.multivariate_normal([50.0, 0.7], polar_cov, 200_000)

    expected = np.cov(np.stack(polar_to_plan(samples[:, 0], samples[:, 1])))

    # 2 % of the largest entry: five standard errors of a variance from 200,000 samples are 1.6 %
    np.testing.assert_allclose(plan_covariance(50.0, 0.7, polar_cov), expected, atol=0.02 * expected.max())
