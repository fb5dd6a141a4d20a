"""What holds for every filter, whatever it meets."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.tracking.filters.base import join
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
    np.testing.assert_array_equal(missed.memory, state.memory)


@EVERY_FILTER
def test_an_improbable_measurement_teaches_the_statistics_nothing(name):
    rng = np.random.default_rng(5)
    chosen = make_filter(name)
    state = new_tracks(chosen, rng, 4)
    prediction = chosen.predict(state, 0.05)
    z, own_R, _, _ = hostile_scan(rng, prediction, 1)

    doubtful = chosen.update(prediction, z, own_R, np.full((4, 1), 0.05), np.full(4, 0.95))

    np.testing.assert_array_equal(doubtful.memory, state.memory)


@EVERY_FILTER
def test_no_tracks_are_a_bank_too(name):
    chosen = make_filter(name)
    state = chosen.start(np.zeros((0, 6)), np.zeros((0, 6, 6)))

    state = chosen.update(
        chosen.predict(state, 0.05),
        np.zeros((0, 2, 3)),
        np.zeros((0, 2, 3, 3)),
        np.zeros((0, 2)),
        np.zeros(0),
    )

    assert len(state) == 0
    assert state.memory.shape == (0, chosen.memory_size)


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
