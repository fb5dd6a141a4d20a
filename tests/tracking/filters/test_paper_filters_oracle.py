"""The strong tracking filters of the paper against a second implementation: one track, from the equations."""

import numpy as np
import pytest

from service.simulation.manoeuvres import braking
from service.simulation.point_radar import PointNoise, measure
from service.tracking.filters.parameters import AstekfPaperParameters, StekfParameters
from service.tracking.filters.strong_tracking_paper import AstekfPaper, Stekf
from service.tracking.measurement import innovation, jacobian, predict_measurement

DT_S = 0.05
NOISE = PointNoise(velocity_std_mps=0.25, outlier_share=0.05)


class ScalarFading:
    """The fading of one track: eq. 22-28; alphas of (x, vx, ax, y, vy, ay), `fixed` None to search b."""

    def __init__(self, p, alphas, fixed) -> None:
        self.p, self.alphas, self.fixed = p, np.asarray(alphas), fixed
        self.V, self.count, self.scores = np.zeros(3), 0, np.zeros(10)

    def factors(self, V, b, M, Q, H, R, seen):
        h, r = H[seen], np.linalg.inv(R[np.ix_(seen, seen)])
        N = np.diag(V[seen]) - b * R[np.ix_(seen, seen)] - np.diag(np.diag(h @ Q @ h.T))
        c = np.trace(N @ r) / (self.alphas @ np.diag(M @ h.T @ r @ h))
        return np.clip(self.alphas * c, 1.0, self.p.lambda_max)

    def fade(self, e, M, Q, H, R, seen):
        p = self.p
        S = H @ (M + Q) @ H.T + R
        nis = sum(e[a] ** 2 / S[a, a] for a in seen)
        s = 1.0 if p.clip is None else min(1.0, p.clip / nis)
        b = self.fixed
        if b is None:
            candidates = 1.0 + p.softening_step * np.arange(10)
            if self.count >= 1:
                for n, candidate in enumerate(candidates):
                    L = np.diag(np.sqrt(self.factors(self.V, candidate, M, Q, H, R, seen)))
                    S = (H @ (L @ M @ L + Q) @ H.T + R)[np.ix_(seen, seen)]
                    score = np.linalg.slogdet(S)[1] + s * e[seen] @ np.linalg.solve(S, e[seen])
                    self.scores[n] = p.score_forgetting * self.scores[n] + score
            b = p.softening_start
            if self.count >= p.warm_up:
                fit = np.polynomial.Polynomial.fit(candidates, self.scores, 5)(candidates)
                b = candidates[fit <= fit.min() + p.score_tolerance].max()
        for a in seen:
            new = s * e[a] ** 2
            self.V[a] = new if self.count == 0 else (p.forgetting * self.V[a] + new) / (1 + p.forgetting)
        L = np.diag(np.sqrt(self.factors(self.V, b, M, Q, H, R, seen)))
        self.count += 1
        faded = L @ M @ L + Q
        return M + Q if (np.diag(faded) > [1e7, 1e6, 1e5] * 2).any() else faded  # no vehicle does that


def alphas_of(p):
    return [p.alpha_position, p.alpha_velocity, p.alpha_acceleration] * 2


PAPER = AstekfPaperParameters(robust_gate=None)
STEKF = StekfParameters(robust_gate=None, softening=1.5)  # fades more often than the default
CASES = {
    "astekf-paper": (AstekfPaper(PAPER), lambda: ScalarFading(PAPER, alphas_of(PAPER), None)),
    "stekf": (Stekf(STEKF), lambda: ScalarFading(STEKF, np.ones(6), STEKF.softening)),
}


@pytest.mark.parametrize("name", list(CASES))
def test_two_implementations_agree_over_a_braking_vehicle_with_outliers(name):
    chosen, make_oracle = CASES[name]
    oracle = make_oracle()
    truth = braking(9.0)[:, None]
    z, R = measure(truth, NOISE, np.random.default_rng(31))[:, 0], NOISE.covariance()
    z[::3, 2] = np.nan
    state = chosen.start(truth[0], np.diag([1.0, 4.0, 1.0] * 2)[None])
    faded_frames = 0
    for k in range(1, len(truth)):
        prediction = chosen.predict(state, DT_S)
        seen = np.flatnonzero(np.isfinite(z[k]))
        if not len(seen):
            continue
        x, M, Q = prediction.mean[0], prediction.propagated[0], prediction.noise
        H, e = jacobian(x), innovation(z[k], predict_measurement(x))
        P = oracle.fade(e, M, Q, H, R, seen)
        faded_frames += bool(np.abs(P - M - Q).max() > 1e-6)
        h = H[seen]
        K = P @ h.T @ np.linalg.inv(h @ P @ h.T + R[np.ix_(seen, seen)])

        state = chosen.update(prediction, z[k][None, None], R[None, None], np.ones((1, 1)), np.zeros(1))

        np.testing.assert_allclose(state.mean[0], x + K @ e[seen], rtol=0, atol=1e-9)
        np.testing.assert_allclose(state.cov[0], P - K @ h @ P, rtol=0, atol=1e-9 * np.abs(P).max())
    assert faded_frames > 30
