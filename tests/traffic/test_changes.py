from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from service.traffic.change_evidence import ChangeParameters, depth, probability, traits_of
from service.traffic.changes import confirm, no_changes
from service.traffic.model import Lane, LaneChange, LaneMap, Samples, Trajectory
from service.traffic.paths import no_paths

START_US = 1_747_029_600_000_000
SPEED_MPS = 15.0
P = ChangeParameters()


def lane(index, x_m):
    y = np.arange(20.0, 160.0, 2.0)
    points = np.column_stack([np.full(len(y), x_m), y])
    return Lane(index, f"L{index}", "lane", "receding", points, np.full(len(y), 3.5), 1.0, 20)


LANES = LaneMap(1, START_US, 1, 40, "learned", (lane(1, 0.0), lane(2, 3.5)))


def path(number, x_of, *, from_s=-3.0, until_s=3.0, ahead_m=0.0, std_m=0.15):
    """Samples of a track at 80 m at the time 0, whose x is a function of the time."""
    t = np.arange(from_s, until_s, 0.07)
    x = np.array([x_of(s) for s in t], dtype=np.float32)
    f = np.float32
    return Samples(
        np.full(len(t), number), START_US + np.rint(1e6 * t).astype(np.int64), x,
        (80 + ahead_m + SPEED_MPS * t).astype(f), np.zeros(len(t), f), np.full(len(t), SPEED_MPS, f),
        np.ones(len(t), np.uint8), np.full(len(t), std_m, f),
    )  # fmt: skip


def together(*parts):
    columns = [field.name for field in dataclasses.fields(Samples)]
    return Samples(*(np.concatenate([getattr(part, name) for part in parts]) for name in columns))


def ramp(over_s):
    return lambda t: float(3.5 * np.clip(0.5 + t / over_s, 0, 1))


CHANGE = LaneChange(1, START_US, START_US + 600_000, 1, 2, 1.75, 80.0, SPEED_MPS, 1)


def likely(samples, change=CHANGE):
    return probability(traits_of(change, LANES, samples))


def test_a_plain_change_of_lanes_is_likely():
    traits = traits_of(CHANGE, LANES, path(1, ramp(3.0)))

    assert traits.across_mps == pytest.approx(3.5 / 3.0, abs=0.02)
    assert traits.before_m == pytest.approx(1.75, abs=0.05)
    assert traits.age_s == pytest.approx(3.0)
    assert traits.neighbour_m == 6.0
    assert probability(traits) > 0.9


def test_a_track_that_jumps_to_the_vehicle_beside_it_is_no_change():
    slip = path(1, ramp(0.2), std_m=0.4)
    other = path(2, lambda _: 3.5, from_s=-1.0, ahead_m=4.0)

    assert likely(together(slip, other)) < 0.2


def test_the_vehicle_that_is_left_behind_makes_a_change_less_likely():
    alone = path(1, ramp(2.0))

    assert likely(together(alone, path(2, lambda _: 0.5, ahead_m=2.0))) < likely(alone) - 0.05


def test_who_only_leans_over_the_boundary_at_an_uncertain_place_did_not_change():
    assert likely(path(1, lambda t: 1.75 + 0.2 * np.clip(t / 0.4, -1, 1), std_m=0.5)) < 0.5


def test_a_track_with_too_few_samples_or_in_unknown_lanes_is_not_judged():
    assert traits_of(CHANGE, LANES, path(1, ramp(3.0), from_s=0.0, until_s=0.15)) is None
    assert traits_of(dataclasses.replace(CHANGE, to_lane=7), LANES, path(1, ramp(3.0))) is None


def followed(samples):
    return dataclasses.replace(no_paths(), number=np.unique(samples.number), past=samples)


def test_a_change_is_told_after_two_seconds_of_what_followed():
    samples = path(1, ramp(3.0))
    state, told = confirm(no_changes(), [CHANGE], followed(samples), (), LANES, CHANGE.decided_us, P)
    assert told == ()
    state, told = confirm(state, (), followed(samples), (), LANES, START_US + 1_950_000, P)
    assert told == ()

    state, told = confirm(state, (), followed(samples), (), LANES, START_US + 2_000_000, P)

    assert [(x.number, x.time_us, x.decided_us) for x in told] == [(1, START_US, START_US + 2_000_000)]
    assert state.pending == ()


def test_a_change_of_a_track_that_ends_is_judged_by_what_was_seen():
    samples = path(1, ramp(2.0), until_s=1.0)
    ended = Trajectory(1, samples, float("nan"), float("nan"), 1.0)
    unknown = dataclasses.replace(CHANGE, speed_mps=float("nan"))

    state, told = confirm(no_changes(), [unknown], no_paths(), (ended,), LANES, START_US + 1_200_000, P)

    (change,) = told
    assert change.speed_mps == pytest.approx(SPEED_MPS)
    assert len(state.ended) == 1
    state, _ = confirm(state, (), no_paths(), (), LANES, START_US + 6_000_000, P)
    assert state.ended == ()


@pytest.mark.parametrize("turning", [0, 1])
def test_from_and_to_ways_through_a_junction_nobody_changes_lanes(turning):
    lanes = tuple(
        dataclasses.replace(one, kind="turn" if k == turning else "lane") for k, one in enumerate(LANES.lanes)
    )
    junction, samples = dataclasses.replace(LANES, lanes=lanes), path(1, ramp(3.0))

    state, told = confirm(no_changes(), [CHANGE], followed(samples), (), junction, START_US + 2_000_000, P)

    assert (state.pending, told) == ((), ())


def test_the_depth_is_numpys_quantile_to_the_bit():
    rng = np.random.default_rng(3)
    for count in range(1, 60):
        past_m = rng.normal(size=count)
        assert depth(past_m) == float(np.quantile(past_m, 0.9))
    assert depth(np.zeros(0)) == 0.0
