"""The weighted update against the mixture that it stands for, written out hypothesis by hypothesis."""

import math

import numpy as np
import pytest

from service.errors import InvalidInput
from service.tracking.filters.base import Prediction
from service.tracking.filters.correction_kernels import keep_definite
from service.tracking.filters.ekf import Ekf
from service.tracking.filters.parameters import EkfParameters
from service.tracking.measurement import innovation, jacobian, predict_measurement

PLAIN = Ekf(EkfParameters(robust_gate=None))
R = np.diag([0.4**2, math.radians(0.4) ** 2, 0.2**2])


def bank(rng, tracks):
    mean = rng.normal([-5, 0, 0, 90, -12, 0], [4, 2, 1, 30, 4, 1], (tracks, 6))
    root = rng.normal(0.0, 1.0, (tracks, 6, 6)) * np.array([0.5, 2, 1, 0.5, 2, 1])[:, None]
    return Prediction(mean, root @ root.swapaxes(1, 2), 0.05 * np.eye(6), np.zeros((tracks, 1)))


def scan(rng, prediction, many):
    """Return measurements near each track, each with its own correlated covariance."""
    z = predict_measurement(prediction.mean)[:, None] + rng.normal(
        0, [1.0, 0.01, 0.5], (len(prediction.mean), many, 3)
    )
    root = rng.normal(0, 1, (len(prediction.mean), many, 3, 3)) * np.array([0.4, 0.007, 0.2])[:, None]
    return z, root @ root.swapaxes(-1, -2) + 0.2 * R


def one_update(mean, cov, z, R):
    """Return the textbook EKF update of one track, over the channels that were measured."""
    seen = np.isfinite(z)
    H = jacobian(mean)[seen]
    e = innovation(z, predict_measurement(mean))[seen]
    S = H @ cov @ H.T + R[np.ix_(seen, seen)]
    K = cov @ H.T @ np.linalg.inv(S)
    return mean + K @ e, cov - K @ S @ K.T


def mixture(prediction, track, z, R, beta, miss):
    before = prediction.mean[track], prediction.cov[track]
    updates = [(beta[j], *one_update(*before, z[j], R[j])) for j in np.flatnonzero(beta)]
    parts = [(miss, *before), *updates]
    mean = sum(w * m for w, m, _ in parts)
    cov = sum(w * (P + np.outer(m - mean, m - mean)) for w, m, P in parts)
    return mean, cov


def test_the_update_has_the_mean_and_covariance_of_the_mixture():
    rng = np.random.default_rng(1)
    prediction = bank(rng, 40)
    z, own_R = scan(rng, prediction, 3)
    weights = rng.dirichlet(np.ones(4), 40)
    beta, miss = weights[:, :3], weights[:, 3]
    z[::3, 1, 2] = np.nan  # a third of the tracks has one measurement without Doppler
    z[1::4, :, 2] = np.nan  # a quarter has none with

    state = PLAIN.update(prediction, z, own_R, beta, miss)

    for t in range(40):
        mean, cov = mixture(prediction, t, z[t], own_R[t], beta[t], miss[t])
        np.testing.assert_allclose(state.mean[t], mean, atol=1e-9)
        np.testing.assert_allclose(state.cov[t], cov, atol=1e-9 * np.abs(cov).max())


def test_equal_covariances_give_the_update_of_the_textbook():
    rng = np.random.default_rng(2)
    prediction = bank(rng, 1)
    z, _ = scan(rng, prediction, 2)
    beta, miss = np.array([[0.5, 0.3]]), np.array([0.2])
    P, H = prediction.cov[0], jacobian(prediction.mean[0])
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    e = innovation(z[0], predict_measurement(prediction.mean))
    nu = beta[0] @ e

    state = PLAIN.update(prediction, z, np.broadcast_to(R, (1, 2, 3, 3)), beta, miss)

    # Bar-Shalom, Daum, Huang 2009: P = beta0 P + (1 - beta0) Pc + K (sum beta nu nu' - nu nu') K'
    spread = np.einsum("j,ja,jb->ab", beta[0], e, e) - np.outer(nu, nu)
    expected = 0.2 * P + 0.8 * (P - K @ S @ K.T) + K @ spread @ K.T
    np.testing.assert_allclose(state.mean[0], prediction.mean[0] + K @ nu, atol=1e-10)
    np.testing.assert_allclose(state.cov[0], expected, atol=1e-10)


def test_one_certain_measurement_is_the_ordinary_update():
    rng = np.random.default_rng(3)
    prediction = bank(rng, 20)
    z, own_R = scan(rng, prediction, 1)

    state = PLAIN.update(prediction, z, own_R, np.ones((20, 1)), np.zeros(20))

    for t in range(20):
        mean, cov = one_update(prediction.mean[t], prediction.cov[t], z[t, 0], own_R[t, 0])
        np.testing.assert_allclose(state.mean[t], mean, atol=1e-10)
        np.testing.assert_allclose(state.cov[t], cov, atol=1e-9)


@pytest.mark.parametrize("padding", [0.0, np.nan, 1e300])
def test_padding_may_hold_anything(padding):
    rng = np.random.default_rng(4)
    prediction = bank(rng, 5)
    z, own_R = scan(rng, prediction, 2)
    wide_z = np.concatenate([z, np.full((5, 3, 3), padding)], axis=1)
    wide_R = np.concatenate([own_R, np.full((5, 3, 3, 3), padding)], axis=1)
    beta, miss = np.full((5, 2), 0.4), np.full(5, 0.2)
    wide_beta = np.concatenate([beta, np.zeros((5, 3))], axis=1)

    narrow = PLAIN.update(prediction, z, own_R, beta, miss)
    wide = PLAIN.update(prediction, wide_z, wide_R, wide_beta, miss)

    np.testing.assert_allclose(wide.mean, narrow.mean, atol=1e-12)
    np.testing.assert_allclose(wide.cov, narrow.cov, atol=1e-12)


@pytest.mark.parametrize("many", [0, 2])
def test_without_a_measurement_the_prediction_remains(many):
    rng = np.random.default_rng(5)
    prediction = bank(rng, 5)
    empty = np.full((5, many, 3), np.nan), np.full((5, many, 3, 3), np.nan), np.zeros((5, many))

    state = PLAIN.update(prediction, *empty, np.ones(5))

    np.testing.assert_array_equal(state.mean, prediction.mean)
    np.testing.assert_array_equal(state.cov, prediction.cov)


def test_probabilities_that_do_not_add_up_are_refused():
    rng = np.random.default_rng(6)
    prediction = bank(rng, 2)
    z, own_R = scan(rng, prediction, 1)

    with pytest.raises(InvalidInput, match="must be 1"):
        PLAIN.update(prediction, z, own_R, np.full((2, 1), 0.5), np.full(2, 0.4))


def test_shapes_that_do_not_fit_are_refused():
    rng = np.random.default_rng(7)
    prediction = bank(rng, 2)
    z, own_R = scan(rng, prediction, 2)

    with pytest.raises(InvalidInput, match="want z"):
        PLAIN.update(prediction, z, own_R, np.full((2, 1), 1.0), np.zeros(2))


def test_rounding_that_costs_definiteness_is_made_good_from_the_prediction():
    rng = np.random.default_rng(5)
    spread = rng.normal(size=(6, 6))
    predicted = spread @ spread.T + np.eye(6)
    sound = 0.5 * predicted
    lost = sound - 1.001 * np.linalg.eigvalsh(sound)[0] * np.eye(6)
    negative = sound.copy()
    negative[2, 2] = -1e-9
    for cov, changes in ((sound, False), (lost, True), (negative, True)):
        kept = cov.copy()
        keep_definite.py_func(kept, predicted, np.empty((6, 6)))

        assert np.array_equal(kept, kept.T)
        assert np.linalg.eigvalsh(kept)[0] > 0.0
        assert np.array_equal(kept, cov) is not changes
