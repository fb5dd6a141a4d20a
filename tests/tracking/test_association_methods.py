"""The association by name: JPDA's weights or the most probable joint hypothesis."""

import math

import numpy as np
import pytest

from service.errors import InvalidInput
from service.tracking.association import marginals
from service.tracking.association_methods import associate

LOG_WEIGHT = np.log(np.array([[6.0, 5.0], [7.0, 1.0]]))
LOG_MISS = np.log(np.array([0.1, 0.1]))


def test_jpda_weighs_every_measurement():
    found = associate("jpda", LOG_WEIGHT, LOG_MISS)

    np.testing.assert_array_equal(found.beta, marginals(LOG_WEIGHT, LOG_MISS).beta)
    assert (found.beta > 0).all()


def test_maximum_probability_takes_the_best_joint_hypothesis_even_if_a_track_would_like_another():
    found = associate("maximum-probability", LOG_WEIGHT, LOG_MISS)

    # 6 x 1 for the nearest of the first track against 5 x 7
    np.testing.assert_array_equal(found.beta, [[0.0, 1.0], [1.0, 0.0]])
    np.testing.assert_array_equal(found.miss, [0.0, 0.0])


def test_outside_every_gate_there_is_no_measurement():
    found = associate("maximum-probability", np.full((1, 1), -math.inf), np.zeros(1))

    assert found.miss.tolist() == [1.0]


def test_an_unknown_method_is_refused():
    with pytest.raises(InvalidInput, match="known are jpda, maximum-probability"):
        associate("nearest", LOG_WEIGHT, LOG_MISS)
