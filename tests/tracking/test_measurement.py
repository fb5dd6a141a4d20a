import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.tracking.measurement import innovation, jacobian, predict_measurement

STATE = st.tuples(
    st.floats(-80.0, 80.0),
    st.floats(-30.0, 30.0),
    st.floats(-9.0, 9.0),
    st.floats(2.0, 200.0),
    st.floats(-50.0, 50.0),
    st.floats(-9.0, 9.0),
)


def test_a_vehicle_to_the_right_has_positive_azimuth_and_recedes_with_positive_rate():
    z = predict_measurement(np.array([30.0, 1.0, 0.0, 40.0, 7.0, 0.0]))

    np.testing.assert_allclose(z, [50.0, math.atan2(30.0, 40.0), (30.0 + 280.0) / 50.0])


@given(STATE, st.booleans())
def test_the_jacobian_is_the_derivative(values, behind):
    state = np.array(values) * (-1.0 if behind else 1.0)
    step = 1e-5
    numeric = np.empty((3, 6))
    for i in range(6):
        shift = np.zeros(6)
        shift[i] = step
        ahead, back = predict_measurement(state + shift), predict_measurement(state - shift)
        numeric[:, i] = innovation(ahead, back) / (2 * step)

    # central differences: error step^2 times the third derivative (at most about v/r^3 = 6), and rounding
    # 1e-10
    np.testing.assert_allclose(jacobian(state), numeric, atol=1e-7)


def test_the_difference_of_azimuths_goes_the_short_way_round():
    e = innovation(np.array([[10.0, -3.1, 1.0]]), np.array([[9.0, 3.1, 3.0]]))

    np.testing.assert_allclose(e, [[1.0, 2 * math.pi - 6.2, -2.0]])


def test_range_rate_that_was_not_measured_stays_unknown():
    e = innovation(np.array([10.0, 0.1, np.nan]), np.array([9.0, 0.0, 3.0]))

    assert np.isnan(e[2])
    assert np.isfinite(e[:2]).all()


def test_a_state_at_the_radar_itself_stays_finite():
    at_radar = np.array([0.0, 3.0, 0.0, 0.0, 4.0, 0.0])

    assert np.isfinite(predict_measurement(at_radar)).all()
    assert np.isfinite(jacobian(at_radar)).all()


@pytest.mark.parametrize("shape", [(), (4,), (2, 3)])
def test_any_batch_gives_the_same_as_one_by_one(shape):
    rng = np.random.default_rng(1)
    states = rng.normal([10, 1, 0, 80, -9, 0], 3.0, (*shape, 6))

    z, H = predict_measurement(states), jacobian(states)

    for index in np.ndindex(shape):
        np.testing.assert_array_equal(z[index], predict_measurement(states[index]))
        np.testing.assert_array_equal(H[index], jacobian(states[index]))
