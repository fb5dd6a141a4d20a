"""Boxes that stand askew in a row of vehicles."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from service.tracking import rearranging, tracker
from service.tracking.model import Frame, TrackStatus
from service.tracking.parameters import TrackerParameters
from service.tracking.rearranging import RearrangingParameters
from service.tracking.state import no_tracks
from service.tracking.tracker import coast, initial_state
from tests.tracking.standing_boxes import ACROSS_RAD, boxes, put_right
from tests.tracking.standing_points import end_on, points_of

ROW = (-29.4, 90.0, 4.4), (-23.0, 90.0, 4.4), (-16.6, 90.0, 4.4)


def all_places(after, new):
    return sorted([*after.x_m, *new.x_m])


def test_a_box_of_two_cars_goes_onto_one_and_the_other_starts_a_track():
    before = boxes((-29.4, 90.0), (-20.3, 90.0), length_m=10.5)

    after, new = put_right(before, points_of(*ROW))

    assert len(new) == 1
    assert all_places(after, new) == pytest.approx([-29.4, -23.0, -16.6], abs=0.9)
    assert list(after.number) == [5, 6]
    assert after.length_m[1] == 4.4
    assert np.isnan(after.extent_m[1]).all()  # what it learned of its length was that of two
    assert after.cov[1, 0, 0] > before.cov[1, 0, 0]


def test_a_box_across_two_rows_is_parted():
    askew = boxes((15.0, 84.7), heading_rad=-0.3, length_m=8.2, hits=np.array([20]))

    after, new = put_right(askew, points_of((13.1, 85.0, 4.4), (13.2, 88.4, 4.4), (14.9, 81.6, 4.4)))

    assert len(after) + len(new) == 3
    assert sorted([*after.y_m, *new.y_m]) == pytest.approx([81.6, 85.0, 88.4], abs=0.6)
    assert abs(np.sin(after.heading_rad[0])) == pytest.approx(1.0, abs=0.02)


def test_of_two_boxes_on_one_car_one_is_dropped():
    after, new = put_right(boxes((-20.9, 90.3), (-24.9, 89.9), (-16.6, 90.0)), points_of(*ROW[1:]))

    assert len(new) == 0
    assert sorted(after.x_m) == pytest.approx([-23.0, -16.6], abs=0.9)
    assert set(after.number) < {5, 6, 7}


@pytest.mark.parametrize("places", [((-22.6, 90.1), (-25.0, 89.9)), ((-25.0, 89.9), (-22.6, 90.1))])
def test_the_older_box_of_a_car_keeps_its_number(places):
    after, _ = put_right(boxes(*places, (-16.6, 90.0)), points_of(*ROW[1:]))

    assert after.number.tolist() == [5, 7]
    assert after.x_m == pytest.approx([-23.0, -16.6], abs=0.9)


def test_a_box_is_not_taken_off_a_car_that_would_have_none():
    weak = points_of((-23.0, 90.0, 4.4), rate=5.0), points_of((-16.6, 90.0, 4.4), rate=2.2, seed=4)
    before = boxes((-19.8, 90.0), length_m=11.2)

    after, new = put_right(before, np.concatenate(weak))

    assert after is before
    assert len(new) == 0


BUS = 20.0, 85.0, 12.0


def weak_in_the_middle(share):
    """Points of a side of 10.4 m whose middle 1.6 m give that share of the echoes of the rest."""
    ends = points_of((15.6, 85.0, 4.4), (21.6, 85.0, 4.4), noise_m=0.05, rate=6.0)
    return np.concatenate([ends, points_of((18.6, 85.0, 1.6), noise_m=0.05, rate=6.0 * share)])


def test_the_boxes_on_a_bus_become_the_oldest_of_them_and_as_long():
    after, new = put_right(boxes((23.0, 85.0), (19.4, 85.2), (16.0, 84.9), length_m=4.4), points_of(*[BUS]))

    assert after.number.tolist() == [5]
    assert (after.x_m[0], after.length_m[0]) == pytest.approx((20.0, 12.0), abs=0.9)
    assert len(new) == 0


def test_a_box_that_is_as_long_as_its_bus_is_left_alone():
    before = boxes((20.3, 85.1), length_m=12.4)

    after, new = put_right(before, points_of(*[BUS]))

    assert after is before
    assert len(new) == 0


def test_what_may_be_two_cars_is_parted_but_for_a_box_that_knows_its_length():
    points = weak_in_the_middle(0.5)

    cars, _ = put_right(boxes((15.6, 85.0), (21.6, 85.0)), points)
    truck, new = put_right(boxes((18.6, 85.0), length_m=10.4), points)

    assert cars.number.tolist() == [5, 6]
    assert truck.number.tolist() == [5]
    assert truck.length_m[0] == pytest.approx(10.4, abs=0.9)
    assert len(new) == 0


def test_what_is_long_but_not_for_certain_keeps_its_boxes():
    points = weak_in_the_middle(0.62)
    bold = dataclasses.replace(RearrangingParameters(), sure_nats=0.0)

    after, _ = put_right(boxes((15.6, 85.0), (21.6, 85.0)), points)
    united, _ = put_right(boxes((15.6, 85.0), (21.6, 85.0)), points, bold)

    assert after.number.tolist() == [5, 6]
    assert united.number.tolist() == [5]


def test_a_box_does_not_reach_over_another_on_what_may_be_two_cars():
    points = np.concatenate([weak_in_the_middle(0.62), points_of((29.0, 85.0, 4.4), rate=6.0)])
    before = boxes((15.6, 85.0), (21.6, 85.0), (29.0, 85.0), length_m=np.array([7.2, 4.4, 4.4]))

    after, new = put_right(before, points)

    assert after is before
    assert len(new) == 0


@pytest.mark.parametrize(
    "lies", [{"places": (22.4, 85.0)}, {"length_m": 7.6}, {"heading_rad": ACROSS_RAD + 0.4}]
)
def test_a_box_that_lies_ill_on_a_bus_is_put_onto_it(lies):
    before = boxes(lies.pop("places", (20.0, 85.0)), **{"length_m": 12.0, **lies})

    after, _ = put_right(before, points_of(*[BUS]))

    assert (after.x_m[0], after.length_m[0]) == pytest.approx((20.0, 12.0), abs=0.9)
    assert abs(np.sin(after.heading_rad[0])) == pytest.approx(1.0, abs=0.02)


def test_a_truck_in_the_next_lane_does_not_make_two_vehicles_one():
    two = points_of((14.3, 85.0, 5.8), (21.9, 85.0, 5.8), noise_m=0.05, rate=6.0)
    between = points_of((18.1, 85.0, 1.8), noise_m=0.05, rate=1.0)
    truck = points_of((18.1, 82.0, 13.4), noise_m=0.05, rate=6.0, seed=9)
    before = boxes((14.3, 85.0), (21.9, 85.0), (18.1, 82.0), length_m=np.array([5.8, 5.8, 13.4]))

    after, _ = put_right(before, np.concatenate([two, between, truck]))

    assert after.number.tolist() == [5, 6, 7]


def test_each_of_two_trucks_abreast_keeps_its_box():
    points = np.concatenate([points_of((20.0, 85.0, 12.0)), points_of((20.0, 88.2, 12.0), seed=9)])

    after, new = put_right(boxes((20.0, 85.0), (20.3, 86.2), length_m=12.0), points)

    assert after.number.tolist() == [5, 6]
    assert len(new) == 0


def test_a_car_beside_a_bus_that_has_its_box_starts_a_track():
    points = np.concatenate([points_of(BUS), points_of((20.5, 88.4, 4.4), seed=9)])

    after, new = put_right(boxes((20.0, 85.0), length_m=12.0), points)

    assert after.number.tolist() == [5]
    assert (new.x_m.tolist(), new.y_m.tolist()) == (
        pytest.approx([20.5], abs=0.9), pytest.approx([88.4], abs=0.9)
    )  # fmt: skip


def test_where_a_bus_drove_up_with_its_box_no_other_goes_onto_it():
    columns = {"length_m": np.array([4.4, 12.0]), "born_x_m": np.array([18.0, -40.0])}
    before = boxes((18.0, 85.0), (20.0, 85.1), **columns)

    after, new = put_right(before, points_of(*[BUS]))

    assert after.number.tolist() == [6]
    assert len(new) == 0


def test_a_bus_that_is_taken_out_of_a_box_with_a_car_starts_one_track_at_most():
    points = np.concatenate([points_of(BUS), points_of((30.4, 85.0, 4.4), seed=9)])
    held = boxes((25.5, 85.0), length_m=17.0)
    both = boxes((25.5, 85.0), (16.0, 85.0), length_m=np.array([17.0, 4.4]))

    for before in (held, both):
        after, new = put_right(before, points)
        assert all_places(after, new) == pytest.approx([20.0, 30.4], abs=0.9)


def test_a_long_box_over_two_cars_does_not_end_the_box_of_one():
    after, _ = put_right(
        boxes((18.6, 85.0), (21.6, 85.0), length_m=np.array([10.4, 4.4])), weak_in_the_middle(0.5)
    )

    assert after.number.tolist() == [5, 6]
    assert after.x_m.tolist() == pytest.approx([15.6, 21.6], abs=0.9)


def test_a_box_over_two_blocks_of_points_is_moved_once():
    blocks = points_of((-11.8, 60.0, 4.4), (-5.4, 60.0, 4.4), (3.4, 60.0, 4.4), (9.8, 60.0, 4.4), noise_m=0.1)

    after, new = put_right(boxes((-1.0, 60.0), length_m=18.5), blocks)

    assert after.number.tolist() == [5]
    assert sorted([*after.x_m, *new.x_m]) == pytest.approx([-11.8, -5.4, 3.4, 9.8], abs=0.7)


def test_a_box_that_is_put_right_forgets_how_it_lay():
    askew = boxes(
        (-23.0, 90.0), (-16.6, 90.0), heading_rad=-ACROSS_RAD + 0.45, heading_var=np.full(2, 0.003),
        ahead_m=np.full(2, 2.0), drift=np.full(2, 1.0), turn_rate_radps=np.full(2, 0.2),
    )  # fmt: skip

    after, _ = put_right(askew, points_of(*ROW[1:]))

    assert after.heading_var == pytest.approx([0.09, 0.09])  # which end is its front, it may have been wrong
    for column in (after.ahead_m, after.drift, after.turn_rate_radps):
        assert column.tolist() == [0.0, 0.0]


def test_no_more_tracks_start_at_once_than_in_other_frames(monkeypatch):
    rows = [(x, y, 4.4) for y in (60.0, 64.0, 68.0) for x in (-6.4, 0.0, 6.4)]
    points = points_of(*rows, noise_m=0.1)
    assert len(put_right(boxes((0.0, 64.0), length_m=10.5), points)[1]) > 3
    monkeypatch.setattr(rearranging, "MAX_STANDING_BOXES", 3)

    _, new = put_right(boxes((0.0, 64.0), length_m=10.5), points)

    assert len(new) == 3


def test_a_box_that_lies_across_its_row_is_turned_into_it_the_nearer_way():
    before = boxes((-23.0, 90.0), (-16.6, 90.0), heading_rad=-ACROSS_RAD + 0.45)

    after, new = put_right(before, points_of(*ROW[1:]))

    assert len(new) == 0
    assert after.heading_rad == pytest.approx([-ACROSS_RAD] * 2, abs=0.08)


def test_boxes_that_stand_well_are_left_alone():
    before = boxes((-29.2, 90.2), (-23.3, 89.8), (-16.5, 90.1))

    after, new = put_right(before, points_of(*ROW))

    assert after is before
    assert len(new) == 0


def test_a_car_whose_points_its_neighbours_claim_starts_a_track():
    after, new = put_right(boxes((-29.4, 90.0), (-16.6, 90.0)), points_of(*ROW))

    assert list(after.number) == [5, 6]
    assert new.x_m == pytest.approx([-23.0], abs=0.9)


@pytest.mark.parametrize(
    "columns",
    [
        {"born_x_m": np.array([-27.0])},  # it has come here, and was seen moving
        {"status": np.array([TrackStatus.TENTATIVE], np.uint8)},
        {"heading_rad": np.array([0.2])},  # seen end-on, for longer than a box may lie any way
    ],
)
def test_only_boxes_that_have_always_stood_there_are_moved(columns):
    before = boxes((-20.0, 90.0), length_m=10.5, **columns)

    after, new = put_right(before, points_of(*ROW[1:]))

    assert after is before
    assert len(new) == 0


def test_a_box_that_moves_is_not_moved():
    mean = np.array([[-20.0, 3.0, 0.0, 90.0, 0.0, 0.0]])

    after, _ = put_right(boxes((-20.0, 90.0), length_m=10.5, mean=mean), points_of(*ROW[1:]))

    assert after.x_m[0] == -20.0


def test_a_queue_seen_end_on_is_left_alone():
    queue = points_of((-6.4, 78.0, 4.4), (0.0, 78.0, 4.4), (6.4, 78.0, 4.4))
    before = boxes((-2.0, 73.6), (-2.0, 80.0), (-2.0, 86.4), heading_rad=0.0, hits=np.array([20, 20, 20]))

    after, new = put_right(before, end_on(queue))

    assert after is before
    assert len(new) == 0


def test_without_boxes_or_points_there_is_nothing_to_do():
    before = boxes((-20.0, 90.0), length_m=10.5)

    assert put_right(before, points_of())[0] is before
    assert len(put_right(no_tracks(0), points_of(*ROW))[1]) == 0


@pytest.mark.parametrize(
    ("frames", "first_us", "may"),
    [
        (19, -950_000, True),
        (18, -950_000, False),  # not yet
        (19, -700_000, False),  # too little of a second since a pause
    ],
)
def test_boxes_are_looked_at_once_a_second_when_it_was_seen(frames, first_us, may):
    times = tuple(range(first_us, 1, 50_000))
    state = dataclasses.replace(initial_state(), frames=frames, frame_times_us=times)
    never = TrackerParameters().with_setting("rearranging.interval_frames", "0")

    assert tracker._may_rearrange(state, 0, TrackerParameters()) == may
    assert not tracker._may_rearrange(state, 0, never)


def test_after_a_pause_a_truck_that_stands_stays_one():
    rng, p = np.random.default_rng(5), TrackerParameters()
    state, time_us = initial_state(p), 0
    for k in range(130):
        time_us += 50_000 if k != 75 else 300_000
        if k == 75:
            state, _, _ = coast(state, time_us - 20_000, p)
        n = rng.poisson(13)
        x, y = rng.uniform(-9.0, 9.0, n), 79.0 + np.where(rng.random(n) < 0.75, 0.0, rng.uniform(0.0, 2.0, n))
        state, found, _ = tracker.step(state, frame_of(time_us, k, x, y, rng), p)

    assert found.number.tolist() == [1]
    assert found.length_m[0] == pytest.approx(18.0, abs=3.0)


def frame_of(time_us, sequence, x, y, rng):
    """Return a frame of standing points with the radar's noise."""
    azimuth = np.arctan2(x, y) + rng.normal(0.0, 0.005, len(x))
    return Frame(
        sensor_id="radar-1", time_us=time_us, sequence=sequence, boot_id=None,
        range_m=(np.hypot(x, y) + rng.normal(0.0, 0.1, len(x))).astype(np.float32),
        azimuth_rad=azimuth.astype(np.float32), radial_velocity_mps=np.zeros(len(x), np.float32),
        snr_db=np.full(len(x), 20.0, np.float32),
    )  # fmt: skip


@pytest.mark.parametrize(("dropped", "resting"), [(True, []), (False, [2])])
def test_a_box_that_is_dropped_leaves_no_number_at_rest(monkeypatch, dropped, resting):
    rng, p = np.random.default_rng(3), TrackerParameters()
    monkeypatch.setattr(
        tracker,
        "rearrange",
        lambda t, *_: (t.take(~(dropped & (t.number == 2) & (t.empty > 0))), []),
    )
    state, deleted = initial_state(p), []
    for k in range(140):
        cars = np.array([-23.0, -10.0] if k < 33 else [-23.0])  # the second falls silent
        x = (cars[:, None] + rng.uniform(-2.2, 2.2, (len(cars), 5))).ravel()
        seen = frame_of(50_000 * (k + 1), k, x, np.full(len(x), 89.0), rng)
        state, _, report = tracker.step(state, seen, p)
        deleted.append(report.deleted)

    assert state.tracks.number.tolist() == [1]
    assert state.resting.number.tolist() == resting
    assert (sum(deleted), deleted[39]) == (1, dropped)
