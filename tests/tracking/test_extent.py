"""How a box turns, what binds its velocity and holds it, and how the road map and births learn directions."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from service.tracking import births, extent, heading_kernels, holding, road_map, teaching, tracker
from service.tracking.births import BirthParameters
from service.tracking.boxes import (
    M_COUNT,
    M_TURN,
    M_U,
    M_U_MAX,
    M_U_MEAN,
    M_U_MIN,
    M_VAR_TURN,
    M_VAR_W,
    M_W,
    M_W_MEAN,
    MEASUREMENT_COLUMNS,
    PG,
    POINT_COLUMNS,
    PV,
    PVAR_AZ,
    PVAR_R,
    PWEIGHT,
    PX,
    PY,
)
from service.tracking.extent import ExtentParameters
from service.tracking.model import TrackStatus
from service.tracking.parameters import TrackerParameters
from service.tracking.road_map import RoadMapParameters
from service.tracking.state import Tracks, no_tracks

DT_S = 0.05


def one_track(*, heading_rad=0.0, heading_std_rad=0.1, vx=0.0, vy=0.0, x=0.0, y=60.0, speed_var=0.01):
    empty = no_tracks(0)
    columns = (getattr(empty, field.name) for field in dataclasses.fields(empty))
    blank = Tracks(*(np.zeros((1, *column.shape[1:]), column.dtype) for column in columns))
    mean = np.array([[x, vx, 0.0, y, vy, 0.0]])
    cov = np.diag([0.1, speed_var, 0.1, 0.1, speed_var, 0.1])[None]
    return blank.but(
        mean=mean, cov=cov, heading_rad=np.array([heading_rad]), hits=np.array([50]),
        heading_var=np.array([heading_std_rad**2]), length_m=np.array([4.4]), width_m=np.array([1.9]),
    )  # fmt: skip


def learn(tracks, *, one_way=False, hit=True, road_rad=0.0, sideways_m=None, row=None):
    measured = np.zeros((1, MEASUREMENT_COLUMNS))
    measured[0, M_VAR_TURN] = np.inf
    if row is not None:  # angle, its variance, middle of the points
        measured[0, [M_COUNT, M_TURN, M_VAR_TURN, M_U_MEAN, M_W_MEAN]] = 5.0, *row
    if sideways_m is not None:
        measured[0, [M_COUNT, M_W, M_VAR_W]] = 1.0, sideways_m, 0.04
    flags = np.array([hit]), np.array([one_way])
    return extent.learn(tracks, measured, *flags, np.array([road_rad]), 0.003, DT_S, ExtentParameters())


def test_a_settled_box_turns_no_faster_than_its_wheels_allow():
    track = one_track(heading_rad=math.pi, vx=1.5, vy=-1.5)  # the velocity points 45 degrees aside

    turned = learn(track).heading_rad[0] % (2 * math.pi) - math.pi

    assert 0 < abs(turned) <= DT_S * math.hypot(1.5, 1.5) / 6.0 + 1e-9


def test_a_settled_box_is_not_turned_over_and_a_guess_is():
    settled = learn(one_track(vy=-3.0))
    guess = learn(one_track(vy=-3.0, heading_std_rad=0.8))

    assert settled.heading_rad[0] == pytest.approx(0.0, abs=1e-6)
    assert abs(guess.heading_rad[0]) == pytest.approx(math.pi, abs=1e-6)


@pytest.mark.parametrize(("come_m", "over"), [(2.0, True), (12.0, False)])
def test_what_was_born_standing_is_turned_over_when_it_drives_off_the_other_way(come_m, over):
    track = one_track(vy=-3.0)
    standing = track.but(standing=np.array([True]), born_y_m=track.y_m + come_m, born_x_m=track.x_m.copy())

    assert math.cos(learn(standing).heading_rad[0]) == pytest.approx(-1.0 if over else 1.0, abs=1e-6)


def test_an_unknown_heading_follows_the_velocity_at_once():
    turned = learn(one_track(vx=6.0, vy=6.0, heading_std_rad=0.8))

    assert turned.heading_rad[0] == pytest.approx(math.pi / 4, abs=0.05)
    assert turned.heading_var[0] < 0.1**2


def length_after(frames, extent_m, *, before_m, points, hits=50):
    """Return length and the place of the rear, which faces the radar, of a box that spans extent_m."""
    track = one_track(vy=12.0)
    track = track.but(
        hits=np.array([hits]),
        length_m=np.array([before_m]),
        points_per_hit=np.array([points]),
        extent_m=np.full((1, 30), np.nan),
    )
    measured = np.zeros((1, MEASUREMENT_COLUMNS))
    measured[0, [M_COUNT, M_U_MIN, M_U_MAX]] = points, -0.5 * extent_m, 0.5 * extent_m
    always, never, along = np.array([True]), np.array([False]), np.zeros(1)
    rear_m = track.y_m[0] - 0.5 * before_m
    for _ in range(frames):
        track = extent.learn(track, measured, always, never, along, 0.003, DT_S, ExtentParameters())
        track = track.but(hits=track.hits + 1)
    assert track.y_m[0] - 0.5 * track.length_m[0] == pytest.approx(rear_m)
    return track.length_m[0]


@pytest.mark.parametrize(
    ("extent_m", "points", "before_m", "length_m"),
    [
        (3.5, 6.0, 4.4, 3.9),  # many points show both ends of a car
        (3.0, 2.0, 4.4, 4.4),  # few show how long it is at least
        (3.0, 2.0, 3.9, 3.9),  # ... and take nothing from what many have shown
        (9.3, 9.0, 9.0, 10.0),  # the outermost echoes of a truck lie deeper inside it
        (8.0, 3.0, 4.4, 8.0 / 0.93),
        (1.8, 2.9, 4.4, 2.2),  # a motorcycle
    ],
)
def test_a_length_is_learned_from_the_extents_that_show_it(extent_m, points, before_m, length_m):
    assert length_after(60, extent_m, before_m=before_m, points=points) == pytest.approx(length_m)


def test_a_young_track_is_soon_found_to_be_a_motorcycle():
    assert length_after(22, 1.8, before_m=4.4, points=2.9, hits=1) == pytest.approx(2.2)
    assert length_after(22, 1.8, before_m=4.4, points=2.9, hits=50) == pytest.approx(4.4 - 11 * 0.05)


def test_sideways_motion_is_bound_most_where_all_drive_one_way():
    track = one_track(vx=1.0, vy=8.0, speed_var=1.0)

    one_way, free = learn(track, one_way=True), learn(track)

    assert abs(one_way.mean[0, 1]) + 0.1 < abs(free.mean[0, 1]) < 1.0


@pytest.mark.parametrize(("heading_std_rad", "binds"), [(0.28, True), (0.32, False)])
def test_a_heading_that_is_hardly_known_binds_no_velocity(heading_std_rad, binds):
    # so fast, and no surer of it: the velocity says nothing of the heading
    track = one_track(vx=5.0, vy=2.0, speed_var=9.0, heading_std_rad=heading_std_rad)

    after = learn(track, hit=False)

    assert (abs(after.mean[0, 1]) < 4.9) == binds


def test_what_hardly_moves_ahead_does_not_move_sideways():
    # the points of a standing vehicle, told by noise of azimuth, would else walk its box across the lane
    def left(vy):
        track = one_track(vx=0.4, vy=vy, speed_var=0.01)
        return learn(track, one_way=True, hit=False).mean[0, 1] / 0.4

    assert left(0.1) < 0.5
    assert left(1.5) > 0.8


def sideways_speed_after(residuals_m, vy=8.0):
    track = one_track(vx=2.0, vy=vy, speed_var=1.0)
    for residual_m in residuals_m:
        track = learn(track.but(mean=one_track(vx=2.0, vy=vy).mean), one_way=True, sideways_m=residual_m)
        track = track.but(heading_rad=np.zeros(1), cov=one_track(speed_var=1.0).cov)
    return learn(
        track.but(mean=one_track(vx=2.0, vy=vy).mean), one_way=True, sideways_m=residuals_m[-1]
    ).mean[0, 1]


def test_a_box_that_its_points_carry_sideways_is_let_go():
    carried, shaken = sideways_speed_after([0.6] * 12), sideways_speed_after([-0.6, 0.6] * 6)

    assert carried > 1.9
    assert shaken < 1.5  # noise changes sign, and the bound of a known heading holds
    assert sideways_speed_after([0.6] * 12, vy=0.0) == pytest.approx(carried, abs=0.2)


@pytest.mark.parametrize(("seen_at_m", "pivot_m"), [(1.5, 1.5), (-9.0, -2.2), (None, 0.0)])
def test_the_road_turns_a_crawling_box_about_the_middle_of_its_points(seen_at_m, pivot_m):
    track = one_track(heading_rad=0.3, vy=-0.2, x=3.0)
    measured = np.zeros((1, MEASUREMENT_COLUMNS))
    if seen_at_m is not None:
        measured[0, [M_COUNT, M_U_MEAN, M_VAR_W]] = 1.0, seen_at_m, 0.04
    middle = track.mean[0, [0, 3]] + pivot_m * np.array([math.sin(0.3), math.cos(0.3)])
    for _ in range(200):
        track = extent.learn(
            track, measured, np.array([True]), np.array([True]), np.zeros(1), 0.003, DT_S, ExtentParameters()
        )
        track = track.but(mean=np.where(np.arange(6) % 3 == 1, 0.0, track.mean))

    heading = track.heading_rad[0]
    assert abs(heading) < 0.03
    turned = track.mean[0, [0, 3]] + pivot_m * np.array([math.sin(heading), math.cos(heading)])
    np.testing.assert_allclose(turned, middle, atol=1e-9)


def test_a_guess_that_is_turned_over_turns_about_the_same_place():
    track = one_track(vx=0.5, vy=-3.0, heading_std_rad=0.8)
    measured = np.zeros((1, MEASUREMENT_COLUMNS))
    measured[0, [M_COUNT, M_U_MEAN, M_VAR_W]] = 1.0, 2.0, 0.04
    flags = np.array([True]), np.array([False])

    turned = extent.learn(track, measured, *flags, np.zeros(1), 0.003, DT_S, ExtentParameters())

    s, c = math.sin(turned.heading_rad[0]), math.cos(turned.heading_rad[0])
    assert c < -0.9  # now it faces where it goes, and the points lie behind its centre
    np.testing.assert_allclose(turned.mean[0, [0, 3]] - 2.0 * np.array([s, c]), [0.0, 62.0], atol=1e-9)


@pytest.mark.parametrize(("one_way", "road_rad"), [(False, 0.3), (True, 1.2)])
def test_no_road_turns_a_box_that_does_not_drive_along_it(one_way, road_rad):
    assert learn(one_track(), one_way=one_way, road_rad=road_rad).heading_rad[0] == 0.0


@pytest.mark.parametrize("vx", [0.0, 6.0])
def test_the_row_of_points_turns_a_box_seen_from_the_side_about_their_middle(vx):
    track = one_track(heading_rad=math.pi / 2 + 0.5, heading_std_rad=0.5, vx=vx)

    turned = learn(track, row=(-0.5, 0.02, 0.8, 0.7))

    gain = 0.5**2 / (0.5**2 + 1.5 * 0.02)
    assert (
        turned.heading_rad[0] < math.pi / 2 + 0.5 - 0.9 * gain * 0.5
    )  # the velocity turns it no further away
    if vx == 0.0:
        assert turned.heading_rad[0] == pytest.approx(math.pi / 2 + 0.5 - gain * 0.5)
        assert turned.heading_var[0] == pytest.approx(0.5**2 * (1 - gain))
        np.testing.assert_allclose(middle(turned, 0.8, 0.7), middle(track, 0.8, 0.7), atol=1e-9)


def middle(track, u, w):
    s, c = math.sin(track.heading_rad[0]), math.cos(track.heading_rad[0])
    return track.mean[0, 0] + s * u + c * w, track.mean[0, 3] + c * u - s * w


@pytest.mark.parametrize(
    ("heading_rad", "row", "hit"),
    [
        (0.2, (0.1, 0.02, 0.0, 0.0), True),  # end-on, before and after
        (math.pi / 2, (1.2, 0.02, 0.0, 0.0), True),  # not the row of this vehicle alone
        (math.pi / 2, (0.3, np.inf, 0.0, 0.0), True),
        (math.pi / 2, (0.3, 0.02, 0.0, 0.0), False),
    ],
)
def test_points_that_tell_no_direction_turn_no_box(heading_rad, row, hit):
    track = one_track(heading_rad=heading_rad)

    assert learn(track, row=row, hit=hit).heading_rad[0] == heading_rad


def of_length(track, length_m):
    return track.but(length_m=np.array([length_m]), width_m=np.array([2.5 if length_m > 7.0 else 1.9]))


@pytest.mark.parametrize(
    ("length_m", "aspect_rad", "row_rad", "one_way", "turns"),
    [
        (12.0, 0.25, -0.02, False, True),
        (12.0, 0.1, -0.02, False, False),  # too near end-on: its near face is all that is seen
        (12.0, 0.1, -0.4, False, False),  # however much that seems to lie askew
        (12.0, 0.25, -0.02, True, False),  # the road tells it better
        (4.4, 0.25, -0.02, False, False),
    ],
)
def test_the_row_of_a_truck_turns_it_where_only_a_sliver_of_its_side_is_seen(
    length_m, aspect_rad, row_rad, one_way, turns
):
    track = of_length(one_track(heading_rad=aspect_rad), length_m)

    turned = learn(track, row=(row_rad, 0.002, 0.0, 0.0), one_way=one_way, road_rad=aspect_rad)

    assert bool(turned.heading_rad[0] < aspect_rad - 0.01) is turns
    assert turns or turned.heading_rad[0] == aspect_rad


def test_the_middle_of_a_long_vehicle_may_go_another_way_than_its_body_points():
    goes_aside = {"vx": 1.5, "vy": 5.0, "heading_std_rad": 0.05}
    for speed_var in (0.05, 0.5):
        tracks = [of_length(one_track(**goes_aside, speed_var=speed_var), length) for length in (4.4, 12.0)]
        car, truck = map(learn, tracks)
        assert 0.0 < truck.heading_rad[0] < 0.6 * car.heading_rad[0]  # its middle tells less of how it lies

    assert truck.mean[0, 1] > car.mean[0, 1] + 0.02  # and is bound less to go as it lies


def test_where_all_drive_one_way_the_middle_goes_as_the_body_points():
    along = {"one_way": True, "road_rad": 0.0}

    car, truck = (learn(of_length(one_track(vx=0.5, vy=5.0), length), **along) for length in (4.4, 12.0))

    assert truck.heading_rad[0] == car.heading_rad[0]
    np.testing.assert_array_equal(truck.mean, car.mean)


@pytest.mark.parametrize(("speed_mps", "slip_rad"), [(2.0, 0.3), (20.0, 6.0 * 2.0 / 400.0)])
def test_slip_is_half_the_length_over_the_radius_that_the_speed_allows(speed_mps, slip_rad):
    mean = np.array([[0.0, 0.0, 0.0, 60.0, speed_mps, 0.0]])

    slip = heading_kernels.slip_rad(mean, np.array([12.0]), np.array([False]), 20.0, 2.0)

    assert slip[0] == pytest.approx(slip_rad)


def test_sideways_motion_is_bound_loosely_off_the_direction_of_the_road():
    track = one_track(vx=1.0, vy=8.0, speed_var=1.0)

    along, off = learn(track, one_way=True, road_rad=0.05), learn(track, one_way=True, road_rad=1.5)

    assert abs(along.mean[0, 1]) + 0.1 < abs(off.mean[0, 1])


@pytest.mark.parametrize(("heading_rad", "step_m"), [(0.0, 0.01), (math.pi / 2, 0.03)])
def test_the_points_of_a_settled_box_that_stands_move_it_by_a_step_at_most(heading_rad, step_m):
    track = one_track(heading_rad=heading_rad)
    after = track.mean + np.array([0.3, 0.0, 0.0, 0.4, 0.0, 0.0])

    held = holding.hold(track, track.mean, after, ExtentParameters())

    np.testing.assert_allclose(held[0, [0, 3]] - track.mean[0, [0, 3]], [0.6 * step_m, 0.8 * step_m])
    np.testing.assert_array_equal(held[0, [1, 2, 4, 5]], after[0, [1, 2, 4, 5]])


@pytest.mark.parametrize(("speed_mps", "hits", "times"), [(0.4, 50, 30.0), (0.6, 50, 1.0), (0.4, 29, 1.0)])
def test_places_of_a_held_box_count_less_and_its_range_rate_as_ever(speed_mps, hits, times):
    track, R = one_track(vy=speed_mps).but(hits=np.array([hits])), np.ones((1, 2, 3, 3))

    noise = holding.held_noise(track, track.mean, R, ExtentParameters())

    np.testing.assert_array_equal(noise[:, :, :2, :2], times)
    assert (noise[:, :, 2] == 1.0).all()
    assert (noise[:, :, :, 2] == 1.0).all()
    assert (R == 1.0).all()


@pytest.mark.parametrize(
    ("before_mps", "after_mps", "hits"), [(0.6, 0.0, 50), (0.0, 0.6, 50), (0.0, 0.0, 29)]
)
def test_a_box_that_moves_or_is_young_goes_where_its_points_are(before_mps, after_mps, hits):
    track = one_track(vy=before_mps).but(hits=np.array([hits]))
    after = one_track(vy=after_mps, y=61.0).mean

    np.testing.assert_array_equal(holding.hold(track, track.mean, after, ExtentParameters()), after)


def watched(track, ahead_m, *, frames=20, hit=True):
    """Return the track after frames whose points put it so far ahead."""
    measured = np.zeros((1, MEASUREMENT_COLUMNS))
    measured[0, [M_COUNT, M_U]] = 4.0, ahead_m
    for _ in range(frames):
        track = holding.watch_ends(track, measured, np.array([hit]), ExtentParameters())
    return track


def test_a_vehicle_seen_side_on_that_drives_off_is_held_no_more():
    track = one_track(heading_rad=math.pi / 2)
    after, R = track.mean + np.array([0.3, 0.0, 0.0, 0.4, 0.0, 0.0]), np.ones((1, 2, 3, 3))
    off = watched(track, 1.0)

    np.testing.assert_array_equal(holding.hold(off, off.mean, after, ExtentParameters()), after)
    np.testing.assert_array_equal(holding.held_noise(off, off.mean, R, ExtentParameters()), R)


@pytest.mark.parametrize("changes", [{"frames": 5}, {"ahead_m": 0.7}, {"hit": False}])
def test_a_box_is_held_until_its_points_have_gone_on_for_a_while(changes):
    track = watched(one_track(heading_rad=math.pi / 2), **({"ahead_m": 1.0} | changes))
    after = track.mean + np.array([0.3, 0.0, 0.0, 0.4, 0.0, 0.0])

    assert np.abs(holding.hold(track, track.mean, after, ExtentParameters()) - track.mean).max() < 0.03


def test_the_ends_are_watched_of_slow_boxes_seen_side_on():
    assert watched(one_track(heading_rad=math.pi / 2), 1.0).ahead_m[0] > 0.9
    assert (
        watched(one_track(heading_rad=math.pi / 2), 9.0).ahead_m[0] < 3.0
    )  # a neighbour's point now and then
    assert watched(one_track(heading_rad=0.0), 1.0).ahead_m[0] == 0.0  # end-on the range rate tells
    moving = one_track(heading_rad=math.pi / 2, vx=4.0).but(ahead_m=np.array([1.0]))
    assert watched(moving, 1.0).ahead_m[0] == 0.0
    turned = one_track(heading_rad=0.0).but(ahead_m=np.array([1.0]))
    assert watched(turned, 0.0).ahead_m[0] == 0.0  # what it did side-on does not let it go for good


def test_what_drives_off_is_not_taken_to_stand():
    track = one_track(heading_rad=math.pi / 2, vx=1.0, vy=0.0, speed_var=1.0).but(ahead_m=np.array([1.0]))
    for _ in range(40):
        track = learn(track)

    assert track.speed_mps[0] == pytest.approx(1.0, abs=0.05)


def test_what_has_no_range_rate_is_taken_to_stand():
    # side-on to the radar: the range rate is nearly none although it seems to move at 1 m/s
    track = one_track(heading_rad=math.pi / 2, vx=1.0, vy=0.0, speed_var=1.0)

    still, unseen = track, learn(track, hit=False)
    for _ in range(40):
        still = learn(still)

    assert still.speed_mps[0] < 0.3
    assert unseen.speed_mps[0] == pytest.approx(1.0, abs=0.05)


def test_a_vehicle_that_moves_off_is_not_held():
    track = one_track(vy=0.6, speed_var=0.01)

    assert learn(track).mean[0, 4] == pytest.approx(0.6, abs=0.02)


def test_a_steady_turn_is_learned_and_predicted():
    rate = 0.1  # rad/s: 25 m/s on a radius of 250 m
    track, behind = one_track(vy=25.0), 0.0
    for k in range(200):
        track, mean = extent.turn_on(track, track.mean, DT_S, ExtentParameters())
        angle = rate * DT_S * (k + 1)
        mean[0, [1, 4]] = 25.0 * math.sin(angle), 25.0 * math.cos(angle)
        mean[0, [0, 3]] = 0.0, 60.0
        track = learn(track.but(mean=mean, cov=one_track().cov))
        behind = angle - track.heading_rad[0]

    assert track.turn_rate_radps[0] == pytest.approx(rate, rel=0.8)
    assert abs(behind) < 0.02
    assert extent.turn_on(track, track.mean, 1.0, ExtentParameters())[0].heading_rad[0] > track.heading_rad[0]


def test_the_arc_back_to_the_first_place_lies_on_the_circle():
    radius, turn = 80.0, math.radians(35.0)
    end = radius * np.array([1.0 - math.cos(turn), math.sin(turn)])
    start = np.array([0.0, 20.0])

    places = road_map.arc(start, start + end, turn, RoadMapParameters()) - [0.0, 20.0, 0.0]

    assert len(places) > 8
    came, places = places[places[:, 1] < 0.0], places[places[:, 1] >= 0.0]
    np.testing.assert_allclose(came[:, [0, 2]], 0.0, atol=0.05)  # straight on behind its first place
    assert came[:, 1].min() < -4.0
    off = np.hypot(places[:, 0] - radius, places[:, 1]) - radius
    true = np.arctan2(places[:, 1], radius - places[:, 0])
    np.testing.assert_allclose(off, 0.0, atol=0.05)
    np.testing.assert_allclose(places[:, 2], true, atol=0.01)


def test_no_arc_is_drawn_through_a_corner_or_a_step():
    p = RoadMapParameters()

    assert not len(road_map.arc(np.zeros(2), np.array([0.0, 3.0]), 0.0, p))
    assert not len(road_map.arc(np.zeros(2), np.array([20.0, 20.0]), math.pi / 2 + 0.1, p))


def taught_along_a_circle(radius_m, speed_mps, lag_rad, p):
    """Return the state after eight seconds of a track that turns right, its heading behind by `lag_rad`."""
    state = tracker.initial_state(p)
    for k in range(160):
        turned = speed_mps * DT_S * k / radius_m
        x, y = radius_m * (1.0 - math.cos(turned)), 20.0 + radius_m * math.sin(turned)
        vx, vy = speed_mps * math.sin(turned), speed_mps * math.cos(turned)
        track = one_track(x=x, y=y, heading_rad=turned - lag_rad, vx=vx, vy=vy)
        kept = {"map_cell": state.tracks.map_cell, "way_m": state.tracks.way_m}
        if k == 0:
            kept = {"map_cell": np.array([-1]), "way_m": np.full((1, 4), np.nan)}
        track = track.but(
            status=np.array([int(TrackStatus.CONFIRMED)], np.uint8), born_y_m=np.array([20.0]), **kept
        )
        state = teaching.teach_road(dataclasses.replace(state, tracks=track, frames=k), p)
    return state


def test_a_sharp_turn_is_not_taught_as_if_it_had_one_direction():
    p = TrackerParameters()

    assert taught_along_a_circle(40.0, 8.0, 0.0, p).road.tracks.sum() > 5.0
    assert not taught_along_a_circle(12.0, 6.0, 0.0, p).road.tracks.any()


def test_the_road_is_taught_the_way_of_a_track_and_not_its_heading():
    p, radius = TrackerParameters(), 200.0
    state = taught_along_a_circle(radius, 20.0, 0.06, p)

    angle = np.linspace(0.05, 0.7, 60)
    x, y = radius * (1.0 - np.cos(angle)), 20.0 + radius * np.sin(angle)
    count, heading_rad, agreement = road_map.driven_at(state.road, x, y, p.road)

    assert (count == 1.0).mean() > 0.8  # one track: no cell is counted twice
    assert count.max() == 1.0
    known = count > 0
    assert np.abs(heading_rad - angle)[known].mean() < 0.015
    assert agreement[known].min() == pytest.approx(1.0)
    assert state.road.teachers == 1.0


def test_a_track_that_jumps_to_another_vehicle_teaches_no_way():
    p = TrackerParameters()
    state = tracker.initial_state(p)
    for k, x in enumerate((0.0, 0.0, 0.0, 6.0, 6.0)):
        track = one_track(x=x, y=40.0 + 6.0 * k, vy=20.0)
        kept = {"map_cell": np.array([0]), "way_m": np.full((1, 4), np.nan)}
        if k:
            kept = {"map_cell": state.tracks.map_cell, "way_m": state.tracks.way_m}
        track = track.but(status=np.array([int(TrackStatus.CONFIRMED)], np.uint8), **kept)
        state = teaching.teach_road(dataclasses.replace(state, tracks=track, frames=3 * k), p)

    count, heading_rad, _ = road_map.driven_at(state.road, np.zeros(1), np.array([46.0]), p.road)

    assert count.tolist() == [1.0]
    assert heading_rad[0] == pytest.approx(0.0)
    x, y = np.meshgrid(np.arange(-3.0, 10.0, 2.0), np.arange(50.0, 70.0, 4.0))
    assert not road_map.driven_at(state.road, x.ravel(), y.ravel(), p.road)[0].any()


def test_a_road_is_one_way_where_all_have_driven_one_way():
    p = RoadMapParameters()
    road = road_map.empty_road_map(p)
    for _ in range(3):
        road = road_map.teach(road, np.array([1.0]), np.array([50.0]), np.array([0.1]), 1, p)
    crossing = road_map.teach(road, np.array([1.0]), np.array([50.0]), np.array([1.6]), 1, p)
    x, y = np.array([1.0, 41.0]), np.full(2, 50.0)  # nobody has driven at the second place

    one_way, heading_rad = road_map.one_way_at(road, x, y, p)

    assert one_way.tolist() == [True, False]
    assert heading_rad[0] == pytest.approx(0.1)
    assert not road_map.one_way_at(crossing, x, y, p)[0].any()


def crossing_points(rng, speed_mps):
    age_s = np.repeat([0.15, 0.10, 0.05, 0.0], 4)
    points = np.zeros((len(age_s), POINT_COLUMNS))
    points[:, PX] = -speed_mps * age_s + rng.normal(0, 0.2, len(age_s))
    points[:, PY] = points[:, PG] = 80.0
    points[:, PV], points[:, PVAR_R], points[:, PVAR_AZ], points[:, PWEIGHT] = 0.8, 0.02, 2e-6, 10.0
    return points, age_s


@pytest.mark.parametrize("speed_mps", [-14.0, 14.0])
def test_a_vehicle_that_crosses_starts_across_the_line_of_sight(speed_mps):
    points, age_s = crossing_points(np.random.default_rng(3), speed_mps)

    born = births.gather([births.moving_birth(points[age_s == 0], points, age_s, None, BirthParameters())])

    assert born.vx_mps[0] * speed_mps > 0
    assert abs(born.vx_mps[0]) > 7.0
    assert abs(born.heading_rad[0] - math.copysign(math.pi / 2, speed_mps)) < 0.3


def test_the_road_map_tells_a_birth_its_heading():
    points, age_s = crossing_points(np.random.default_rng(3), 0.0)
    points[:, PV] = 10.0

    p = BirthParameters()
    born = births.gather([births.moving_birth(points[age_s == 0], points, age_s, 0.4, p)])

    assert born.heading_rad[0] == pytest.approx(0.4)
    assert born.heading_var[0] == pytest.approx(p.road_heading_std_rad**2)
