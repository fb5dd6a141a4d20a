"""The Kalman algebra against Stone Soup and against recorded results of independent programs.

Their axes differ: bearing from +x, anticlockwise. Our x is their y and our y is their x, so that our
azimuth is their bearing; position is relative to the radar; the acceleration of the constant-velocity model
is idle.
"""

import datetime as dt
import json
from pathlib import Path

import numpy as np
import pytest
from stonesoup.models.measurement.nonlinear import CartesianToBearingRangeRate2D
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import ExtendedKalmanPredictor
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState
from stonesoup.updater.kalman import ExtendedKalmanUpdater

from service.tracking.filters.base import Prediction
from service.tracking.filters.correction import Innovations, Rejection, correct
from service.tracking.filters.ekf import Ekf, predict_bank
from service.tracking.filters.parameters import EkfParameters
from service.tracking.motion import Motion, constant_velocity

PLAIN = Ekf(EkfParameters(robust_gate=None))
OURS = [3, 4, 0, 1]  # their [x vx y vy] in our [x vx ax y vy ay]
VECTORS = Path(__file__).parents[4] / "shared" / "data" / "reference_vectors"


def ours(mean, cov, sensor):
    """Return a bank of one track from their state."""
    m, P = np.zeros((1, 6)), np.zeros((1, 6, 6))
    m[0, OURS] = np.asarray(mean) - [sensor[0], 0, sensor[1], 0]
    P[0][np.ix_(OURS, OURS)] = cov
    P[0, 2, 2] = P[0, 5, 5] = 1.0
    return PLAIN.start(m, P)


def theirs(state, sensor):
    return state.mean[0, OURS] + [sensor[0], 0, sensor[1], 0], state.cov[0][np.ix_(OURS, OURS)]


def step(state, motion, z_bearing_range_rate, R_bearing_range_rate):
    order = [1, 0, 2]
    z = np.asarray(z_bearing_range_rate)[order][None, None]
    R = np.asarray(R_bearing_range_rate)[np.ix_(order, order)][None, None]
    return PLAIN.update(predict_bank(state, motion), z, R, np.ones((1, 1)), np.zeros(1))


def test_the_ekf_follows_stone_soup_over_a_passage():
    rng = np.random.default_rng(8)
    sensor, std, dt_s, density = (-3.0, 2.0), np.array([0.01, 0.3, 0.15]), 0.1, 2.0
    model = CombinedLinearGaussianTransitionModel([ConstantVelocity(density)] * 2)
    measurement = CartesianToBearingRangeRate2D(
        ndim_state=4,
        mapping=(0, 2),
        velocity_mapping=(1, 3),
        noise_covar=np.diag(std**2),
        translation_offset=np.array([[sensor[0]], [sensor[1]]]),
        velocity=np.zeros((2, 1)),
    )
    predictor, updater = ExtendedKalmanPredictor(model), ExtendedKalmanUpdater(measurement)
    now = dt.datetime(2025, 5, 12, tzinfo=dt.UTC)
    truth = np.array([40.0, -9.0, 12.0, 1.0])
    prior = GaussianState(
        truth + np.array([1.0, 1.0, -1.0, 0.5]), np.diag([2.0, 9.0, 2.0, 9.0]), timestamp=now
    )
    state = ours(prior.mean.ravel(), prior.covar, sensor)
    for _ in range(40):
        truth = truth + dt_s * np.array([truth[1], 0.0, truth[3], 0.0])
        now += dt.timedelta(seconds=dt_s)
        x, y = truth[0] - sensor[0], truth[2] - sensor[1]
        z = np.array([np.arctan2(y, x), np.hypot(x, y), (x * truth[1] + y * truth[3]) / np.hypot(x, y)])
        z += std * rng.standard_normal(3)
        detection = Detection(z[:, None], timestamp=now, measurement_model=measurement)
        prior = updater.update(SingleHypothesis(predictor.predict(prior, timestamp=now), detection))
        state = step(state, constant_velocity(dt_s, density), z, np.diag(std**2))

        mean, cov = theirs(state, sensor)
        # Stone Soup differentiates numerically
        np.testing.assert_allclose(mean, np.asarray(prior.mean, dtype=float).ravel(), atol=2e-5)
        np.testing.assert_allclose(cov, np.asarray(prior.covar, dtype=float), atol=2e-5)


def recorded(name):
    path = VECTORS / name
    if not path.exists():
        pytest.skip(f"the recorded results {name} are not beside this repository")
    return json.loads(path.read_text())


def test_the_ekf_repeats_the_recorded_passage():
    data = recorded("ekf_bearing_range_rangerate.json")
    sensor = data["sensor_xy"]
    motion = constant_velocity(data["dt_s"], data["q_white_accel"])
    R = np.diag(np.square(data["noise_sd"]))
    state = ours(data["x0"], data["P0"], sensor)

    for recorded_step in data["steps"]:
        state = step(state, motion, recorded_step["z"], R)
        mean, cov = theirs(state, sensor)
        np.testing.assert_allclose(mean, recorded_step["x"], atol=data["tolerance"])
        np.testing.assert_allclose(cov, recorded_step["P"], atol=data["tolerance"])


def test_the_linear_update_repeats_the_recorded_kalman_filter():
    data = recorded("kalman_cv.json")
    motion = constant_velocity(data["dt_s"], data["q_white_accel"])
    state = ours(data["x0"], data["P0"], (0.0, 0.0))
    H = np.zeros((1, 3, 6))
    H[0, 0, 3], H[0, 1, 0] = 1.0, 1.0  # their x, their y; no third channel
    measured = np.array([[[True, True, False]]])
    R = np.zeros((1, 1, 3, 3))
    R[0, 0, :2, :2] = data["R"]

    for recorded_step in data["steps"]:
        prediction = predict_bank(state, motion)
        e = np.zeros((1, 1, 3))
        e[0, 0, :2] = np.asarray(recorded_step["z"]) - prediction.mean[0, [3, 0]]
        innovations = Innovations(e, R, measured, np.ones((1, 1)), np.zeros(1))
        corrected_mean, cov, _ = correct(prediction, prediction.cov, H, innovations, Rejection(np.zeros(1)))
        state = PLAIN.start(corrected_mean, cov)
        mean, cov = theirs(state, (0.0, 0.0))
        np.testing.assert_allclose(mean, recorded_step["x"], atol=data["tolerance"])
        np.testing.assert_allclose(cov, recorded_step["P"], atol=data["tolerance"])


def test_doppler_that_is_unknown_equals_a_filter_that_has_no_such_channel():
    rng = np.random.default_rng(9)
    std = np.array([0.75, 0.01, 0.25])
    R = np.diag(std**2)
    H2 = np.eye(3)[:2]
    motion = Motion(constant_velocity(0.05, 2.0).F, constant_velocity(0.05, 2.0).Q)
    state = PLAIN.start(np.array([[-5.0, 0, 0, 120.0, -10, 0]]), np.diag([1.0, 9, 1, 1, 9, 1])[None])
    for _ in range(100):
        prediction = predict_bank(state, motion)
        expected = PLAIN.expected(prediction)
        z = expected.z_hat[0] + std * rng.standard_normal(3)
        z[2] = np.nan
        state = PLAIN.update(prediction, z[None, None], R[None, None], np.ones((1, 1)), np.zeros(1))

        P, H = prediction.cov[0], H2 @ expected.H[0]
        S = H @ P @ H.T + R[:2, :2]
        K = P @ H.T @ np.linalg.inv(S)
        np.testing.assert_allclose(
            state.mean[0], prediction.mean[0] + K @ (z - expected.z_hat[0])[:2], atol=1e-9
        )
        np.testing.assert_allclose(state.cov[0], P - K @ S @ K.T, atol=1e-9)
        np.testing.assert_allclose(expected.S_prior[0, :2, :2] + R[:2, :2], S, atol=1e-9)


def test_predictions_keep_their_parts_apart():
    state = PLAIN.start(np.zeros((2, 6)), np.stack([np.eye(6)] * 2))

    prediction = PLAIN.predict(state, 0.05)

    assert isinstance(prediction, Prediction)
    np.testing.assert_allclose(prediction.cov, prediction.propagated + prediction.noise)
    assert prediction.take(np.array([1])).mean.shape == (1, 6)
