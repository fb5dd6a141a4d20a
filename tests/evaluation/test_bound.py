"""The posterior Cramer-Rao bound against closed forms."""

import math

import numpy as np
import pytest

from service.evaluation.bound import posterior_bound
from service.tracking.motion import constant_acceleration

R = np.diag([0.75**2, math.radians(0.5) ** 2])


def test_a_standing_target_of_one_axis_averages_its_measurements():
    truth = np.tile([0.0, 0.0, 0.0, 100.0, 0.0, 0.0], (50, 1))
    still = np.diag([1.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    P0 = np.diag([4.0, 0.0, 0.0, 4.0, 0.0, 0.0])

    bound = posterior_bound(truth, R, still, np.zeros((6, 6)), P0)

    across = (100.0 * math.radians(0.5)) ** 2
    assert bound[-1, 3, 3] == pytest.approx(1.0 / (1.0 / 4.0 + 50 / 0.75**2))
    assert bound[-1, 0, 0] == pytest.approx(1.0 / (1.0 / 4.0 + 50 / across))


def test_the_information_form_gives_the_same():
    rng = np.random.default_rng(1)
    F = constant_acceleration(0.05, 0.0).F
    G = rng.standard_normal((6, 6))
    Q, P0 = 0.01 * G @ G.T, np.diag([1.0, 2.0, 3.0] * 2)
    truth = np.tile([5.0, 1.0, 0.0, 80.0, -9.0, 0.0], (20, 1))
    truth[:, 0] += np.arange(20)

    bound = posterior_bound(truth, R, F, Q, P0)

    J = np.linalg.inv(P0)
    for k, x in enumerate(truth):
        if k:
            J = np.linalg.inv(Q + F @ np.linalg.inv(J) @ F.T)
        r = math.hypot(x[0], x[3])
        H = np.zeros((2, 6))
        H[:, [0, 3]] = [[x[0] / r, x[3] / r], [x[3] / r**2, -x[0] / r**2]]
        J += H.T @ np.linalg.inv(R) @ H
        np.testing.assert_allclose(bound[k], np.linalg.inv(J), rtol=1e-9, atol=1e-12)
