import pytest

from service.errors import InvalidInput
from service.tracking.filters.parameters import AstekfParameters, FilterParameters
from service.tracking.filters.registry import filter_names, make_filter


@pytest.mark.parametrize("name", filter_names())
def test_every_filter_answers_to_its_name(name):
    assert make_filter(name).name == name


def test_the_family_is_there():
    family = {"ekf", "stekf", "astekf", "astekf-paper", "ukf", "st-ukf", "ast-ukf", "mast-ukf"}
    assert family | {"srckf", "sh-ekf", "isrckf", "imm"} == set(filter_names())


def test_an_unknown_filter_is_refused_with_the_names_of_the_known():
    with pytest.raises(InvalidInput, match=r"known are .*astekf, astekf-paper, ") as caught:
        make_filter("kalman")

    assert caught.value.errors[0].pointer == "/filter"


def test_a_filter_takes_its_part_of_the_parameters():
    own = AstekfParameters(accel_std_mps2=0.2)

    assert make_filter("astekf", FilterParameters(astekf=own)).parameters == own
