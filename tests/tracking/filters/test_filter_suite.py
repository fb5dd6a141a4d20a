"""Accuracy of the recommended filter on road manoeuvres, against an EKF tuned on the same ones.

Monte Carlo with 30 vehicles per manoeuvre and fixed seeds, errors after 2 s. The bounds are those of a
study with 200; the paired ratios vary by about 2 % between seeds at this size and the bounds leave 3 % or
more.
"""

import dataclasses
import math

import numpy as np
import pytest

from service.evaluation.monte_carlo import (
    Runs,
    error_squared,
    lost,
    peak_position_error,
    position_and_velocity_rmse,
    run_filter,
)
from service.simulation.manoeuvres import HELD_OUT, PERIOD_S, SUITE, braking, motion_1, motion_2, stop_and_go
from service.simulation.point_radar import PointNoise, measure
from service.tracking.filters.ekf import Ekf
from service.tracking.filters.parameters import (
    PAPER_ASTEKF,
    PAPER_EKF,
    PAPER_STEKF,
    AstekfParameters,
    EkfParameters,
)
from service.tracking.filters.registry import make_filter
from service.tracking.filters.strong_tracking import Astekf
from service.tracking.filters.strong_tracking_paper import AstekfPaper, Stekf
from service.tracking.motion import constant_acceleration

pytestmark = pytest.mark.slow

RUNS = 30
AFTER = round(2.0 / PERIOD_S)
CLEAN = PointNoise()
DOPPLER = PointNoise(velocity_std_mps=0.25)
DEFECTS = {"outlier_share": 0.05, "miss_share": 0.1}
CELLS = {
    "clean": CLEAN,
    "defects": dataclasses.replace(CLEAN, **DEFECTS),
    "doppler": DOPPLER,
    "doppler, defects": dataclasses.replace(DOPPLER, **DEFECTS),
}
# the EKF of the same code: undamped, robust, its process noise the best on this suite for each kind of radar
TUNED_EKF = {False: EkfParameters(0.15, None), True: EkfParameters(0.09, None)}
MANOEUVRES = {**SUITE, **HELD_OUT}


def fly(chosen, noise, names, seed=21):
    """Return each manoeuvre's runs and truth."""
    truth = np.concatenate([np.repeat(MANOEUVRES[n]()[:, None], RUNS, axis=1) for n in names], axis=1)
    z = measure(truth, noise, np.random.default_rng(seed))
    runs = run_filter(chosen, z, noise.covariance(), PERIOD_S)
    assert np.isfinite(runs.mean[1:]).all()
    np.testing.assert_array_equal(runs.cov[1:], runs.cov[1:].swapaxes(-1, -2))
    np.linalg.cholesky(runs.cov[1:])
    assert not lost(runs, truth).any()
    parts = [slice(i * RUNS, (i + 1) * RUNS) for i in range(len(names))]
    return {
        n: (Runs(runs.mean[:, s], runs.cov[:, s]), truth[:, s]) for n, s in zip(names, parts, strict=True)
    }


def errors(flown):
    return {n: np.array(position_and_velocity_rmse(*pair, AFTER)) for n, pair in flown.items()}


def geometric_mean(values):
    return np.exp(np.mean([np.log(values[n]) for n in SUITE], axis=0))


@pytest.fixture(scope="module")
def flown():
    """Return our runs (all manoeuvres) and the tuned EKF's errors in each cell; `fly` checks every run."""
    return {
        cell: (
            fly(Astekf(), noise, tuple(MANOEUVRES)),
            errors(fly(Ekf(TUNED_EKF[noise.velocity_std_mps is not None]), noise, tuple(SUITE))),
        )
        for cell, noise in CELLS.items()
    }


@pytest.mark.parametrize(
    ("cell", "position", "velocity"),
    [
        ("clean", 0.90, 0.80),
        ("defects", 0.92, 0.83),
        ("doppler", 1.00, 0.75),
        ("doppler, defects", 1.00, 0.75),
    ],
)
def test_it_beats_the_tuned_ekf_over_the_suite(flown, cell, position, velocity):
    ours, ekf = flown[cell]

    ratio = geometric_mean(errors(ours)) / geometric_mean(ekf)

    assert ratio[0] <= position
    assert ratio[1] <= velocity


@pytest.mark.parametrize("cell", list(CELLS))
def test_no_manoeuvre_is_much_worse_than_with_the_tuned_ekf(flown, cell):
    ours, ekf = flown[cell]
    ours = errors(ours)

    for name in SUITE:
        position, velocity = ours[name] / ekf[name]
        assert position <= (1.25 if "doppler" in cell else 1.10), name
        assert velocity <= 1.20, name


@pytest.mark.parametrize(
    ("cell", "name", "position", "velocity", "peak"),
    [
        ("clean", "braking 9", 0.48, 1.9, 2.2),
        ("defects", "braking 9", 0.58, 2.2, 3.5),
        ("doppler", "braking 9", 0.36, 0.50, 1.8),
        ("doppler, defects", "braking 9", 0.36, 0.50, 1.8),
        ("clean", "swerve", 0.40, 1.30, math.inf),
    ],
)
def test_hard_manoeuvres_that_no_constant_was_tuned_on_are_followed(
    flown, cell, name, position, velocity, peak
):
    runs, truth = flown[cell][0][name]

    measured = position_and_velocity_rmse(runs, truth, AFTER)

    assert measured[0] <= position
    assert measured[1] <= velocity
    assert peak_position_error(runs, truth, AFTER) <= peak


def brake_hard(parameters):
    truth = np.repeat(braking(9.0)[:, None], RUNS, axis=1)
    z = measure(truth, DOPPLER, np.random.default_rng(22))
    return position_and_velocity_rmse(
        run_filter(Astekf(parameters), z, DOPPLER.covariance(), PERIOD_S), truth, AFTER
    )[0]


def test_it_is_the_fading_that_follows_a_braking_vehicle_through_the_gate():
    no_release = AstekfParameters(gate_release_frames=None)

    assert brake_hard(dataclasses.replace(no_release, lambda_max=1.0)) > 10 * brake_hard(no_release)


def test_without_fading_the_release_of_the_gate_saves_the_track():
    assert brake_hard(AstekfParameters(lambda_max=1.0)) < 2 * brake_hard(AstekfParameters())


def paper_row(chosen, motion):
    """Return the time means of the RMSE in y and vy from the paper's start: cold and overconfident."""
    truth = np.repeat(motion()[:, None], 100, axis=1)
    z = measure(truth, CLEAN, np.random.default_rng(23))
    mean = np.zeros((100, 6))
    mean[:, 0], mean[:, 3] = z[0, :, 0] * np.sin(z[0, :, 1]), z[0, :, 0] * np.cos(z[0, :, 1])
    cov = np.broadcast_to(np.diag([1.0, 0.1, 0.01] * 2), (100, 6, 6))
    runs = run_filter(chosen, z, CLEAN.covariance(), PERIOD_S, chosen.start(mean, cov))
    return np.sqrt(((runs.mean - truth)[1:] ** 2).mean(axis=1)).mean(axis=0)[[3, 4]]


def test_the_paper_s_forms_give_the_paper_s_range_columns_for_motion_1():
    y, vy = paper_row(AstekfPaper(PAPER_ASTEKF), motion_1)
    ekf, stekf = paper_row(Ekf(PAPER_EKF), motion_1), paper_row(Stekf(PAPER_STEKF), motion_1)

    assert 0.25 <= y <= 0.31
    assert 0.70 <= vy <= 0.90
    assert y <= 0.75 * stekf[0]
    assert vy <= 0.65 * stekf[1]
    assert y <= 0.45 * ekf[0]
    assert vy <= 0.70 * ekf[1]


def test_the_paper_s_forms_give_the_paper_s_range_columns_for_motion_2():
    y, vy = paper_row(AstekfPaper(PAPER_ASTEKF), motion_2)
    ekf, stekf = paper_row(Ekf(PAPER_EKF), motion_2), paper_row(Stekf(PAPER_STEKF), motion_2)

    assert y <= 0.39
    assert vy <= 1.10
    assert y <= 0.93 * stekf[0]
    assert vy <= 0.80 * stekf[1]
    assert vy <= 0.73 * ekf[1]


@pytest.mark.parametrize(
    ("name", "position", "velocity"),
    [
        ("cruise", 0.38, 0.42),
        ("lane change", 0.41, 0.65),
        ("braking 6", 0.47, 1.45),
        ("stop and go", 0.48, 1.45),
    ],
)
def test_everyday_manoeuvres_are_followed_this_well(flown, name, position, velocity):
    measured = errors(flown["clean"][0])[name]

    assert measured[0] <= position
    assert measured[1] <= velocity


def test_a_gentle_stop_and_go_is_followed_better_than_a_hard_one():
    truth = np.repeat(stop_and_go(2.0, 1.5)[:, None], RUNS, axis=1)
    z = measure(truth, CLEAN, np.random.default_rng(25))
    ours, ekf = (
        position_and_velocity_rmse(run_filter(f, z, CLEAN.covariance(), PERIOD_S), truth, AFTER)
        for f in (Astekf(), Ekf(TUNED_EKF[False]))
    )

    assert ekf[1] == pytest.approx(1.06, abs=0.06)  # as hard as the one for which the next two are bars
    assert ours[0] <= 0.46
    assert ours[1] <= 1.27


def test_over_the_suite_it_is_as_good_as_the_imm_and_nowhere_much_worse(flown):
    ratios = {}
    for cell, noise in CELLS.items():
        rival = errors(fly(make_filter("imm"), noise, tuple(SUITE)))
        for name, ours in errors(flown[cell][0]).items():
            if name in SUITE:
                ratios[cell, name] = math.sqrt(np.prod(ours / rival[name]))

    assert np.exp(np.mean(np.log(list(ratios.values())))) <= 1.05
    # 1.25 is aimed at, and measured with 180 vehicles a cell: 1.20; with 30 it varies by 0.03
    assert max(ratios.values()) <= 1.30, max(ratios, key=ratios.get)


def test_doppler_is_worth_a_quarter_of_the_position_and_half_of_the_velocity(flown):
    with_it, without = (geometric_mean(errors(flown[cell][0])) for cell in ("doppler", "clean"))

    assert with_it[0] <= 0.82 * without[0]
    assert with_it[1] <= 0.60 * without[1]


@pytest.mark.parametrize(
    ("noise", "least", "most"), [(CLEAN, 1.85, 2.10), (DOPPLER, 2.80, 3.15)], ids=["two channels", "three"]
)
def test_from_a_matched_start_innovations_and_errors_are_as_large_as_it_says(noise, least, most):
    rng = np.random.default_rng(24)
    P0 = np.diag([1.0, 0.1, 0.01] * 2)
    starts = rng.multivariate_normal(np.zeros(6), P0, 100)
    steps = np.stack([np.linalg.matrix_power(constant_acceleration(PERIOD_S, 0.0).F, k) for k in range(251)])
    truth = np.einsum("kij,nj->kni", steps, motion_1()[0] + starts)  # motion 1 from N(x0, P0)
    z = measure(truth, noise, rng)
    chosen = Astekf()
    start = chosen.start(np.repeat(motion_1()[:1], 100, axis=0), np.broadcast_to(P0, (100, 6, 6)))

    runs = run_filter(chosen, z, noise.covariance(), PERIOD_S, start, with_nis=True)

    assert least <= np.nanmean(runs.nis) <= most
    assert 3.0 <= error_squared(runs, truth, 1).mean() <= 6.0


@pytest.mark.parametrize(("cell", "most"), [("clean", 15.0), ("doppler", 11.0)])
def test_over_the_suite_it_is_not_much_too_sure(flown, cell, most):
    nees = [error_squared(*flown[cell][0][name], AFTER).mean() for name in SUITE]

    assert np.mean(nees) <= most
