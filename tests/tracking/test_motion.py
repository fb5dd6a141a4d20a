import math

import numpy as np
import pytest

from service.errors import InvalidInput
from service.tracking.motion import LONGEST_STEP_S, constant_acceleration, constant_velocity


def test_undamped_acceleration_moves_a_point_as_in_school():
    state = np.array([[1.0, 2.0, 3.0, -4.0, 5.0, -6.0]])

    moved, _ = constant_acceleration(0.2, 0.1).move(state, np.zeros((1, 6, 6)))

    expected = [1 + 0.4 + 0.06, 2 + 0.6, 3.0, -4 + 1 - 0.12, 5 - 1.2, -6.0]
    np.testing.assert_allclose(moved[0], expected, atol=1e-12)


def test_noise_at_20_hz_is_the_paper_s():
    T, q = 0.05, 0.3
    G = np.array([T * T / 2, T, 1.0])

    for tau in (None, 1.3):
        Q = constant_acceleration(T, q, tau).Q

        np.testing.assert_allclose(Q[:3, :3], q * q * np.outer(G, G), rtol=1e-12)
        np.testing.assert_array_equal(Q[:3, 3:], 0.0)
        np.testing.assert_array_equal(Q[3:, 3:], Q[:3, :3])


@pytest.mark.parametrize("dt_s", [0.02, 0.05, 0.1, 0.7])
def test_damped_acceleration_settles_at_one_spread_whatever_the_frame_rate(dt_s):
    step = constant_acceleration(dt_s, 0.1, 1.3)
    F, Q = step.F[2, 2], step.Q[2, 2]

    settled = Q / (1.0 - F * F)

    assert settled == pytest.approx(0.1**2 / (1.0 - math.exp(-0.1 / 1.3)), rel=1e-9)


def test_undamped_noise_of_the_acceleration_grows_with_time_only():
    assert constant_acceleration(0.2, 0.1).Q[2, 2] == pytest.approx(
        4 * constant_acceleration(0.05, 0.1).Q[2, 2]
    )


def test_a_long_step_is_the_same_as_its_pieces():
    piece = constant_acceleration(LONGEST_STEP_S, 0.1, 1.3)
    F, Q = piece.F, piece.Q
    for _ in range(3):
        F, Q = piece.F @ F, piece.F @ Q @ piece.F.T + piece.Q

    whole = constant_acceleration(4 * LONGEST_STEP_S, 0.1, 1.3)

    np.testing.assert_allclose(whole.F, F, atol=1e-12)
    np.testing.assert_allclose(whole.Q, Q, atol=1e-12)


def test_a_damped_vehicle_drifts_about_as_far_in_one_long_step_as_in_the_continuous_model():
    tau, dt_s = 1.3, 2.0
    F = constant_acceleration(dt_s, 0.1, tau).F

    drift = tau * tau * (dt_s / tau - 1.0 + math.exp(-dt_s / tau))  # Singer 1970

    assert F[0, 2] == pytest.approx(drift, rel=0.15)  # pieces of 0.25 s hold the acceleration inside a piece


def test_constant_velocity_divides_time_exactly():
    half, whole = constant_velocity(0.05, 2.0), constant_velocity(0.1, 2.0)

    np.testing.assert_allclose(whole.F, half.F @ half.F, atol=1e-15)
    np.testing.assert_allclose(whole.Q, half.F @ half.Q @ half.F.T + half.Q, atol=1e-15)


def test_constant_velocity_keeps_the_six_states_positive_definite_and_its_acceleration_idle():
    step = constant_velocity(0.05, 2.0)
    mean, cov = np.array([[0.0, 10.0, 5.0, 0.0, 0.0, -5.0]]), np.eye(6)[None]
    for _ in range(50):
        mean, propagated = step.move(mean, cov)
        cov = propagated + step.Q

    np.linalg.cholesky(cov)
    np.testing.assert_allclose(mean[0], [25.0, 10.0, 0.0, 0.0, 0.0, 0.0], atol=1e-12)


def test_no_time_changes_nothing():
    step = constant_acceleration(0.0, 0.1, 1.3)

    np.testing.assert_array_equal(step.F, np.eye(6))
    np.testing.assert_array_equal(step.Q, 0.0)


@pytest.mark.parametrize("dt_s", [-0.05, math.nan, math.inf])
@pytest.mark.parametrize("model", [constant_acceleration, constant_velocity])
def test_time_that_runs_backwards_is_refused(model, dt_s):
    with pytest.raises(InvalidInput, match="time step"):
        model(dt_s, 0.1)
