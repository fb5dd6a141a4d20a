"""The minimum-variance FIR filter: unbiased, honest about its covariance, equal to its batch form."""

import numpy as np
import pytest

from service.tracking.filters.converted import planar_step
from service.tracking.filters.fir import FirWindow, empty_window, fir_gains, fit_window

DT_S = 0.3
R = np.array([[0.5, 0.2], [0.2, 1.0]])


def windows(z, seen=None):
    shape = z.shape[:-1]
    return FirWindow(
        z, np.broadcast_to(R, (*shape, 2, 2)), np.ones(shape, np.bool_) if seen is None else seen
    )


def walk(rng, count, scans, accel):
    """Positions of random accelerations without measurement noise, and the state one step after them."""
    A, _ = planar_step(DT_S, accel)
    G = np.vstack([np.eye(2) * DT_S**2 / 2, np.eye(2) * DT_S])
    x = rng.standard_normal((count, 4)) * [50.0, 50.0, 10.0, 10.0]
    z = np.empty((count, scans, 2))
    for k in range(scans):
        z[:, k] = x[:, :2]
        x = x @ A.T + accel * rng.standard_normal((count, 2)) @ G.T
    return z, x


def test_exact_positions_of_a_steady_target_give_its_state():
    z, x = walk(np.random.default_rng(1), 20, 5, 0.0)
    seen = np.ones((20, 5), np.bool_)
    seen[::2, 2] = False

    fit = fit_window(windows(np.where(seen[..., None], z, 1e6), seen), DT_S, 3.0)

    np.testing.assert_allclose(fit.mean, x, rtol=0, atol=1e-9)  # the weights add up to nothing lost
    np.testing.assert_allclose(fit.misfit, 0.0, atol=1e-9)
    np.testing.assert_array_equal(fit.count, seen.sum(axis=1))


@pytest.mark.parametrize("accel", [0.2, 2.0, 5.0])
def test_the_covariance_is_that_of_sampled_errors(accel):
    rng = np.random.default_rng(2)
    z, x = walk(rng, 20_000, 4, accel)
    z += rng.standard_normal(z.shape) @ np.linalg.cholesky(R).T

    fit = fit_window(windows(z), DT_S, accel)

    error = fit.mean - x
    # 20,000 windows: a standard error of 1 % in each variance; the mean squared distance has 0.5 %
    np.testing.assert_allclose(error.T @ error / len(x), fit.cov[0], rtol=0.05, atol=0.03)
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(fit.cov), error).mean()
    assert nees == pytest.approx(4.0, rel=0.02)
    assert fit.misfit.mean() == pytest.approx(2 * 4 - 4, rel=0.03)


@pytest.mark.parametrize("accel", [0.2, 2.0])
def test_least_squares_and_the_batch_form_of_the_paper_agree(accel):
    z, _ = walk(np.random.default_rng(3), 50, 4, accel)
    z += np.random.default_rng(4).standard_normal(z.shape)

    fit = fit_window(windows(z), DT_S, accel)
    gains, cov, _ = fir_gains(np.broadcast_to(R, (50, 4, 2, 2)), DT_S, accel)

    np.testing.assert_allclose((gains @ z.reshape(50, 8, 1))[..., 0], fit.mean, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(cov, fit.cov, rtol=1e-10, atol=1e-10)


def test_the_filter_is_a_kalman_filter_that_knows_nothing_at_first():
    z, _ = walk(np.random.default_rng(5), 1, 5, 1.0)
    A, Q = planar_step(DT_S, 1.0)
    mean, cov = np.zeros(4), 1e7 * np.eye(4)
    for k in range(5):
        K = cov[:, :2] @ np.linalg.inv(cov[:2, :2] + R)
        mean, cov = mean + K @ (z[0, k] - mean[:2]), cov - K @ cov[:2]
        mean, cov = A @ mean, A @ cov @ A.T + Q

    fit = fit_window(windows(z), DT_S, 1.0)

    np.testing.assert_allclose(fit.mean[0], mean, rtol=1e-5, atol=1e-4)  # a prior of 1e7 is not none


def test_the_printed_covariance_is_too_large_where_the_process_noise_matters():
    _, cov, printed = fir_gains(np.broadcast_to(R, (4, 2, 2)), DT_S, 5.0)

    assert np.trace(printed[:2, :2]) > 3.0 * np.trace(cov[:2, :2])


def test_a_batch_gives_what_each_member_gives_alone():
    z, _ = walk(np.random.default_rng(6), 7, 4, 1.0)
    seen = np.random.default_rng(7).random((7, 4)) < 0.8

    together = fit_window(windows(z, seen), DT_S, 1.0)
    alone = [fit_window(windows(z[i], seen[i]), DT_S, 1.0) for i in range(7)]

    np.testing.assert_allclose(together.mean, [a.mean for a in alone], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(together.cov, [a.cov for a in alone], rtol=1e-12, atol=1e-12)


def test_fewer_than_two_positions_say_nothing():
    window = empty_window((1,), 4).push(np.ones((1, 2)), R[None], np.ones(1, np.bool_))

    fit = fit_window(window, DT_S, 1.0)

    assert np.isnan(fit.mean).all()
    assert fit.count.tolist() == [1]
