"""The studies behind the papers' tables: their truths, bounds and what they say."""

import dataclasses

import numpy as np
import pytest

from service.evaluation.reproduce.car_study import ENVIRONMENTS, Drives
from service.evaluation.reproduce.isrckf import gain_error, gains
from service.evaluation.reproduce.isrckf_states import PRINTED_S, judge, judge_all, states_table, worst_mean
from service.evaluation.reproduce.mast_study import Reading, fly, least_errors, rms_over_runs
from service.simulation.turning_target import turning_target


def test_the_turning_target_keeps_its_speed_on_its_circles_and_is_pushed_between():
    truth, steps = turning_target()
    speed = np.hypot(truth[:, 1], truth[:, 4])

    np.testing.assert_allclose(speed[:76], 70.0)
    np.testing.assert_allclose(truth[76:101, 1] - truth[75:100, 1], 0.1)
    np.testing.assert_allclose(speed[100:], speed[100])
    np.testing.assert_allclose(steps[50] @ truth[49], truth[50], atol=1e-9)
    heading = np.arctan2(truth[[40, 75], 4], truth[[40, 75], 1])
    assert (heading[1] - heading[0]) % (2 * np.pi) == pytest.approx(3.5)


def test_the_printed_positions_of_the_mast_ukf_paper_are_below_the_bound():
    x, vx, y, vy = least_errors(Reading(50.0, 0.1, 1.0))

    assert x == pytest.approx(10.1, abs=0.1)  # the paper has 1.75 to 2.32 m
    assert y == pytest.approx(3.42, abs=0.05)  # 1.01 to 1.34 m
    assert vx > 0.77
    assert vy > 0.4456


def test_an_imm_of_the_true_motions_stays_above_the_bound_and_near_it():
    reading = Reading(50.0, 0.1, 1.0)
    flight = fly(reading, ["UKF"], 8, (3,))

    x = rms_over_runs(flight.squared("UKF")[..., 0])[0]

    assert least_errors(reading)[0] < x < 3.0 * least_errors(reading)[0]


def test_the_error_of_a_drive_is_that_of_its_runs():
    truth = np.zeros((60, 24, 4))
    off = np.repeat(np.arange(1.0, 13.0), 2)  # two runs of each of twelve drives
    mean = truth + off[None, :, None]

    drives = Drives(truth, truth[..., :3], {"one": mean})

    np.testing.assert_allclose(drives.rmse("one", 2), np.arange(1.0, 13.0))
    assert len(ENVIRONMENTS) == 4


def test_the_motion_states_change_at_the_papers_times():
    judged = judge(1)

    assert judged.worst_s <= 0.1
    assert judged.changes[-1][0] == PRINTED_S[-1][0]


def test_the_times_of_the_motion_states_are_means_over_drives_of_other_noise():
    judged = judge_all(3, 1)

    times = np.array([[t for _, t in j.changes[-len(PRINTED_S) :]] for j in judged])
    cells = states_table(judged).cells
    np.testing.assert_allclose([c.ours for c in cells], times.mean(axis=0))
    np.testing.assert_allclose([c.error for c in cells], times.std(axis=0, ddof=1) / np.sqrt(3))
    assert len({tuple(row) for row in times}) == 3
    assert worst_mean(judged)[0] == pytest.approx(max(abs(c.ours - c.paper) for c in cells))
    lost = dataclasses.replace(judged[0], changes=judged[0].changes[:-1])
    assert worst_mean([*judged[1:], lost])[0] == np.inf


def test_the_standard_errors_of_the_drives_are_the_spread_over_repeated_studies():
    def study(seed):
        scale = np.random.default_rng(seed).lognormal(0.0, 0.2, (2, 1, 12 * 20, 1))  # 20 runs of each drive
        truth = np.zeros((60, 12 * 20, 4))
        return Drives(truth, truth[..., :3], {"ISRCKF": truth + scale[0], "SRCKF": truth + 2.0 * scale[1]})

    studies = [study(seed) for seed in range(60)]
    rmse = np.array([s.rmse("SRCKF", 2) for s in studies])
    median = [np.median(gains(s, "SRCKF", 2)) for s in studies]

    claimed = np.mean([s.rmse_error("SRCKF", 2) for s in studies])
    assert claimed == pytest.approx(rmse.std(axis=0, ddof=1).mean(), rel=0.15)
    claimed = np.mean([gain_error(s, "SRCKF", 2, np.mean) for s in studies])
    spread = np.std([np.mean(gains(s, "SRCKF", 2)) for s in studies], ddof=1)
    assert claimed == pytest.approx(spread, rel=0.3)
    assert np.mean(median) == pytest.approx(50.0, abs=2.0)
