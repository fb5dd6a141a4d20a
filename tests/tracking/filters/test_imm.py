"""The interacting multiple models: their algebra, which model they believe, and no braking car lost."""

import dataclasses
import math

import numpy as np
import pytest

from service.evaluation.monte_carlo import lost, position_and_velocity_rmse, run_filter, two_point_start
from service.simulation.manoeuvres import PERIOD_S, braking, cruise, swerve
from service.simulation.point_radar import PointNoise, measure
from service.tracking.filters.imm import Imm, Mixture, imm, mix, sojourns, turn
from service.tracking.filters.parameters import ImmParameters
from service.tracking.filters.space import road, velocity_step
from service.tracking.filters.space_filter import SpaceFilter, Trusting

DOPPLER = PointNoise(velocity_std_mps=0.25)
HOSTILE = dataclasses.replace(DOPPLER, outlier_share=0.05, miss_share=0.1)


def test_models_that_are_all_alike_are_one_filter():
    space = road(0.3, 1.3)
    one = SpaceFilter("one", space, points=None)
    both = Imm("both", (one, one), sojourns(5.0, 2.0), 6, Trusting())
    truth = np.repeat(braking(6.0)[:, None], 4, axis=1)
    z = measure(truth, HOSTILE, np.random.default_rng(1))

    alone, together = (run_filter(each, z, HOSTILE.covariance(), PERIOD_S) for each in (one, both))

    np.testing.assert_allclose(together.mean[1:], alone.mean[1:], atol=1e-7)
    np.testing.assert_allclose(together.cov[1:], alone.cov[1:], atol=1e-7)


def test_the_moments_of_a_mixture_are_those_of_its_samples():
    rng = np.random.default_rng(2)
    weights, means = np.array([0.2, 0.8]), [np.array([0.0, 1.0]), np.array([3.0, -1.0])]
    covs = [np.diag([1.0, 2.0]), np.array([[2.0, 0.5], [0.5, 1.0]])]
    which = rng.random(200_000) < weights[0]
    drawn = [rng.multivariate_normal(m, c, len(which)) for m, c in zip(means, covs, strict=True)]
    samples = np.where(which[:, None], *drawn)

    mean, cov = mix(weights, means, covs)

    np.testing.assert_allclose(mean, samples.mean(axis=0), atol=0.02)  # six standard errors
    np.testing.assert_allclose(cov, np.cov(samples.T), atol=0.06)


def test_models_follow_an_estimate_that_was_changed_between_frames():
    chosen = imm(ImmParameters())
    truth = np.repeat(braking(6.0)[:, None], 3, axis=1)
    z = measure(truth, DOPPLER, np.random.default_rng(3))
    state = two_point_start(chosen, z, DOPPLER.covariance(), PERIOD_S)
    all_R = np.broadcast_to(DOPPLER.covariance(), (3, 1, 3, 3))
    for k in range(2, 100):
        state = chosen.update(
            chosen.predict(state, PERIOD_S), z[k, :, None], all_R, np.ones((3, 1)), np.zeros(3)
        )
    mixture = chosen.unpacked(state.memory)
    mean, cov = state.mean.copy(), state.cov.copy()
    mean[1, 0] += 2.0
    cov[1] *= 0.5

    moved = mixture.moved_to(mean, cov)

    for ours, wanted in zip(moved.moments(), (mean, cov), strict=True):
        np.testing.assert_allclose(ours, wanted, rtol=1e-9, atol=1e-9)
    for before, after in zip(mixture.parts, moved.parts, strict=True):
        np.testing.assert_array_equal(before.mean[[0, 2]], after.mean[[0, 2]])
    assert mixture.moved_to(state.mean, state.cov) is mixture
    assert isinstance(moved, Mixture)


def test_the_chances_of_a_change_add_up_and_grow_with_the_time():
    chances = sojourns(5.0, 2.0, 1.0)

    for dt_s in (0.0, 0.05, 2.0):
        np.testing.assert_allclose(chances(dt_s).sum(axis=1), 1.0)
    np.testing.assert_array_equal(chances(0.0), np.eye(3))
    assert chances(0.1)[0, 0] == pytest.approx(math.exp(-0.1 / 5.0))


def test_a_turn_is_the_circle_of_its_rate():
    rate, vx, vy = 0.4, 3.0, -9.0
    state = np.array([[5.0, vx, -rate * vy, 60.0, vy, rate * vx]])

    moved = turn(state, 1.5)[0]

    exact, _ = velocity_step(1.5, 0.0, rate).move(state[0, [0, 1, 3, 4]], np.eye(4))
    np.testing.assert_allclose(moved[[0, 1, 3, 4]], exact, atol=1e-12)
    np.testing.assert_allclose(moved[[2, 5]], [-rate * moved[4], rate * moved[1]], atol=1e-12)
    np.testing.assert_allclose(turn(np.array([1.0, 2, 0, 3, 4, 0]), 0.5), [2, 2, 0, 5, 4, 0], atol=1e-12)


def believed(truth, at):
    """Return the mean probability (3,) of the models over 20 vehicles at a time."""
    chosen = imm(ImmParameters())
    truth = np.repeat(truth[:, None], 20, axis=1)
    z = measure(truth, DOPPLER, np.random.default_rng(4))
    state = two_point_start(chosen, z, DOPPLER.covariance(), PERIOD_S)
    all_R = np.broadcast_to(DOPPLER.covariance(), (20, 1, 3, 3))
    for k in range(2, round(at / PERIOD_S)):
        prediction = chosen.predict(state, PERIOD_S)
        state = chosen.update(prediction, z[k, :, None], all_R, np.ones((20, 1)), np.zeros(20))
    return chosen.unpacked(state.memory).probability.mean(axis=0)


def test_it_believes_the_model_that_fits():
    cruising, braked = believed(cruise(), 4.0), believed(braking(9.0), 4.5)

    assert cruising.argmax() == 0
    assert braked[0] < 0.05
    assert np.isclose(cruising.sum(), 1.0)
    assert np.isclose(braked.sum(), 1.0)


@pytest.mark.slow
def test_it_never_loses_a_car_that_brakes_hard():
    truth = np.repeat(braking(9.0)[:, None], 200, axis=1)
    z = measure(truth, HOSTILE, np.random.default_rng(6))

    runs = run_filter(imm(ImmParameters()), z, HOSTILE.covariance(), PERIOD_S)

    assert int(lost(runs, truth).sum()) == 0
    position_m, velocity_mps = position_and_velocity_rmse(runs, truth, 40)
    assert position_m <= 0.36
    assert velocity_mps <= 0.50


def test_a_car_that_swerves_is_followed():
    truth = np.repeat(swerve()[:, None], 30, axis=1)
    z = measure(truth, HOSTILE, np.random.default_rng(7))

    runs = run_filter(imm(ImmParameters()), z, HOSTILE.covariance(), PERIOD_S)

    assert position_and_velocity_rmse(runs, truth, 40)[0] <= 0.45


def test_a_measurement_that_is_no_ones_changes_no_track():
    """One measurement takes a shorter way through the update than several."""
    chosen = imm(ImmParameters())
    truth = np.repeat(swerve()[:, None], 6, axis=1)
    z = measure(truth, HOSTILE, np.random.default_rng(3))
    alone = beside = two_point_start(chosen, z, HOSTILE.covariance(), PERIOD_S)
    for k in range(2, 40):
        R = np.broadcast_to(HOSTILE.covariance(), (6, 2, 3, 3))
        seen = np.isfinite(z[k]).all(axis=-1)
        beta, miss = np.stack([seen, np.zeros(6)], axis=-1).astype(float), (~seen).astype(float)
        scan = np.stack([z[k], z[k] + 0.1], axis=1)
        alone = chosen.update(chosen.predict(alone, PERIOD_S), scan[:, :1], R[:, :1], beta[:, :1], miss)
        beside = chosen.update(chosen.predict(beside, PERIOD_S), scan, R, beta, miss)

    np.testing.assert_allclose(beside.mean, alone.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(beside.cov, alone.cov, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(beside.memory, alone.memory, rtol=1e-9, atol=1e-9)
