"""What holds for every filter, whatever it meets."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core.registry import CPUDispatcher

from service.tracking import measurement, motion
from service.tracking.filters import correction_kernels, fading_kernels
from service.tracking.filters.base import FilterState, Prediction, join
from service.tracking.filters.registry import filter_names, make_filter
from service.tracking.measurement import predict_measurement
from service.tracking.start import initial_state, undirected_prior

STD = np.array([0.75, math.radians(0.5), 0.25])
R = np.diag(STD**2)
EVERY_FILTER = pytest.mark.parametrize("name", filter_names())


def new_tracks(chosen, rng, tracks):
    truth = rng.normal([-5, 0, 0, 90, -12, 0], [4, 1, 0, 25, 4, 0], (tracks, 6))
    z = predict_measurement(truth) + STD * rng.standard_normal((tracks, 3))
    return chosen.start(*initial_state(z, np.broadcast_to(R, (tracks, 3, 3)), undirected_prior()))


def hostile_scan(rng, prediction, many):
    """Return measurements of which some are far off, some lack Doppler, and some tracks have none."""
    tracks = len(prediction.mean)
    scale = np.where(rng.random((tracks, many, 1)) < 0.2, 30.0, 1.0)
    z = predict_measurement(prediction.mean)[:, None] + scale * STD * rng.standard_normal((tracks, many, 3))
    z[rng.random((tracks, many)) < 0.3, 2] = np.nan
    own_R = R * rng.uniform(0.2, 5.0, (tracks, many, 1, 1))
    weights = rng.dirichlet(np.full(many + 1, 0.5), tracks)
    weights[rng.random(tracks) < 0.2] = np.eye(many + 1)[-1]
    return z, own_R, weights[:, :many], 1.0 - weights[:, :many].sum(axis=1)


def assert_sound(state):
    assert np.isfinite(state.mean).all()
    assert np.isfinite(state.memory).all()
    np.testing.assert_array_equal(state.cov, state.cov.swapaxes(1, 2))
    np.linalg.cholesky(state.cov)  # raises unless positive definite


@EVERY_FILTER
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), many=st.integers(1, 4))
def test_covariances_stay_symmetric_and_positive_definite_whatever_is_measured(name, seed, many):
    rng = np.random.default_rng(seed)
    chosen = make_filter(name)
    state = new_tracks(chosen, rng, 6)
    for _ in range(40):
        dt_s = float(rng.choice([0.0, 0.05, 0.054, 0.1, 1.0], p=[0.05, 0.55, 0.2, 0.15, 0.05]))
        prediction = chosen.predict(state, dt_s)
        state = chosen.update(prediction, *hostile_scan(rng, prediction, many))
        assert_sound(state)


@EVERY_FILTER
def test_a_vehicle_that_stops_and_is_out_of_sight_for_a_while_keeps_a_sound_track(name):
    rng = np.random.default_rng(2)
    chosen = make_filter(name)
    truth = np.array([-4.0, 0, 0, 60.0, 0, 0])
    state = new_tracks(chosen, rng, 3)
    for k in range(220):
        seen = k < 80 or k >= 140
        z = (
            (predict_measurement(truth) + STD * rng.standard_normal((3, 1, 3)))
            if seen
            else np.full((3, 1, 3), np.nan)
        )
        beta = np.full((3, 1), float(seen))
        state = chosen.update(
            chosen.predict(state, 0.05), z, np.broadcast_to(R, (3, 1, 3, 3)), beta, 1 - beta[:, 0]
        )
        assert_sound(state)

    assert (
        np.hypot(state.mean[:, 0] + 4.0, state.mean[:, 3] - 60.0).max() < 2.0
    )  # about three standard deviations


@EVERY_FILTER
def test_a_track_alone_and_in_a_bank_are_one_and_the_same(name):
    rng = np.random.default_rng(3)
    chosen = make_filter(name)
    bank = new_tracks(chosen, rng, 7)
    alone = [bank.take(np.array([i])) for i in range(7)]
    for _ in range(40):
        prediction = chosen.predict(bank, 0.05)
        z, own_R, beta, miss = hostile_scan(rng, prediction, 3)
        bank = chosen.update(prediction, z, own_R, beta, miss)
        alone = [
            chosen.update(
                chosen.predict(a, 0.05), z[i : i + 1], own_R[i : i + 1], beta[i : i + 1], miss[i : i + 1]
            )
            for i, a in enumerate(alone)
        ]
        together = join(alone)
        scale = np.abs(bank.cov).max()
        np.testing.assert_allclose(together.mean, bank.mean, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(together.cov, bank.cov, rtol=1e-12, atol=1e-12 * scale)
        np.testing.assert_allclose(together.memory, bank.memory, rtol=1e-10, atol=1e-12)


@EVERY_FILTER
def test_a_miss_leaves_the_prediction_and_the_memory(name):
    rng = np.random.default_rng(4)
    chosen = make_filter(name)
    state = new_tracks(chosen, rng, 4)
    for _ in range(12):
        prediction = chosen.predict(state, 0.05)
        state = chosen.update(prediction, *hostile_scan(rng, prediction, 2))
    prediction = chosen.predict(state, 0.05)

    missed = chosen.update(
        prediction, np.zeros((4, 2, 3)), np.zeros((4, 2, 3, 3)), np.zeros((4, 2)), np.ones(4)
    )

    np.testing.assert_array_equal(missed.mean, prediction.mean)
    np.testing.assert_array_equal(missed.cov, prediction.cov)
    np.testing.assert_array_equal(missed.memory, prediction.memory)


@EVERY_FILTER
def test_an_improbable_measurement_teaches_the_statistics_nothing(name):
    rng = np.random.default_rng(5)
    chosen = make_filter(name)
    state = new_tracks(chosen, rng, 4)
    prediction = chosen.predict(state, 0.05)
    z, own_R, _, _ = hostile_scan(rng, prediction, 1)

    doubtful = chosen.update(prediction, z, own_R, np.full((4, 1), 0.05), np.full(4, 0.95))

    learnt = slice(1) if name == "imm" else slice(None)  # the states of its models move as the estimate does
    np.testing.assert_array_equal(doubtful.memory[:, learnt], prediction.memory[:, learnt])


@EVERY_FILTER
def test_no_tracks_are_a_bank_too(name):
    chosen = make_filter(name)
    state = chosen.start(np.zeros((0, 6)), np.zeros((0, 6, 6)))

    prediction = chosen.predict(state, 0.05)
    own_noise = dataclasses.replace(prediction, noise=np.zeros((0, 6, 6)))
    for many in (0, 2):
        for bank in (prediction, own_noise):
            expected = chosen.expected(bank)
            scan = np.zeros((0, many, 3)), np.zeros((0, many, 3, 3)), np.zeros((0, many)), np.zeros(0)
            state = chosen.update(bank, *scan)

            assert (expected.z_hat.shape, expected.H.shape, expected.S_prior.shape) == (
                (0, 3),
                (0, 3, 6),
                (0, 3, 3),
            )
            assert (state.mean.shape, state.cov.shape) == ((0, 6), (0, 6, 6))
            assert state.memory.shape == (0, chosen.memory_size)


@EVERY_FILTER
def test_each_track_may_have_its_own_process_noise(name):
    rng = np.random.default_rng(7)
    chosen = make_filter(name)
    state = new_tracks(chosen, rng, 5)
    prediction = chosen.predict(state, 0.05)
    scan = hostile_scan(rng, prediction, 2)
    factors = np.array([1.0, 1.0, 3.0, 1.0, 9.0])
    own = dataclasses.replace(prediction, noise=factors[:, None, None] * prediction.noise)

    together, expected = chosen.update(own, *scan), chosen.expected(own)

    for t, factor in enumerate(factors):
        one = prediction.take(np.array([t]))
        alone = dataclasses.replace(one, noise=factor * one.noise)
        after = chosen.update(alone, *(a[t : t + 1] for a in scan))
        np.testing.assert_array_equal(together.mean[t], after.mean[0])
        np.testing.assert_array_equal(together.cov[t], after.cov[0])
        np.testing.assert_array_equal(together.memory[t], after.memory[0])
        np.testing.assert_array_equal(expected.S_prior[t], chosen.expected(alone).S_prior[0])


def test_no_layout_of_the_inputs_compiles_a_kernel_again():
    rng = np.random.default_rng(8)
    for name in filter_names():
        chosen = make_filter(name)
        state = new_tracks(chosen, rng, 4)
        prediction = chosen.predict(state, 0.05)
        scan = hostile_scan(rng, prediction, 2)
        chosen.expected(prediction)
        plain = chosen.update(prediction, *scan)

        state = FilterState(*(awkward(a) for a in (state.mean, state.cov, state.memory)))
        again = chosen.predict(state, 0.05)
        parts = (again.mean, again.propagated, again.noise, again.memory)
        again = Prediction(*(awkward(a) for a in parts))
        chosen.expected(again)
        odd = chosen.update(again, *(awkward(a) for a in scan))

        np.testing.assert_array_equal(odd.mean, plain.mean)
        np.testing.assert_array_equal(odd.cov, plain.cov)
    kernels = [
        f
        for module in (motion, measurement, correction_kernels, fading_kernels)
        for f in vars(module).values()
        if isinstance(f, CPUDispatcher) and f.__module__ == module.__name__
    ]
    assert len(kernels) > 8
    assert {f.__name__ for f in kernels if len(f.signatures) > 1} == set()


def awkward(array):
    """Return the same values read-only, in the order of Fortran, and with gaps."""
    wide = np.zeros((*array.shape, 2), order="F")
    wide[..., 0] = array
    out = wide[..., 0]
    out.flags.writeable = False
    return out


@EVERY_FILTER
def test_inputs_are_left_as_they_were(name):
    rng = np.random.default_rng(6)
    chosen = make_filter(name)
    state = new_tracks(chosen, rng, 3)
    prediction = chosen.predict(state, 0.05)
    scan = hostile_scan(rng, prediction, 2)
    before = [a.copy() for a in (*scan, prediction.mean, prediction.propagated, prediction.memory, state.cov)]

    chosen.update(prediction, *scan)

    for was, now in zip(
        before, (*scan, prediction.mean, prediction.propagated, prediction.memory, state.cov), strict=True
    ):
        np.testing.assert_array_equal(was, now)


def test_after_three_rejected_frames_the_next_is_taken_as_it_is():
    chosen = make_filter("astekf")
    mean = np.array([[0.0, 0, 0, 80.0, -10, 0]])
    state = chosen.start(mean, np.diag([0.1, 0.1, 0.1] * 2)[None])
    moved = []
    for _ in range(5):
        prediction = chosen.predict(state, 0.05)
        z = predict_measurement(mean)[:, None] + [[20.0, 0.0, 0.0]]
        state = chosen.update(prediction, z, R[None, None], np.ones((1, 1)), np.zeros(1))
        moved.append(float(state.mean[0, 3] - prediction.mean[0, 3]))

    assert max(moved[:3]) < 0.5
    assert moved[3] > 2.0
