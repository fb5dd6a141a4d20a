"""Numbers of vehicles that fell silent in view: which of them rest, and who is given one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from service.tracking import lifecycle, snapshot
from service.tracking.model import TrackStatus
from service.tracking.parameters import TrackerParameters
from service.tracking.resting import RestingParameters, awaited, expire, settle
from service.tracking.state import Resting, Tracks, no_tracks, none_resting
from service.tracking.tracker import TrackerState, coast, initial_state
from tests.tracking.test_tracker import PERIOD_US, T0_US, frame, numbers, run, vehicle

P = RestingParameters()
VIEW = (15.0, 150.0, 0.8)
LOST_US, BACK_US = 10_000_000, 16_000_000  # when the tracks below end, and when they come again
HIT_US, BORN_US = 9_000_000, 15_500_000  # of the track that ends, and of one that is found later


def tracks(*rows, **columns):
    """Confirmed tracks in one lane that drive away at 2 m/s: each row is a number and y, or number, x and y.

    `columns` exchanges whole columns: one value a track, or one for all.
    """
    n, empty = len(rows), no_tracks(0)
    blank = (getattr(empty, field.name) for field in dataclasses.fields(empty))
    made = Tracks(*(np.zeros((n, *column.shape[1:]), column.dtype) for column in blank))
    mean = np.zeros((n, 6))
    mean[:, 0], mean[:, 3] = [row[1] if len(row) == 3 else 0.0 for row in rows], [row[-1] for row in rows]
    mean[:, 4] = columns.pop("speed_mps", 2.0)
    filled = {
        "width_m": 1.9, "hits": 40, "hit_us": LOST_US,
        "born_us": 0, "status": TrackStatus.CONFIRMED, "empty": 0, **columns,
    }  # fmt: skip
    whole = {name: np.full(n, value, getattr(made, name).dtype) for name, value in filled.items()}
    return made.but(number=np.array([row[0] for row in rows], np.int64), mean=mean, **whole)


def silent(*rows, number=2, **columns):
    """As `tracks`, but one of them has had no points for a second."""
    gone = np.array([row[0] == number for row in rows])
    return tracks(*rows, **{"empty": 20 * gone, "hit_us": np.where(gone, HIT_US, LOST_US), **columns})


QUEUE = ((1, 60.0), (2, 50.0), (3, 40.0))  # a leader, the one that will be hidden, and a follower


def at_rest(before=None, p=P, number=2):
    """What rests when that number is among the tracks no more."""
    before = silent(*QUEUE) if before is None else before
    resting, left = settle(none_resting(), before, before.take(before.number != number), LOST_US, VIEW, p)
    assert number not in left.number
    return resting


def found(resting, *rows, time_us=BACK_US, born_us=BORN_US, p=P, **columns):
    """What rests, and the tracks, when the last of these has just been confirmed."""
    fresh = tracks(*rows, **{"born_us": [*[0] * (len(rows) - 1), born_us], **columns})
    status = fresh.status.copy()
    status[-1] = TrackStatus.TENTATIVE
    return settle(resting, fresh.but(status=status), fresh, time_us, VIEW, p)


def test_a_vehicle_that_was_hidden_in_a_queue_is_given_its_number_again():
    resting = at_rest()
    assert resting.number.tolist() == [2]

    resting, after = found(resting, (1, 70.0), (3, 50.0), (9, 60.0))  # all went on by ten metres

    assert after.number.tolist() == [1, 2, 3]
    assert after.y_m.tolist() == [70.0, 60.0, 50.0]
    assert not len(resting.number)
    assert not len(resting.mate_of)


def test_where_the_queue_stood_it_is_found_where_it_was():
    _, after = found(at_rest(), (1, 60.5), (3, 40.0), (9, 50.5), speed_mps=0.0)

    assert after.number.tolist() == [1, 2, 3]


def test_one_that_the_order_of_the_queue_has_passed_by_is_another_vehicle():
    resting, after = found(at_rest(), (1, 70.0), (3, 60.0), (9, 55.0))  # the follower is ahead of it

    assert after.number.tolist() == [1, 3, 9]
    assert resting.number.tolist() == [2]


def test_one_that_is_ahead_of_the_leader_is_another_vehicle():
    _, after = found(at_rest(), (1, 53.0), (3, 50.0), (9, 60.0))

    assert after.number.tolist() == [1, 3, 9]


def test_who_left_the_lane_has_no_say_in_the_order():
    _, after = found(at_rest(), (1, 70.0), (3, 3.5, 62.0), (9, 60.0))  # the follower overtakes beside it

    assert after.number.tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("place", "changed"),
    [
        ((9, 3.5, 60.0), {}),  # in the next lane
        ((9, 45.0), {}),  # where it would have gone back
        ((9, 60.0), {"heading_rad": [0.0, 0.0, 1.0]}),  # turned
        ((9, 60.0), {"heading_rad": [0.0, 0.0, np.pi]}),
        ((9, 60.0), {"born_us": HIT_US}),  # it was there when the other was still seen
        ((9, 60.0), {"time_us": HIT_US + 30_000_001, "born_us": HIT_US + 29_000_000}),
    ],
)
def test_who_cannot_be_the_vehicle_gets_no_number(place, changed):
    _, after = found(at_rest(), (1, 70.0), (3, 50.0), place, **changed)

    assert after.number.tolist() == [1, 3, 9]


@pytest.mark.parametrize(
    ("std_rad", "turned_rad", "numbers"),
    [(0.3, 1.1, [1, 2, 3]), (0.3, 1.3, [1, 3, 9]), (0.8, 2.1, [1, 2, 3])],
)
def test_a_heading_that_is_a_guess_keeps_nobody_from_its_number(std_rad, turned_rad, numbers):
    _, after = found(
        at_rest(), (1, 70.0), (3, 50.0), (9, 60.0), heading_rad=[0.0, 0.0, turned_rad],
        heading_var=[0.0, 0.0, std_rad**2],
    )  # fmt: skip

    assert after.number.tolist() == numbers


def test_a_number_is_given_back_up_to_the_end_of_its_rest():
    last_us = HIT_US + 30_000_000

    _, after = found(at_rest(), (1, 70.0), (3, 50.0), (9, 60.0), time_us=last_us, born_us=last_us - 500_000)

    assert after.number.tolist() == [1, 2, 3]


def test_no_vehicle_gets_farther_than_its_speed_allows():
    leader_only = at_rest(silent((1, 60.0), (2, 50.0)))
    most_m = 2.0 * 7.0 + 0.5 * P.accel_mps2 * P.accel_s**2 + P.slack_m  # seven seconds after its last hit

    # the leader left at once, so that it would be where the vehicle is found
    _, near = found(leader_only, (1, 60.0 + most_m), (9, 50.0 + most_m - 0.1))
    _, far = found(leader_only, (1, 60.0 + most_m), (9, 50.0 + most_m + 0.1))

    assert near.number.tolist() == [1, 2]
    assert far.number.tolist() == [1, 9]


def test_it_is_not_far_from_where_those_of_its_lane_went():
    followed = at_rest(silent((2, 50.0), (3, 40.0)))

    _, near = found(followed, (3, 42.0), (9, 52.0 + P.led_m - 0.1))
    _, far = found(followed, (3, 42.0), (9, 52.0 + P.led_m + 0.1))

    assert near.number.tolist() == [2, 3]
    assert far.number.tolist() == [3, 9]


def test_alone_in_its_lane_it_is_found_where_its_speed_says():
    alone = at_rest(silent((2, 50.0), speed_mps=10.0))
    span_m = P.alone_m + P.alone_mps * 7.0  # the more the longer since its last hit
    expected_m = 50.0 + 10.0 * 6.0  # from where its track ended

    _, near = found(alone, (9, expected_m - span_m + 0.1), speed_mps=10.0)
    _, behind = found(alone, (9, expected_m - span_m - 0.1), speed_mps=10.0)
    _, ahead = found(alone, (9, expected_m + 7.0), speed_mps=10.0)

    assert near.number.tolist() == [2]
    assert behind.number.tolist() == [9]
    assert ahead.number.tolist() == [2]


@pytest.mark.parametrize(("back_m", "number"), [(P.slack_m - 0.1, 2), (P.slack_m + 0.1, 9)])
def test_it_does_not_go_back_by_more_than_its_place_may_be_wrong(back_m, number):
    alone = at_rest(silent((2, 50.0), speed_mps=0.0))

    _, after = found(alone, (9, 50.0 - back_m), speed_mps=0.0)

    assert after.number.tolist() == [number]


def test_the_time_for_which_its_track_coasted_is_no_way_that_it_still_has_to_go():
    """Behind a truck a track coasts for two seconds: its last place is that many metres on."""
    before = silent((2, 80.0), speed_mps=15.0, hit_us=LOST_US - 2_000_000)

    _, after = found(
        at_rest(before), (9, 80.0 + 15.0 * 3.0), speed_mps=15.0, time_us=LOST_US + 3_000_000,
        born_us=LOST_US + 2_500_000,
    )  # fmt: skip

    assert after.number.tolist() == [2]


@pytest.mark.parametrize(
    "changed",
    [
        {"hits": P.least_hits - 1},
        {"empty": 0},  # it still had points: another track took its place
        {"status": [TrackStatus.CONFIRMED, TrackStatus.TENTATIVE, TrackStatus.CONFIRMED]},
    ],
)
def test_a_track_that_hardly_was_a_vehicle_does_not_rest(changed):
    assert not len(at_rest(silent(*QUEUE, **changed)).number)


def test_a_track_with_hits_enough_rests():
    assert at_rest(silent(*QUEUE, hits=P.least_hits)).number.tolist() == [2]


@pytest.mark.parametrize(("apart_m", "rests"), [(P.apart_m - 0.1, []), (P.apart_m + 0.1, [2])])
def test_a_track_that_ended_beside_another_was_the_same_vehicle(apart_m, rests):
    before = silent((1, 50.0 + apart_m), (2, 50.0))

    assert at_rest(before).number.tolist() == rests


def test_a_tentative_track_beside_it_is_no_other_vehicle():
    before = silent((1, 51.0), (2, 50.0), status=[TrackStatus.TENTATIVE, TrackStatus.CONFIRMED])

    assert at_rest(before).number.tolist() == [2]


@pytest.mark.parametrize(
    ("y_m", "rests"),
    [
        (VIEW[0] + P.edge_m - 0.1, []),
        (VIEW[0] + P.edge_m + 0.1, [2]),
        (VIEW[1] - P.edge_m - 0.1, [2]),
        (VIEW[1] - P.edge_m + 0.1, []),
    ],
)
def test_what_was_at_the_edge_of_the_view_has_left_it(y_m, rests):
    assert at_rest(silent((2, y_m))).number.tolist() == rests


def beside_a_faint_one(p=P, **columns):
    """The numbers when a vehicle is seen ten metres ahead of where a settled track was left behind."""
    usual = {"empty": [0, 15, 0, 0], "log_odds": [6.0, -1.0, 6.0, 3.0], "born_us": [0, 0, 0, BORN_US]}
    usual |= {"hit_us": [BACK_US, HIT_US, BACK_US, BACK_US]}
    after = tracks((1, 70.0), (2, 50.0), (3, 40.0), (9, 60.0), **(usual | columns))
    status = after.status.copy()
    status[-1] = TrackStatus.TENTATIVE
    resting, after = settle(none_resting(), after.but(status=status), after, BACK_US, VIEW, p)
    assert not len(resting.number)
    return dict(zip(after.number.tolist(), after.y_m.tolist(), strict=True))


def test_a_box_that_was_left_behind_gives_its_number_before_it_ends():
    assert beside_a_faint_one() == {1: 70.0, 2: 60.0, 3: 40.0}


def test_without_a_rest_a_box_left_behind_keeps_its_number():
    assert beside_a_faint_one(RestingParameters(keep_s=0.0)) == {1: 70.0, 2: 50.0, 3: 40.0, 9: 60.0}


@pytest.mark.parametrize(
    "columns",
    [
        {"empty": [0, 5, 0, 0]},
        {"log_odds": [6.0, 1.0, 6.0, 3.0]},
        {"hit_us": [BACK_US, BORN_US + 1, BACK_US, BACK_US]},  # both were seen at once
    ],
)
def test_a_box_that_may_well_be_a_vehicle_keeps_its_number(columns):
    assert beside_a_faint_one(**columns) == {1: 70.0, 2: 50.0, 3: 40.0, 9: 60.0}


def test_a_motorcycle_has_no_say_in_the_order():
    before = silent((1, 60.0), (2, 50.0), (3, 40.0), width_m=[1.9, 1.9, 0.9])
    _, after = found(at_rest(before), (1, 62.0), (3, 60.0), (9, 52.0), width_m=[1.9, 0.9, 1.9])

    assert after.number.tolist() == [1, 2, 3]


def test_what_left_the_view_sideways_does_not_rest():
    gone = silent((1, 60.0), (2, 46.0, 50.0))  # 42.6 degrees off, 45.8 is the last

    assert not len(at_rest(gone).number)
    assert at_rest(silent((1, 60.0), (2, 40.0, 50.0))).number.tolist() == [2]


def two_at_rest():
    before = tracks((1, 70.0), (2, 50.0), (3, 40.0), empty=[0, 20, 20], hit_us=HIT_US, speed_mps=5.0)
    resting, after = settle(none_resting(), before, before.take(np.array([0])), LOST_US, VIEW, P)
    assert after.number.tolist() == [1]
    assert resting.number.tolist() == [2, 3]
    return resting


@pytest.mark.parametrize(("y_m", "number", "rests"), [(80.0, 2, [3]), (70.0, 3, [2])])
def test_of_two_that_rest_the_one_that_fits_best_is_found(y_m, number, rests):
    resting, after = found(two_at_rest(), (1, 100.0), (9, y_m), speed_mps=5.0)

    assert after.number.tolist() == [1, number]
    assert resting.number.tolist() == rests
    assert set(resting.mate_of.tolist()) == set(rests)


def test_two_that_are_found_at_once_are_given_a_number_each():
    before = tracks((1, 100.0), (8, 70.0), (9, 80.0), born_us=[0, BORN_US, BORN_US], speed_mps=5.0)
    tentative = before.but(status=np.array([1, 0, 0], np.uint8) * np.uint8(TrackStatus.CONFIRMED))

    resting, after = settle(two_at_rest(), tentative, before, BACK_US, VIEW, P)

    assert dict(zip(after.number.tolist(), after.y_m.tolist(), strict=True)) == {1: 100.0, 2: 80.0, 3: 70.0}
    assert not len(resting.number)


def test_of_two_that_are_found_at_once_the_second_must_be_behind_the_first_again():
    queue = tracks((2, 50.0), (3, 40.0), empty=20, hit_us=HIT_US, speed_mps=5.0)
    resting, _ = settle(none_resting(), queue, queue.take(np.zeros(0, np.int64)), LOST_US, VIEW, P)
    after = tracks((8, 80.0), (9, 82.0), born_us=BORN_US, speed_mps=5.0)

    resting, after = settle(resting, after.take(np.zeros(0, np.int64)), after, BACK_US, VIEW, P)

    assert after.number.tolist() == [2, 9]
    assert resting.number.tolist() == [3]


def test_the_tracks_stay_in_order_of_number_and_each_keeps_what_it_is():
    rows = ((1, 70.0), (3, 50.0), (7, 6.0, 90.0), (9, 60.0))
    marks = np.arange(4.0)
    plain = tracks(*rows, born_us=[0, 0, 0, BORN_US])
    columns = {}
    for name, column in vars(plain).items():
        if name in {"length_m", "width_m", "drift", "scatter", "echo_db", "log_odds", "points_per_hit"}:
            columns[name] = marks
        elif name in {"extent_m", "way_m"}:
            columns[name] = np.tile(marks[:, None], column.shape[1])
        elif name == "cov":
            columns[name] = marks[:, None, None] * np.eye(6)
        elif name == "map_cell":
            columns[name] = np.arange(4)
    marked = plain.but(**columns)
    tentative = marked.but(status=np.array([1, 1, 1, 0], np.uint8) * np.uint8(TrackStatus.CONFIRMED))

    _, after = settle(at_rest(), tentative, marked, BACK_US, VIEW, P)

    assert after.number.tolist() == [1, 2, 3, 7]
    for name, column in vars(marked).items():
        if name != "number":
            np.testing.assert_array_equal(getattr(after, name), column[[0, 3, 1, 2]], err_msg=name)


def test_a_tentative_track_is_given_no_number_and_leaves_none():
    """In the frame that confirms another track, in the next lane: without, nothing is looked at."""
    before = tracks((1, 70.0), (3, 50.0), (8, 80.0), empty=[0, 0, 5], status=[1, 1, TrackStatus.TENTATIVE])
    after = tracks((1, 70.0), (3, 50.0), (9, 60.0), (10, 3.5, 60.0), born_us=[0, 0, BORN_US, BORN_US])
    after = after.but(status=np.array([1, 1, 0, 1], np.uint8))
    assert (TrackStatus.TENTATIVE, TrackStatus.CONFIRMED) == (0, 1)

    resting, after = settle(at_rest(), before, after, BACK_US, VIEW, P)

    assert after.number.tolist() == [1, 3, 9, 10]
    assert resting.number.tolist() == [2]


def test_a_known_track_keeps_its_own_number():
    known = tracks((1, 70.0), (3, 50.0), (9, 60.0), born_us=[0, 0, BORN_US])
    coming = known.join(tracks((10, 20.0), born_us=BORN_US))

    _, after = settle(at_rest(), known, coming, BACK_US, VIEW, P)

    assert after.number.tolist() == [1, 3, 9, 10]


def test_a_number_rests_for_no_longer_than_said():
    resting = at_rest()

    assert expire(resting, HIT_US + 30_000_000, P).number.tolist() == [2]
    over = expire(resting, HIT_US + 30_000_001, P)
    assert not len(over.number)
    assert not len(over.mate_of)
    leader = tracks((1, 99.0))
    assert not len(settle(resting, leader, leader, HIT_US + 30_000_001, VIEW, P)[0].number)


def test_without_a_rest_no_number_rests():
    never = dataclasses.replace(P, keep_s=0.0)

    assert not len(at_rest(p=never).number)
    assert not len(expire(at_rest(), BACK_US, never).number)  # nor one from before the setting


# ---------------------------------------------------------------- by whole steps


SEEN, HIDDEN = 60, 120  # frames: three seconds in view, six out of it
SPEED_MPS = 8.0


@pytest.mark.parametrize(
    ("x_m", "y_m", "expected"),
    [
        (0.0, 50.0, True),  # where its track ended
        (0.0, 46.5, True),
        (0.0, 45.5, False),  # it has not gone back
        (0.0, 57.9, True),  # two seconds on at 2 m/s, and the error of both places
        (0.0, 58.1, False),
        (1.4, 54.0, True),
        (1.6, 54.0, False),  # beside its lane
    ],
)
def test_a_hidden_vehicle_is_awaited_where_it_may_stand(x_m, y_m, expected):
    assert awaited(at_rest(), np.array([x_m]), np.array([y_m]), P).tolist() == [expected]


def test_nobody_is_awaited_where_no_number_rests():
    assert awaited(none_resting(), np.zeros(3), np.zeros(3), P).tolist() == [False] * 3


def test_what_stands_where_a_hidden_vehicle_is_awaited_is_no_post():
    p = TrackerParameters()
    state = dataclasses.replace(initial_state(p), resting=at_rest())
    seen = tracks(
        (7, 52.0), (8, 90.0), (9, 52.0), status=[TrackStatus.TENTATIVE] * 2 + [TrackStatus.CONFIRMED]
    )

    still = seen.mean.copy()
    still[:, [1, 4]] = 0.0
    seen = seen.but(mean=still, points_per_hit=np.full(3, 2.0), born_x_m=seen.x_m, born_y_m=seen.y_m)
    nowhere = np.zeros(len(seen), dtype=np.bool_)
    around, _ = lifecycle._surroundings(state, seen, nowhere, seen.born_us[0] + 3_000_000, p)

    assert around.known_road.tolist() == [True, False, False]  # a confirmed track need not be vouched for
    assert around.post.tolist() == [False, True, True]
    assert not around.off_road.any()


def hidden_drive():
    """A car that drives away, is hidden for six seconds, and is seen again where it should be."""
    rng, frames = np.random.default_rng(7), []
    for k in range(SEEN + HIDDEN + 60):
        rows = vehicle(rng, 3.5, 30.0 + SPEED_MPS * 0.05 * k, 0.0, SPEED_MPS)
        frames.append(frame(k, *([] if SEEN <= k < SEEN + HIDDEN else [rows])))
    return frames


def test_a_car_that_is_seen_again_has_the_number_that_it_had():
    state, outputs = run(hidden_drive())

    assert all(len(e) == 0 for e in outputs[SEEN + 40 : SEEN + HIDDEN])  # it is not listed meanwhile
    assert outputs[SEEN - 1].number.tolist() == outputs[-1].number.tolist() == [1]
    assert numbers(outputs) == [1]
    assert outputs[-1].born_us[0] >= T0_US + (SEEN + HIDDEN) * PERIOD_US  # a track of its own
    assert not len(state.resting_numbers)
    assert state.next_number > 2


def test_without_a_rest_it_is_another_one():
    never = TrackerParameters().with_setting("resting.keep_s", "0")

    state, outputs = run(hidden_drive(), never)

    first, second = numbers(outputs)
    assert (outputs[SEEN - 1].number.tolist(), outputs[-1].number.tolist()) == ([first], [second])
    assert not len(state.resting.number)


def test_a_snapshot_while_a_number_rests_goes_on_to_the_bit():
    frames, middle = hidden_drive(), SEEN + HIDDEN // 2
    state, _ = run(frames[:middle])
    assert state.resting_numbers.tolist() == [1]
    assert not state.idle

    restored = snapshot.load(TrackerState, snapshot.dump(state))

    assert isinstance(restored.resting, Resting)
    (a, after), (b, again) = run(frames[middle:], None, state), run(frames[middle:], None, restored)
    assert numbers(after) == numbers(again) == [1]
    assert snapshot.dump(a) == snapshot.dump(b)


def test_ticks_let_the_rest_of_a_number_end():
    p = TrackerParameters()
    state, _ = run(hidden_drive()[: SEEN + 40], p)
    hit_us = int(state.resting.hit_us[0])

    state, _, _ = coast(state, hit_us + 30_000_000, p)
    assert state.resting_numbers.tolist() == [1]
    assert not state.idle
    state, _, _ = coast(state, hit_us + 31_000_000, p)

    assert not len(state.resting_numbers)
    assert state.idle


def test_a_tracker_that_has_seen_nothing_has_no_number_at_rest():
    assert not len(initial_state().resting_numbers)
