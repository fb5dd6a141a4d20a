"""The unscented filters in traffic, against a plain UKF with the same process noise.

Twelve vehicles and a seed of their own. Ratios
of paired runs vary by about 2 % between seeds of 30 vehicles, and the bounds leave at least that.
"""

import dataclasses
import math

import pytest

from service.errors import InvalidInput
from service.evaluation.traffic_study import DEFECTS, DOPPLER, RADAR, fly
from service.tracking.filters.mast_ukf import mast_ukf
from service.tracking.filters.parameters import MastUkfParameters, StUkfParameters, UkfParameters
from service.tracking.filters.space import plane
from service.tracking.filters.ukf import ast_ukf, st_ukf, ukf

pytestmark = pytest.mark.slow

PLAIN = UkfParameters(robust_gate=None)
STRONG = StUkfParameters(robust_gate=None)
MAKERS = {
    "ukf": lambda space: ukf(PLAIN, space),
    "st-ukf": lambda space: st_ukf(STRONG, space),
    "ast-ukf": lambda space: ast_ukf(STRONG, space),
    "mast-ukf": lambda space: mast_ukf(MastUkfParameters(), space),
}


@pytest.fixture(scope="module")
def errors():
    """Return a function that flies a filter once for each setting asked for."""
    known = {}

    def get(name, accel_std, radar, **defects):
        key = name, accel_std, radar, tuple(defects.items())
        if key not in known:
            space = plane(accel_std, doppler=radar.velocity_std_mps is not None)
            known[key] = fly(MAKERS[name](space), dataclasses.replace(radar, **defects), radar, 3, 12)
        return known[key]

    return get


@pytest.mark.parametrize(
    ("accel_std", "radar", "defects", "position", "velocity"),
    [
        (4.0, RADAR, {}, 0.95, 1.00),
        (4.0, RADAR, DEFECTS, 0.80, 0.95),
        (4.0, DOPPLER, {}, 1.10, 1.00),
        (4.0, DOPPLER, DEFECTS, 0.90, 0.85),
        (1.0, RADAR, {}, 0.50, 0.80),
    ],
)
def test_the_safe_mast_ukf_beats_the_ukf(errors, accel_std, radar, defects, position, velocity):
    ours, plain = (errors(name, accel_std, radar, **defects) for name in ("mast-ukf", "ukf"))

    assert ours.diverged == plain.diverged == 0.0
    assert ours.position_m <= position * plain.position_m
    assert ours.velocity_mps <= velocity * plain.velocity_mps


def test_the_safe_mast_ukf_knows_how_good_it_is(errors):
    ours = errors("mast-ukf", 4.0, RADAR)

    assert 0.6 <= ours.nees <= 1.4
    assert 0.7 <= ours.nis <= 1.2


@pytest.mark.parametrize("name", ["st-ukf", "ast-ukf"])
@pytest.mark.parametrize(
    ("accel_std", "defects", "position", "velocity"),
    [(4.0, {}, 1.05, 1.05), (4.0, DEFECTS, 1.15, 1.15), (1.0, {}, 0.75, math.inf)],
)
def test_fading_costs_little_and_helps_a_filter_that_is_too_stiff(
    errors, name, accel_std, defects, position, velocity
):
    ours, plain = (errors(each, accel_std, RADAR, **defects) for each in (name, "ukf"))

    assert ours.diverged == 0.0
    assert ours.position_m <= position * plain.position_m
    assert ours.velocity_mps <= velocity * plain.velocity_mps


def test_a_spread_of_a_thousandth_changes_nothing_in_double_precision(errors):
    narrow = fly(
        ukf(UkfParameters(spread=1e-3, robust_gate=None), plane(4.0, doppler=False)), RADAR, RADAR, 3, 12
    )
    wide = errors("ukf", 4.0, RADAR)

    assert narrow.position_m == pytest.approx(wide.position_m, rel=1e-3)
    assert narrow.velocity_mps == pytest.approx(wide.velocity_mps, rel=1e-3)


def test_the_printed_form_loses_vehicles_that_manoeuvre():
    printed = fly(mast_ukf(MastUkfParameters(form="printed"), plane(1.0, doppler=False)), RADAR, RADAR, 3, 12)

    assert printed.diverged > 0.2


def test_the_paper_s_form_is_several_times_worse_than_a_ukf(errors):
    paper = fly(mast_ukf(MastUkfParameters(form="paper"), plane(4.0, doppler=False)), RADAR, RADAR, 3, 12)

    assert paper.position_m > 2.0 * errors("ukf", 4.0, RADAR).position_m


def test_an_unknown_form_is_refused():
    with pytest.raises(InvalidInput, match="want safe, paper or printed"):
        mast_ukf(MastUkfParameters(form="literal"))
