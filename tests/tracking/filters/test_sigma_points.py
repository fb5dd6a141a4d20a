"""The linearisations against textbook sums, and the weighted update against the compiled one."""

import math

import numpy as np
import pytest

from service.tracking.filters import correction, weighted
from service.tracking.filters.base import Prediction
from service.tracking.filters.correction import Rejection
from service.tracking.filters.parameters import UkfParameters
from service.tracking.filters.sigma_points import (
    CUBATURE,
    NonlinearStep,
    SigmaPoints,
    cholesky,
    through_points,
)
from service.tracking.filters.space import ROAD_SENSOR, PolarSensor, plane, velocity_step
from service.tracking.filters.ukf import ukf
from service.tracking.measurement import linearise
from service.tracking.motion import constant_acceleration

NEAR = np.array([3.0, 8.0, 6.0, -9.0])  # curved enough for a transformation to matter
COV = np.diag([1.0, 4.0, 1.0, 4.0]) + 0.3


def textbook(mean, cov, alpha, beta):
    """Return z_hat, Pzz, Pxz by the weighted sums of Appl. Sci. 2025, eq. 14-18."""
    n, sensor = len(mean), PolarSensor()
    root = np.linalg.cholesky(cov)
    offsets = [np.zeros(n), *(alpha * math.sqrt(n) * root.T), *(-alpha * math.sqrt(n) * root.T)]
    wm = [1 - 1 / alpha**2] + [1 / (2 * alpha**2 * n)] * (2 * n)
    wc = [wm[0] + 1 - alpha**2 + beta, *wm[1:]]
    z = [sensor.predict(mean + o) for o in offsets]
    z_hat = sum(w * v for w, v in zip(wm, z, strict=True))
    Pzz = sum(w * np.outer(v - z_hat, v - z_hat) for w, v in zip(wc, z, strict=True))
    Pxz = sum(w * np.outer(o, v - z_hat) for w, o, v in zip(wc, offsets, z, strict=True))
    return z_hat, Pzz, Pxz


@pytest.mark.parametrize(("alpha", "atol"), [(1.0, 1e-12), (0.3, 1e-11), (1e-3, 1e-4)])
def test_the_points_give_the_sums_of_the_textbook(alpha, atol):
    seen = through_points(NEAR, np.linalg.cholesky(COV), PolarSensor(), SigmaPoints(alpha))
    z_hat, Pzz, Pxz = textbook(NEAR, COV, alpha, 2.0)

    np.testing.assert_allclose(seen.z_hat, z_hat, atol=atol)
    np.testing.assert_allclose(COV @ seen.H.T, Pxz, atol=atol)
    np.testing.assert_allclose(seen.H @ COV @ seen.H.T + seen.omega, Pzz, atol=atol)


def test_cubature_points_weigh_equally():
    n, root, sensor = 4, np.linalg.cholesky(COV), PolarSensor()
    z = sensor.predict(NEAR + math.sqrt(n) * np.concatenate([root.T, -root.T]))

    seen = through_points(NEAR, root, sensor, CUBATURE)

    np.testing.assert_allclose(seen.z_hat, z.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(seen.H @ COV @ seen.H.T + seen.omega, np.cov(z.T, bias=True), atol=1e-12)


@pytest.mark.parametrize("points", [SigmaPoints(), SigmaPoints(1e-3), CUBATURE])
def test_the_points_come_nearer_to_the_truth_than_a_jacobian(points):
    rng, sensor = np.random.default_rng(1), PolarSensor()
    z = sensor.predict(rng.multivariate_normal(NEAR, COV, 400_000))

    seen = through_points(NEAR, np.linalg.cholesky(COV), sensor, points)

    jacobian = sensor.linearise(NEAR)[0]
    assert abs(seen.z_hat[0] - z[:, 0].mean()) < 0.3 * abs(jacobian[0] - z[:, 0].mean())
    np.linalg.cholesky(seen.omega + 1e-12 * np.eye(3))


def test_azimuths_that_straddle_the_back_are_not_torn_apart():
    behind = np.array([0.05, 0.0, -30.0, 0.0])

    seen = through_points(behind, np.linalg.cholesky(COV), PolarSensor(), SigmaPoints())

    assert abs(abs(seen.z_hat[1]) - math.pi) < 0.01
    assert seen.omega[1, 1] < 1e-3


def test_an_indefinite_covariance_is_lifted_and_its_neighbours_keep_their_bytes():
    sound, broken = np.eye(3) * 2.0, np.diag([1.0, 1.0, -1e-9])

    roots = cholesky(np.stack([sound, broken]))

    np.testing.assert_array_equal(roots[0], np.linalg.cholesky(sound))
    np.testing.assert_allclose(roots[1] @ roots[1].T, np.diag([1.0, 1.0, 0.0]), atol=1e-8)


def test_the_jacobian_of_any_plane_is_the_finite_difference():
    rng = np.random.default_rng(2)
    for sensor, n in ((PolarSensor(), 4), (PolarSensor((2, 0, 4, 1), doppler=False), 6), (ROAD_SENSOR, 6)):
        states = rng.normal(0.0, 10.0, (5, n)) + 15.0
        H = sensor.linearise(states)[1]
        for k in range(n):
            shift = np.zeros(n)
            shift[k] = 1e-5
            slope = sensor.difference(sensor.predict(states + shift), sensor.predict(states - shift)) / 2e-5
            np.testing.assert_allclose(H[..., k], slope, atol=1e-7)


def test_the_step_on_a_circle_keeps_the_speed_and_turns_by_the_angle():
    x = np.array([0.0, 10.0, 0.0, 0.0])

    moved, _ = velocity_step(2.0, 0.0, turn_rate_radps=0.3).move(x, np.eye(4))

    np.testing.assert_allclose(moved[[1, 3]], [10 * math.cos(0.6), 10 * math.sin(0.6)], atol=1e-12)
    np.testing.assert_allclose(moved[0], 10 / 0.3 * math.sin(0.6), atol=1e-12)
    straight = velocity_step(0.05, 2.0).F, velocity_step(0.05, 2.0, turn_rate_radps=1e-7).F
    np.testing.assert_allclose(*straight, atol=1e-8)


def test_a_linear_function_moves_through_points_as_through_its_matrix():
    motion = constant_acceleration(0.1, 1.0)
    rng = np.random.default_rng(3)
    mean, root = rng.normal(0, 1, (4, 6)), rng.normal(0, 1, (4, 6, 6))
    cov = root @ root.swapaxes(1, 2) + 0.1 * np.eye(6)

    through = NonlinearStep(lambda x: (motion.F @ x[..., None])[..., 0], motion.Q).move(mean, cov)

    for ours, exact in zip(through, motion.move(mean, cov), strict=True):
        np.testing.assert_allclose(ours, exact, atol=1e-10)


@pytest.mark.parametrize("square_root", [False, True])
@pytest.mark.parametrize(
    "rejection", [Rejection(np.zeros(30)), Rejection(np.arange(30) % 5.0, 3.0, 3.0, 0.1)]
)
def test_the_weighted_update_is_the_compiled_one(square_root, rejection):
    rng = np.random.default_rng(4)
    mean = rng.normal([-5, 0, 0, 90, -12, 0], [4, 2, 1, 30, 4, 1], (30, 6))
    root = rng.normal(0.0, 1.0, (30, 6, 6))
    prediction = Prediction(mean, root @ root.swapaxes(1, 2), 0.05 * np.eye(6)[None], np.zeros((30, 1)))
    prior = 1.5 * prediction.cov
    z_hat, H = linearise(mean)
    z = z_hat[:, None] + rng.normal(0, [1.0, 0.01, 0.5], (30, 3, 3))
    z[::3, 1, 2] = np.nan
    R = np.broadcast_to(np.diag([0.16, 5e-5, 0.04]), (30, 3, 3, 3))
    weights = rng.dirichlet(np.ones(4), 30)
    weights[::7] = [0, 0, 0, 1]
    scan = z, R, weights[:, :3], weights[:, 3]

    ours = weighted.weigh_scan(ROAD_SENSOR, *scan, z_hat=z_hat)
    compiled = correction.weigh(*scan, z_hat)

    for name in ("e", "R", "measured", "beta", "miss"):
        np.testing.assert_allclose(getattr(ours, name), getattr(compiled, name), atol=1e-14)
    here = weighted.correct(prediction, prior, H, ours, rejection, square_root=square_root)
    there = correction.correct(prediction, prior, H, compiled, rejection)
    for a, b in zip(here, there, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)


def test_leading_dimensions_are_batches_of_any_shape():
    rng = np.random.default_rng(5)
    chosen = ukf(UkfParameters(), plane(4.0, doppler=True))
    mean = rng.normal([-5, 0, 90, -12], [4, 1, 20, 3], (2, 5, 4))
    cov = np.broadcast_to(np.diag([1.0, 4.0, 1.0, 4.0]), (2, 5, 4, 4))
    R = np.diag([0.16, 5e-5, 0.04])
    flat, deep = chosen.start(mean.reshape(10, 4), cov.reshape(10, 4, 4)), chosen.start(mean, cov)
    for _ in range(3):
        z = chosen.space.sensor.predict(deep.mean)[..., None, :] + rng.normal(0, 0.01, (2, 5, 1, 3))
        beta, miss = np.full((2, 5, 1), 0.9), np.full((2, 5), 0.1)
        all_R = np.broadcast_to(R, (2, 5, 1, 3, 3))
        deep = chosen.update(chosen.predict(deep, 0.05), z, all_R, beta, miss)
        flat = chosen.update(
            chosen.predict(flat, 0.05),
            z.reshape(10, 1, 3),
            all_R.reshape(10, 1, 3, 3),
            beta.reshape(10, 1),
            miss.reshape(10),
        )

    np.testing.assert_allclose(deep.mean.reshape(10, 4), flat.mean, rtol=1e-12)
    np.testing.assert_allclose(deep.cov.reshape(10, 4, 4), flat.cov, rtol=1e-12, atol=1e-12)
