"""Boxes that lie wrong in lanes seen end-on."""

from __future__ import annotations

import numpy as np
import pytest

from service.tracking import rearranging
from service.tracking.boxes import PX, PY
from service.tracking.moved_boxes import RearrangingParameters
from service.tracking.row_direction import sure_lanes
from service.tracking.standing_rows import RowParameters, thin
from tests.tracking.standing_boxes import ACROSS_RAD, boxes, put_right
from tests.tracking.standing_points import FRAMES, points_of, queue_of

TOWARDS_RAD = np.pi
QUEUE = [(x, y, 4.4) for x in (-4.8, -1.3, 2.2) for y in (30.0, 36.5, 43.0)]
PLACES = [(x, y) for x, y, _ in QUEUE]
HERE = (-1.3, 36.5)


def with_boxes(*others, without=(HERE,), heading_rad=TOWARDS_RAD, **columns):
    """Return a box on each car of the queue but some, which lies right, and after them others."""
    places = [place for place in PLACES if place not in without]
    headings = np.array([TOWARDS_RAD] * len(places) + [heading_rad] * len(others))
    return boxes(*places, *others, heading_rad=headings, **columns)


def off_m(after, new, place):
    """Return how far a place is from the nearest centre of a box."""
    return min(
        np.hypot(np.array([*after.x_m, *new.x_m]) - place[0], np.array([*after.y_m, *new.y_m]) - place[1])
    )


def test_boxes_that_lie_in_their_lanes_are_left_alone():
    before = with_boxes((-1.0, 36.2))

    after, new = put_right(before, queue_of(*QUEUE))

    assert after is before
    assert len(new) == 0


def test_a_box_across_two_lanes_goes_onto_one_car_and_the_other_starts_a_track():
    beside = (2.2, 36.5)
    before = with_boxes((0.45, 36.3), without=(HERE, beside), heading_rad=ACROSS_RAD)

    after, new = put_right(before, queue_of(*QUEUE))

    assert after.number.tolist() == before.number.tolist()
    assert len(new) == 1
    assert max(off_m(after, new, place) for place in PLACES) < 0.7
    assert abs(np.sin(after.heading_rad[-1])) < 0.1
    assert np.isnan(after.extent_m[-1]).all()


def test_a_box_between_two_lanes_goes_onto_one_car():
    after, new = put_right(with_boxes((0.45, 36.5)), queue_of(*QUEUE))

    assert (after.x_m[-1], after.y_m[-1]) == pytest.approx(HERE, abs=0.6)
    assert len(new) == 0


def test_a_box_that_has_turned_on_its_car_is_turned_back_the_nearer_way():
    after, _ = put_right(with_boxes((-1.3, 36.8), heading_rad=0.55), queue_of(*QUEUE))

    assert after.heading_rad[-1] == pytest.approx(0.0, abs=0.1)
    assert after.number[-1] == 5 + len(QUEUE) - 1


def test_a_box_that_lies_as_its_points_do_stays_though_its_lane_leads_on():
    turned = TOWARDS_RAD + 0.7  # waiting to turn off
    car = queue_of((*HERE, 4.4), azimuth_std_rad=0.002)
    dx, dy = car[:, PX] - HERE[0], car[:, PY] - HERE[1]
    s, c = np.sin(0.7), np.cos(0.7)
    car[:, PX], car[:, PY] = HERE[0] + c * dx + s * dy, HERE[1] + c * dy - s * dx
    others = queue_of(*[other for other in QUEUE if other[:2] != HERE])
    before = with_boxes(HERE, heading_rad=turned)

    after, _ = put_right(before, np.concatenate([others, car]))

    assert after is before


def test_the_second_box_on_a_car_ends():
    before = with_boxes((-1.6, 36.0), without=(), heading_rad=0.6)

    after, new = put_right(before, queue_of(*QUEUE))

    assert after.number.tolist() == before.number[:-1].tolist()
    assert len(new) == 0


def test_of_two_boxes_between_lanes_at_one_car_one_is_put_onto_it():
    after, new = put_right(with_boxes((0.45, 36.5), (0.5, 36.0)), queue_of(*QUEUE))

    on_it = np.hypot(after.x_m - HERE[0], after.y_m - HERE[1]) < 1.0
    assert np.count_nonzero(on_it) == 1
    assert len(new) == 0


def test_a_box_over_two_roads_is_moved_once():
    apart = [(x, y, 4.4) for x in (-1.3, 5.4) for y in (30.0, 36.5, 43.0)]
    right = [(x, y) for x, y, _ in apart if y != HERE[1]]
    headings = np.array([TOWARDS_RAD] * len(right) + [ACROSS_RAD])
    lengths = np.array([4.4] * len(right) + [10.0])
    before = boxes(*right, (2.05, 36.5), heading_rad=headings).but(length_m=lengths)

    after, new = put_right(before, queue_of(*apart))

    assert (after.x_m[-1], after.y_m[-1]) == pytest.approx(HERE, abs=0.7)  # the first of the blocks
    assert (new.x_m[0], new.y_m[0]) == pytest.approx((5.4, 36.5), abs=0.7)
    assert len(new) == 1


def test_a_box_on_none_of_the_cars_is_left_alone():
    before = with_boxes((9.0, 36.5), without=(), heading_rad=0.6)

    after, _ = put_right(before, queue_of(*QUEUE))

    assert after is before


def test_where_lanes_are_not_sure_no_box_is_moved(monkeypatch):
    monkeypatch.setattr(rearranging, "sure_lanes", lambda *_: [])
    before = with_boxes((-1.3, 36.8), heading_rad=0.55)

    after, _ = put_right(before, queue_of(*QUEUE))

    assert after is before


@pytest.mark.parametrize(("rate", "tracks"), [(5.0, 1), (2.4, 0)])
def test_a_car_without_a_box_starts_a_track_if_it_is_seen_well(rate, tracks):
    others = queue_of(*[car for car in QUEUE if car[:2] != HERE])
    points = np.concatenate([others, queue_of((*HERE, 4.4), rate=rate, seed=5)])

    after, new = put_right(with_boxes(), points)

    assert len(after) == len(QUEUE) - 1
    assert len(new) == tracks
    if tracks:
        assert (new.x_m[0], new.y_m[0]) == pytest.approx(HERE, abs=0.6)


@pytest.mark.parametrize(
    ("came_m", "length_m", "moved"), [(7.0, 4.4, True), (25.0, 4.4, False), (7.0, 12.0, False)]
)
def test_what_has_come_far_or_is_long_and_was_seen_to_drive_is_not_moved(came_m, length_m, moved):
    before = with_boxes((0.45, 36.5))
    born, length = before.born_y_m.copy(), before.length_m.copy()
    born[-1] += came_m
    length[-1] = length_m

    after, _ = put_right(before.but(born_y_m=born, length_m=length), queue_of(*QUEUE))

    assert (after.x_m[-1] != before.x_m[-1]) == moved


def test_of_two_boxes_the_nearer_one_keeps_its_car():
    before = with_boxes((0.2, 36.5), HERE, heading_rad=0.6)

    after, _ = put_right(before, queue_of(*QUEUE))

    on_it = np.hypot(after.x_m - HERE[0], after.y_m - HERE[1]) < 0.7
    assert after.number[on_it].tolist() == [before.number[-1]]


def test_of_two_boxes_askew_on_one_car_one_ends():
    before = with_boxes((-1.5, 36.2), (-1.1, 36.9), heading_rad=0.6)

    after, new = put_right(before, queue_of(*QUEUE))

    assert len(after) == len(QUEUE)
    assert max(off_m(after, new, place) for place in PLACES) < 0.7


def test_a_box_that_drives_past_ends_nobody():
    mean = with_boxes(HERE, (-1.3, 36.0)).mean.copy()
    mean[-1, 4] = -8.0
    before = with_boxes(HERE, (-1.3, 36.0), mean=mean)
    heading = before.heading_rad.copy()
    heading[-2] = 0.6

    after, _ = put_right(before.but(heading_rad=heading), queue_of(*QUEUE))

    assert after.number.tolist() == before.number.tolist()


def test_a_car_of_a_row_before_a_queue_starts_one_track():
    row = points_of((-6.4, 30.0, 4.4), (0.0, 30.0, 4.4), (6.4, 30.0, 4.4), rate=6.0, noise_m=0.15)
    queue = [(x, y, 4.4) for x in (-3.5, 0.0, 3.5) for y in (35.6, 42.1, 48.6)]
    places = [(-6.4, 30.0), (6.4, 30.0), *(place[:2] for place in queue)]
    headings = np.array([ACROSS_RAD] * 2 + [TOWARDS_RAD] * len(queue))

    _, new = put_right(
        boxes(*places, heading_rad=headings), np.concatenate([row, queue_of(*queue, rate=20.0)])
    )

    assert len(new) == 1
    assert (new.x_m[0], new.y_m[0]) == pytest.approx((0.0, 30.0), abs=0.5)


def test_a_box_is_not_moved_for_little():
    parameters = RearrangingParameters(gain_nats=1e6)
    before = with_boxes((0.45, 36.3), heading_rad=ACROSS_RAD)

    after, _ = put_right(before, queue_of(*QUEUE), parameters)

    assert after is before


def lanes(points, *, driven=False, road_rad=0.0):
    x, y, times, _ = thin(points)
    known, along = np.full(len(x), driven), np.full(len(x), road_rad)
    return sure_lanes(x, y, times, FRAMES, known, along, 4.4, RowParameters())


def test_a_queue_in_lanes_is_surely_seen_end_on_and_a_row_across_is_not():
    assert sum(f.rate > 2.0 for f in lanes(queue_of(*QUEUE))) == len(QUEUE)
    rows = [(x, y, 4.4) for y in (85.0, 88.4) for x in (-3.2, 3.2)]
    assert not lanes(points_of(*rows))


def test_the_road_tells_more_surely_than_the_points():
    assert not lanes(queue_of(*QUEUE), driven=True, road_rad=ACROSS_RAD)
    assert lanes(points_of((-6.4, 78.0, 4.4), (0.0, 78.0, 4.4), (6.4, 78.0, 4.4)), driven=True)
