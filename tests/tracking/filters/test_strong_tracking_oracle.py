"""The recommended filter against a second implementation: one track, plain loops, from the definition."""

import dataclasses
import math

import numpy as np
import pytest

from service.evaluation.monte_carlo import run_filter, two_point_start
from service.simulation.manoeuvres import braking, motion_2, stop_and_go
from service.simulation.point_radar import PointNoise, measure
from service.tracking.filters.ekf import Ekf
from service.tracking.filters.parameters import AstekfParameters, EkfParameters
from service.tracking.filters.strong_tracking import Astekf

DT_S = 0.05
HOSTILE = PointNoise(velocity_std_mps=0.25, outlier_share=0.05, miss_share=0.1)


class ScalarAstekf:
    """The adaptive strong tracking EKF for one track."""

    def __init__(self, p, mean, cov) -> None:
        self.p, self.x, self.P = p, mean.copy(), cov.copy()
        self.ebar, self.J = [0.0] * 3, [[0.0] * 10, [0.0] * 10]
        self.count = self.rejected = 0

    def step(self, z, R):
        p, T = self.p, DT_S
        phi = 1.0 if p.accel_tau_s is None else math.exp(-T / p.accel_tau_s)
        A = np.array([[1, T, T * T / 2], [0, 1, T], [0, 0, phi]])
        F, G = np.kron(np.eye(2), A), np.array([[T * T / 2, T, 1.0]])
        Q = p.accel_std_mps2**2 * np.kron(np.eye(2), G.T @ G)
        x, M = F @ self.x, F @ self.P @ F.T
        if np.isnan(z[0]):
            self.x, self.P = x, M + Q
            return
        channels = [0, 1] if np.isnan(z[2]) else [0, 1, 2]
        px, vx, _, py, vy, _ = x
        r = math.hypot(px, py)
        rate = (px * vx + py * vy) / r
        H = np.array(
            [
                [px / r, 0, 0, py / r, 0, 0],
                [py / r**2, 0, 0, -px / r**2, 0, 0],
                [vx / r - rate * px / r**2, px / r, 0, vy / r - rate * py / r**2, py / r, 0],
            ]
        )
        e = z - np.array([r, math.atan2(px, py), rate])
        e[1] = math.atan2(math.sin(e[1]), math.cos(e[1]))
        m, q = np.diag(H @ M @ H.T), np.diag(H @ Q @ H.T)
        fade = self.factors(e, m, q, np.diag(R), channels)
        u = np.array([px, py]) / r
        W = np.zeros((6, 6))
        for i in range(3):
            block = math.sqrt(fade[0][i]) * np.outer(u, u) + math.sqrt(fade[1][i]) * (
                np.eye(2) - np.outer(u, u)
            )
            W[np.ix_([i, i + 3], [i, i + 3])] = block
        Pp = W @ M @ W.T + Q
        H, e, R = H[channels], e[channels], R[np.ix_(channels, channels)]
        nis = e @ np.linalg.solve(H @ Pp @ H.T + R, e)
        k = 1.0
        if p.robust_gate is not None:
            if self.rejected < p.gate_release_frames:
                k = max(1.0, nis / p.robust_gate)
            self.rejected = self.rejected + 1 if nis > p.robust_gate else 0
        Rk = k * k * R
        K = Pp @ H.T @ np.linalg.inv(H @ Pp @ H.T + Rk)
        left = np.eye(6) - K @ H
        P = left @ Pp @ left.T + K @ Rk @ K.T
        self.x, self.P = x + K @ e, (P + P.T) / 2

    def factors(self, e, m, q, R, channels):
        p = self.p
        alphas = [p.alpha_position, p.alpha_velocity, p.alpha_acceleration]
        share = [alphas[0], alphas[0], alphas[1]]
        s = 1.0
        if p.clip is not None:
            s = min(1.0, p.clip / sum(e[j] ** 2 / (m[j] + q[j] + R[j]) for j in channels))
        g = p.statistic_gain
        old = [(2 - g) / g * b * b for b in self.ebar]
        for j in channels:
            self.ebar[j] = (1 - g) * self.ebar[j] + g * math.sqrt(s) * e[j]
        new = [(2 - g) / g * b * b for b in self.ebar]
        result = []
        for axis, members in enumerate(([j for j in channels if j != 1], [1])):
            D = sum(share[j] * m[j] / R[j] for j in members)
            tq = sum(q[j] / R[j] for j in members)

            def c_of(V, b, members=members, D=D, tq=tq):
                return (sum(V[j] / R[j] for j in members) - b * len(members) - tq) / D

            def clipped(value):
                return min(max(value, 1.0), p.lambda_max)

            candidates = [1.0 + p.softening_step * n for n in range(10)]
            if self.count >= 1:
                for n, b in enumerate(candidates):
                    score = 0.0
                    for j in members:
                        var = clipped(share[j] * c_of(old, b)) * m[j] + q[j] + R[j]
                        score += math.log(var) + s * e[j] ** 2 / var
                    self.J[axis][n] = p.score_forgetting * self.J[axis][n] + score
            beta = p.softening_start
            if self.count >= p.warm_up:
                fit = np.polynomial.Polynomial.fit(candidates, self.J[axis], 5)(np.array(candidates))
                beta = max(
                    b for b, f in zip(candidates, fit, strict=True) if f <= min(fit) + p.score_tolerance
                )
            result.append([clipped(a * c_of(new, beta)) for a in alphas])
        self.count += 1
        return result


def hostile_runs(runs=3):
    rng = np.random.default_rng(12)
    truth = np.stack([braking(9.0), stop_and_go(), motion_2()] * (runs // 3), axis=1)
    z = measure(truth, HOSTILE, rng)
    z[:, ::2, 2] = np.nan  # two of the three tracks have no Doppler
    return z, HOSTILE.covariance()


@pytest.mark.slow
def test_two_implementations_agree_over_250_steps_with_outliers_and_misses():
    z, R = hostile_runs()
    chosen = Astekf()
    start = two_point_start(chosen, z, R, DT_S)

    runs = run_filter(chosen, z, R, DT_S)

    for track in range(z.shape[1]):
        scalar = ScalarAstekf(chosen.parameters, start.mean[track], start.cov[track])
        steps = []
        for k in range(2, len(z)):
            scalar.step(z[k, track], R)
            steps.append((scalar.x, scalar.P))
        np.testing.assert_allclose(runs.mean[2:, track], [x for x, _ in steps], rtol=0, atol=1e-9)
        np.testing.assert_allclose(runs.cov[2:, track], [P for _, P in steps], rtol=0, atol=1e-9)


def test_the_second_implementation_sees_every_branch():
    z, R = hostile_runs()
    chosen = Astekf()
    state = two_point_start(chosen, z, R, DT_S)
    faded = rejected = 0
    for k in range(2, len(z)):
        beta = np.isfinite(z[k, :, :1]).astype(float)
        prediction = chosen.predict(state, DT_S)
        state = chosen.update(
            prediction, z[k][:, None], np.broadcast_to(R, (z.shape[1], 1, 3, 3)), beta, 1 - beta[:, 0]
        )
        plain = Ekf(EkfParameters(robust_gate=None)).update(
            dataclasses.replace(prediction, memory=prediction.memory[:, :1]),
            z[k][:, None],
            np.broadcast_to(R, (z.shape[1], 1, 3, 3)),
            beta,
            1 - beta[:, 0],
        )
        faded += int((np.abs(plain.cov - state.cov).max(axis=(1, 2)) > 1e-6).sum())
        rejected += int((state.memory[:, 0] > 0).sum())

    assert faded > 60
    assert rejected > 10


@pytest.mark.parametrize("doppler", [None, 0.25])
def test_without_fading_damping_and_gates_it_is_the_plain_ekf(doppler):
    noise = dataclasses.replace(HOSTILE, velocity_std_mps=doppler)
    truth = np.stack([braking(9.0), motion_2()], axis=1)
    z = measure(truth, noise, np.random.default_rng(13))
    off = AstekfParameters(lambda_max=1.0, accel_tau_s=None, robust_gate=None, clip=None, accel_std_mps2=0.12)

    ours = run_filter(Astekf(off), z, noise.covariance(), DT_S)
    plain = run_filter(
        Ekf(EkfParameters(accel_tau_s=None, robust_gate=None, accel_std_mps2=0.12)),
        z,
        noise.covariance(),
        DT_S,
    )

    np.testing.assert_allclose(ours.mean[1:], plain.mean[1:], rtol=0, atol=1e-10)
    np.testing.assert_allclose(ours.cov[1:], plain.cov[1:], rtol=0, atol=1e-10)
