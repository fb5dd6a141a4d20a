"""PDAF, NNSF, MVFF and HPFF: against plain loops, alone and in a batch, and the bars of the HPFF paper."""

import math

import numpy as np
import pytest

from service.evaluation.reproduce.clutter_study import Case, drive, summarise
from service.simulation.preceding_vehicle import MOTIONS, Clutter, false_returns
from service.tracking.filters.converted import (
    ConversionInaccurate,
    PolarNoise,
    Returns,
    convert,
    located,
    planar_step,
)
from service.tracking.filters.single_target import (
    SINGLE_TARGET,
    SingleTargetParameters,
    hpff,
    pdaf,
    start,
)

P = SingleTargetParameters(accel_std_mps2=0.5)
NOISE = PolarNoise()


def two_scans(batch=3):
    first = located(np.broadcast_to([[1.0, 50.0]], (batch, 1, 2)), NOISE)
    second = located(np.broadcast_to([[1.0, 48.8]], (batch, 1, 2)), NOISE)
    return start(first, second, P)


def scan_of(rng, batch=3, count=6):
    z = np.array([1.0, 47.6]) + rng.normal(0.0, 1.5, (batch, count, 2))
    z[0, -1] = np.nan
    return located(z, NOISE)


def plain_pdaf(x, P0, returns, p, likelihood_of):
    """One member, one return at a time, from eq. 11-22."""
    A, Q = planar_step(p.dt_s, p.accel_std_mps2)
    x, P0 = A @ x, A @ P0 @ A.T + Q
    C = np.eye(2, 4)
    gated = []
    for z, R in zip(returns.z, returns.R, strict=True):
        S, e = C @ P0 @ C.T + R, z - C @ x
        if np.isfinite(z).all() and e @ np.linalg.inv(S) @ e <= p.gate:
            gated.append((z - C @ x, R, S, P0 @ C.T @ np.linalg.inv(S)))
    L = []
    for e, R, S, _ in gated:
        volume = math.pi * p.gate * math.sqrt(np.linalg.det(S))
        gauss = math.exp(-0.5 * e @ np.linalg.inv(S) @ e) / (
            2 * math.pi * math.sqrt(np.linalg.det(likelihood_of(S, R)))
        )
        L.append(p.detection_probability * volume * gauss / len(gated))
    none = 1 - p.detection_probability * p.gate_probability
    beta = [value / (none + sum(L)) for value in L]
    shift = sum((b * W @ e for b, (e, _, _, W) in zip(beta, gated, strict=True)), np.zeros(4))
    cov = (1 - sum(beta)) * P0 - np.outer(shift, shift)
    for b, (e, _, _, W) in zip(beta, gated, strict=True):
        cov += b * ((np.eye(4) - W @ C) @ P0 + np.outer(W @ e, W @ e))
    return x + shift, cov


@pytest.mark.parametrize("printed", [False, True])
def test_the_pdaf_is_that_of_a_plain_loop(printed):
    p = SingleTargetParameters(accel_std_mps2=0.5, printed_likelihood=printed)
    track, returns = two_scans(), scan_of(np.random.default_rng(1))

    after = pdaf(track, returns, p)

    assert 1 < after.gated.sum() < after.gated.size - 1
    for i in range(3):
        alone = Returns(returns.z[i], returns.R[i])
        mean, cov = plain_pdaf(track.mean[i], track.cov[i], alone, p, lambda S, R: R if printed else S)
        np.testing.assert_allclose(after.mean[i], mean, rtol=0, atol=1e-10)
        np.testing.assert_allclose(after.cov[i], cov, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", list(SINGLE_TARGET))
def test_a_batch_gives_what_each_member_gives_alone(name):
    step, rng = SINGLE_TARGET[name], np.random.default_rng(2)
    together, alone = two_scans(4), [two_scans(1) for _ in range(4)]
    for _ in range(12):
        returns = scan_of(rng, 4, 5)
        together = step(together, returns, P)
        alone = [step(a, Returns(returns.z[i : i + 1], returns.R[i : i + 1]), P) for i, a in enumerate(alone)]

    for i, a in enumerate(alone):
        np.testing.assert_allclose(together.mean[i], a.mean[0], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(together.cov[i], a.cov[0], rtol=1e-12, atol=1e-12)
    assert np.linalg.eigvalsh(together.cov).min() > 0


def test_the_hybrid_is_the_pdaf_until_its_gate_is_empty_and_then_starts_from_the_window():
    track = two_scans(1)
    near, far = located(np.array([[[1.0, 47.6]]]), NOISE), located(np.array([[[1.0, 20.0]]]), NOISE)

    kept, reset = hpff(track, near, P), hpff(track, far, P)

    np.testing.assert_array_equal(kept.mean, pdaf(track, near, P).mean)
    assert kept.reset.tolist() == [False]
    assert reset.reset.tolist() == [True]
    # two exact positions 1.2 m apart: the window says that it goes on like that
    np.testing.assert_allclose(reset.mean[0], [1.0, 47.6, 0.0, -4.0], atol=1e-9)


def test_returns_too_far_for_the_conversion_are_warned_of():
    with pytest.warns(ConversionInaccurate, match="want below 0.4"):
        convert(np.array([150.0]), np.array([0.1]), NOISE)

    convert(np.array([140.0, np.nan]), np.array([0.1, np.nan]), NOISE)  # 0.38: no warning


def test_the_scan_has_as_many_false_returns_as_the_gate_asks_for():
    count = false_returns(MOTIONS["M4"], Clutter(), 0.2)

    assert count[2] > count[-1] >= 1  # a gate at 88 m is larger than one at 23 m
    assert count[:2].tolist() == [0, 0]


def lost_and_position(motion, density, runs):
    truth = MOTIONS[motion]
    p = SingleTargetParameters(accel_std_mps2=0.2, printed_likelihood=True)
    clutter = Clutter(per_m2=density, miss_share=0.05 / 3)
    drives = drive(("pdaf", "hpff"), Case(truth, clutter, p), runs, (77, 1))
    return {name: summarise(d, truth) for name, d in drives.items()}


def test_the_bars_of_the_constant_motion_in_moderate_clutter_hold():
    s = lost_and_position("M4", 1e-2, 1000)

    assert s["hpff"].lost_percent <= 0.3
    assert s["hpff"].position_m <= 1.0
    assert 2.0 <= s["pdaf"].lost_percent <= 4.5


def test_the_bars_of_the_vehicle_that_slows_hold():
    s = lost_and_position("M8", 1e-2, 400)

    assert s["hpff"].lost_percent <= 1.5
    assert s["pdaf"].lost_percent >= 98.0


def test_the_bars_of_heavy_clutter_hold():
    s = lost_and_position("M4", 1e-1, 300)

    assert s["hpff"].lost_percent <= 4.0
    assert 10.0 <= s["pdaf"].lost_percent <= 20.0


def test_equal_seeds_give_equal_drives():
    case = Case(MOTIONS["M7"], Clutter(), SingleTargetParameters())
    one, two, other = (drive(("hpff",), case, 5, seed)["hpff"].mean for seed in ((1,), (1,), (2,)))

    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(one, other)
