import numpy as np
import pytest

from service.errors import InvalidInput
from service.simulation.manoeuvres import (
    HELD_OUT,
    PERIOD_S,
    SUITE,
    braking,
    cruise,
    integrate,
    lane_change,
    motion_1,
    motion_2,
    stop_and_go,
    swerve,
)


@pytest.mark.parametrize("make", [*SUITE.values(), *HELD_OUT.values()], ids=[*SUITE, *HELD_OUT])
def test_states_agree_with_one_another_and_stay_in_front_of_the_radar(make):
    truth = make()

    assert truth.shape == (251, 6)
    assert truth[:, 3].min() > 10.0
    for p, v, a in ((0, 1, 2), (3, 4, 5)):
        moved = truth[:-1, p] + PERIOD_S * truth[:-1, v] + PERIOD_S**2 / 2 * truth[:-1, a]
        np.testing.assert_allclose(truth[1:, p], moved, atol=1e-9)
        np.testing.assert_allclose(truth[1:, v], truth[:-1, v] + PERIOD_S * truth[:-1, a], atol=1e-9)


def test_motion_1_is_the_closed_form():
    t = 12.5

    np.testing.assert_allclose(motion_1()[-1, 0], -8 + 0.4 * t - 0.025 * t * t)
    np.testing.assert_allclose(motion_1()[-1, 3], 180 - 7.5 * t - 0.25 * t * t)


def test_motion_2_meets_the_way_points_of_the_paper():
    truth = motion_2()

    for y, x in ((132.0, -6.86), (85.0, -7.75), (75.0, -7.90)):
        at = np.argmin(np.abs(truth[:, 3] - y))
        assert truth[at, 0] == pytest.approx(x, abs=0.1)


def test_a_braking_vehicle_stands_after_its_braking_distance():
    truth = braking(deceleration_mps2=9.0, speed_mps=15.0, after_s=4.0)

    assert truth[-1, 4] == pytest.approx(0.0, abs=1e-9)
    # the last step of the braking is cut short: half a step of its speed is the most that it can add
    assert 135.0 - truth[-1, 3] == pytest.approx(15.0 * 4.0 + 15.0**2 / 18.0, abs=0.01)
    assert truth[:, 5].max() == pytest.approx(9.0)


def test_a_lane_change_moves_one_lane_and_no_more():
    truth = lane_change(width_m=3.5)

    assert truth[-1, 0] - truth[0, 0] == pytest.approx(3.5, abs=0.01)
    assert truth[-1, 1] == pytest.approx(0.0, abs=1e-9)
    assert np.abs(truth[:, 2]).max() == pytest.approx(2 * np.pi * 3.5 / 16.0, rel=0.01)


def test_a_swerve_goes_four_metres_aside_and_back():
    truth = swerve(lateral_mps2=4.0)

    assert truth[:, 0].max() - truth[0, 0] == pytest.approx(4.0, abs=1e-9)
    np.testing.assert_allclose(truth[-1, :2], [truth[0, 0], 0.0], atol=1e-9)
    assert np.abs(truth[:, 2]).max() == pytest.approx(4.0)


def test_stop_and_go_stands_for_a_while_and_goes_on():
    speed = -stop_and_go()[:, 4]

    assert np.abs(speed[90:130]).max() < 1e-6
    assert speed[200] > 8.0
    assert speed[-1] < 4.0


def test_a_cruise_keeps_its_speed():
    np.testing.assert_array_equal(cruise(20.0 / 3.6)[:, 4], -20.0 / 3.6)


def test_nothing_to_integrate_is_refused():
    with pytest.raises(InvalidInput, match="at least one step"):
        integrate(np.zeros(6), lambda _: (0.0, 0.0), duration_s=0.0)
