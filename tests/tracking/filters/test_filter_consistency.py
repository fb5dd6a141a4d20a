"""Whether every filter's covariances are those of its errors, and its slopes those of its functions."""

import math

import numpy as np
import pytest

from service.evaluation.monte_carlo import error_squared, run_filter
from service.simulation.point_radar import PointNoise, measure
from service.tracking.filters.parameters import POINT_FILTERS
from service.tracking.filters.registry import filter_names, make_filter
from service.tracking.measurement import innovation, predict_measurement
from service.tracking.motion import constant_acceleration

DT_S = 0.05
FRAMES, TRACKS = 160, 60
RADAR = PointNoise(0.3, math.radians(0.3), 0.2)
START = np.array([-6.0, 0.0, 0.0, 110.0, -10.0, 0.0])
P0 = np.diag([0.5, 0.5, 0.1] * 2)
EVERY_FILTER = pytest.mark.parametrize("name", filter_names())


def own_motion(name):
    """Return the motion that the filter believes in; that of an accelerating vehicle for the IMM."""
    p = getattr(POINT_FILTERS, name.replace("-", "_"))
    return constant_acceleration(DT_S, p.accel_std_mps2, p.accel_tau_s)


def vehicles(motion, rng):
    """Return (FRAMES, TRACKS, 6) vehicles that move as the model says, from N(START, P0)."""
    out = np.empty((FRAMES, TRACKS, 6))
    out[0] = rng.multivariate_normal(START, P0, TRACKS)
    for k in range(1, FRAMES):
        noise = rng.multivariate_normal(np.zeros(6), motion.Q, TRACKS, method="eigh")
        out[k] = out[k - 1] @ motion.F.T + noise
    return out


@EVERY_FILTER
def test_errors_and_innovations_are_as_large_as_claimed_where_the_model_is_right(name):
    rng = np.random.default_rng(41)
    truth = vehicles(own_motion(name), rng)
    z = measure(truth, RADAR, rng)
    chosen = make_filter(name, POINT_FILTERS)
    start = chosen.start(np.repeat(START[None], TRACKS, axis=0), np.broadcast_to(P0, (TRACKS, 6, 6)))

    runs = run_filter(chosen, z, RADAR.covariance(), DT_S, start, with_nis=True)

    # 9540 innovations of three channels: their mean is known to 0.8 %; errors are alike from frame to frame
    assert 0.96 <= np.nanmean(runs.nis) / 3 <= 1.04
    assert 0.9 <= error_squared(runs, truth, 1).mean() / 6 <= 1.15


def two_tracks(rng):
    mean = rng.normal([-5, 1, 0.3, 60, -12, 0.5], [4, 1, 0.3, 15, 4, 0.3], (2, 6))
    root = rng.normal(0.0, 0.02, (2, 6, 6))
    return mean, root @ root.swapaxes(1, 2) + 1e-4 * np.eye(6)


@EVERY_FILTER
def test_the_expected_slope_is_the_finite_difference_of_the_measurement(name):
    chosen = make_filter(name, POINT_FILTERS)
    mean, cov = two_tracks(np.random.default_rng(42))
    prediction = chosen.predict(chosen.start(mean, 1e-4 * cov), 0.0)

    H = chosen.expected(prediction).H

    at = prediction.mean
    for i in range(6):
        shift = 1e-5 * np.eye(6)[i]
        slope = innovation(predict_measurement(at + shift), predict_measurement(at - shift)) / 2e-5
        np.testing.assert_allclose(H[..., i], slope, rtol=1e-4, atol=1e-5)


@EVERY_FILTER
def test_a_covariance_moves_by_the_finite_differences_of_the_mean(name):
    chosen = make_filter(name, POINT_FILTERS)
    mean, cov = two_tracks(np.random.default_rng(43))
    for part in getattr(chosen, "models", (chosen,)):  # of an IMM each, whose mixture has a spread besides
        moved = part.predict(part.start(mean, cov), 0.1)
        F = np.empty((2, 6, 6))
        for i in range(6):
            shift = 1e-4 * np.eye(6)[i]
            ahead, back = (part.predict(part.start(mean + s, cov), 0.1).mean for s in (shift, -shift))
            F[..., i] = (ahead - back) / 2e-4

        np.testing.assert_allclose(moved.propagated, F @ cov @ F.swapaxes(1, 2), rtol=1e-4, atol=1e-7)
