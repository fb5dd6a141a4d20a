"""The cubature filters behind another vehicle, measured with a noise that nobody told them."""

import dataclasses

import numpy as np
import pytest

from service.errors import InvalidInput
from service.evaluation.traffic_study import CAR_DOPPLER, CAR_RADAR, NOISE_LEVELS, estimated_levels, follow
from service.tracking.filters.cubature import isrckf, sh_ekf, srckf
from service.tracking.filters.parameters import SageHusaParameters, SrckfParameters
from service.tracking.filters.space import plane

pytestmark = pytest.mark.slow

RUNS = 8
MAKERS = {
    "srckf": lambda space: srckf(SrckfParameters(robust_gate=None), space),
    "isrckf": lambda space: isrckf(SageHusaParameters(), space),
    "sh-ekf": lambda space: sh_ekf(SageHusaParameters(), space),
}


def louder(radar, by):
    velocity = radar.velocity_std_mps
    return dataclasses.replace(
        radar,
        range_std_m=by * radar.range_std_m,
        azimuth_std_rad=by * radar.azimuth_std_rad,
        velocity_std_mps=velocity and by * velocity,
    )


@pytest.fixture(scope="module")
def errors():
    known = {}

    def get(name, radar, accel_std, assumed):
        key = name, radar, accel_std, assumed
        if key not in known:
            space = plane(accel_std, doppler=radar.velocity_std_mps is not None)
            known[key] = follow(MAKERS[name](space), radar, louder(radar, assumed), 5, RUNS)
        return known[key]

    return get


@pytest.mark.parametrize(
    ("name", "radar", "accel_std", "assumed", "ahead", "speed"),
    [
        ("isrckf", CAR_RADAR, 1.0, 3.0, 0.80, 0.85),
        ("isrckf", CAR_RADAR, 4.0, 1.0, 1.00, 0.90),
        ("isrckf", CAR_DOPPLER, 4.0, 1.0, 1.20, 0.85),
        ("sh-ekf", CAR_RADAR, 1.0, 3.0, 0.80, 0.85),
    ],
)
def test_estimated_noises_beat_assumed_ones(errors, name, radar, accel_std, assumed, ahead, speed):
    ours, plain = (errors(each, radar, accel_std, assumed) for each in (name, "srckf"))

    assert ours.diverged == plain.diverged == 0.0
    assert ours.ahead_m <= ahead * plain.ahead_m
    assert ours.ahead_mps <= speed * plain.ahead_mps


def test_the_estimate_knows_how_good_it_is_where_the_plain_filter_does_not(errors):
    assert errors("srckf", CAR_RADAR, 1.0, 3.0).nees > 2.0
    assert 0.5 <= errors("isrckf", CAR_RADAR, 1.0, 3.0).nees <= 2.5


def test_the_noise_is_found_before_it_changes_again():
    # The process noise is the true one: where it is much too large the Doppler's noise is taken for smaller
    # (0.46 at 4 m/s^2), since the filter expects larger residuals than it has.
    chosen = isrckf(SageHusaParameters(), plane(1.0, doppler=True))

    levels = estimated_levels(chosen, CAR_DOPPLER, 6, 16)

    true = np.array(NOISE_LEVELS)[:, None]
    np.testing.assert_allclose(levels, np.broadcast_to(true, levels.shape), rtol=0.25)


def test_a_filter_without_an_estimate_has_none_to_show():
    with pytest.raises(InvalidInput, match="srckf estimates no scale"):
        estimated_levels(MAKERS["srckf"](plane(4.0, doppler=False)), CAR_RADAR, 1, 1)


def test_the_printed_estimators_fail_behind_a_braking_vehicle():
    space = plane(1.0, doppler=True)
    printed = isrckf(SageHusaParameters(form="fading"), space)

    raw = follow(printed, CAR_DOPPLER, CAR_DOPPLER, 7, RUNS, brake_mps2=4.0)

    safe = follow(MAKERS["isrckf"](space), CAR_DOPPLER, CAR_DOPPLER, 7, RUNS, brake_mps2=4.0)
    assert raw.ahead_m > 3.0 * safe.ahead_m


def test_an_unknown_form_is_refused():
    with pytest.raises(InvalidInput, match="want safe, fading or mean"):
        isrckf(SageHusaParameters(form="literal"))
