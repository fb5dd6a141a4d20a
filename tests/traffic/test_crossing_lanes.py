from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.traffic.cells import ruler_of
from service.traffic.counting import count, nothing_counted
from service.traffic.crossing_lanes import way_across
from service.traffic.lane_places import lanes_at
from service.traffic.lines import Line
from service.traffic.measured import measured_of
from service.traffic.model import NO_LANE, NO_MAP, Lane, LaneMap, Moment
from tests.traffic.test_crossings import SETUP, approach, drive, merged
from tests.traffic.tracks import FRAME_US, START_US

LINE = Line("C40", -6.0, 40.0, 6.0, 40.0)
TOWARDS = way_across(LINE, -1)


def lane(index, x_m, *, backwards=False, kind="lane"):
    y = np.arange(150.0, 10.0, -2.0)
    points = np.column_stack([np.full(len(y), x_m), y])[:: -1 if backwards else 1]
    return Lane(index, f"L{index}", kind, "approaching", points, np.full(len(y), 3.5), 1.0, 20)


def lane_at(x_m, y_m, way, before, lanes):
    place, ruler = np.array([[x_m, y_m]]), ruler_of(lanes, 10.0)
    return int(lanes_at(place, way[None], np.array([before]), ruler)[0])


LANES = LaneMap(1, START_US, 1, 40, "learned", (lane(1, -1.75), lane(2, 1.75)))


def test_the_way_across_points_to_the_left_of_the_line_in_direction_one():
    np.testing.assert_allclose(way_across(LINE, 1), [0.0, 1.0])
    np.testing.assert_allclose(TOWARDS, [0.0, -1.0])


def test_at_a_line_the_place_decides_not_the_lane_of_a_moment_ago():
    assert lane_at(0.2, 40.0, TOWARDS, 1, LANES) == 2
    assert lane_at(-0.2, 40.0, TOWARDS, 1, LANES) == 1
    assert lane_at(0.2, 40.0, TOWARDS, NO_LANE, LANES) == 2


def test_a_place_outside_of_every_lane_keeps_what_it_had():
    assert lane_at(3.9, 40.0, TOWARDS, NO_LANE, LANES) == NO_LANE
    assert lane_at(3.9, 40.0, TOWARDS, 2, LANES) == 2


def test_ways_across_are_not_taken_for_lanes_nor_a_nearer_lane_for_a_turn():
    sideways = np.array([1.0, 0.0])
    assert lane_at(1.5, 40.0, sideways, NO_LANE, LANES) == NO_LANE
    turning = LaneMap(1, START_US, 1, 40, "learned", (lane(1, 0.0, kind="turn"), lane(2, 0.5)))
    assert lane_at(0.5, 40.0, TOWARDS, 1, turning) == 1


def test_a_lane_of_the_other_direction_must_be_nearer_by_a_metre():
    both = LaneMap(1, START_US, 1, 40, "learned", (lane(1, -1.0), lane(2, 1.0, backwards=True)))
    assert lane_at(0.4, 40.0, TOWARDS, NO_LANE, both) == 1
    assert lane_at(0.9, 40.0, TOWARDS, NO_LANE, both) == 2


def test_crossings_before_the_first_map_get_lanes_and_headways_with_it():
    way = approach()
    first, second = drive(1, way, x_m=-1.7), [None] * 40 + drive(2, way, x_m=-1.8)
    third = [None] * 20 + drive(3, way, x_m=1.7)
    frames = merged(first, second, third)
    state, blocks, told = nothing_counted(), {}, []
    for k, now in enumerate(frames):
        lanes = LANES if k == len(frames) - 1 else NO_MAP
        state, counts = count(
            state, Moment(START_US + k * FRAME_US, k, tick=False), now, measured_of(now), lanes, SETUP
        )
        told += counts.crossings
        blocks |= {(block.line_id, block.minute): block for block in counts.blocks}
    assert [x.lane for x in told] == [NO_LANE] * 3

    table = np.concatenate([block.table() for block in blocks.values()])

    by_track = {int(row["track"]): row for row in table}
    assert [int(by_track[k]["lane"]) for k in (1, 2, 3)] == [1, 1, 2]
    assert {int(row["map_version"]) for row in table} == {1}
    assert by_track[2]["headway_s"] == pytest.approx(40 * FRAME_US / 1e6, abs=0.02)
    assert by_track[2]["gap_s"] < by_track[2]["headway_s"]
    assert np.isnan(by_track[1]["headway_s"])
    assert np.isnan(by_track[3]["headway_s"])
    assert {x.lane for x in state.leaders} == {1, 2}


def test_crossings_of_a_lane_that_a_new_map_cuts_get_the_number_of_their_part():
    way = approach()
    frames = merged(
        drive(1, way, x_m=-1.7), [None] * 40 + drive(2, way, x_m=-1.8), [None] * 20 + drive(3, way, x_m=0.1)
    )
    near, far = lane(1, -1.5), lane(5, -1.5)
    near = replace(near, points_m=near.points_m[near.points_m[:, 1] < 30.0], width_m=np.full(10, 3.5))
    far = replace(far, points_m=far.points_m[far.points_m[:, 1] > 30.0], width_m=np.full(60, 3.5))
    cut = LaneMap(2, START_US, 1, 40, "learned", (near, lane(2, 1.8), far))
    state, blocks, told = nothing_counted(), {}, []
    for k, now in enumerate(frames):
        lanes = cut if k == len(frames) - 1 else LANES
        state, counts = count(
            state, Moment(START_US + k * FRAME_US, k, tick=False), now, measured_of(now), lanes, SETUP
        )
        told += counts.crossings
        blocks |= {(block.line_id, block.minute): block for block in counts.blocks}
    assert [(x.track, x.lane, x.map_version) for x in told] == [(1, 1, 1), (3, 2, 1), (2, 1, 1)]

    by_track = {int(row["track"]): row for block in blocks.values() for row in block.table()}

    assert [int(by_track[k]["lane"]) for k in (1, 2, 3)] == [5, 5, 2]  # the third lies inside its lane still
    assert [int(by_track[k]["map_version"]) for k in (1, 2, 3)] == [2, 2, 1]
    assert by_track[2]["headway_s"] == pytest.approx(40 * FRAME_US / 1e6, abs=0.02)
    assert np.isnan(by_track[1]["headway_s"])


def test_a_headway_over_time_without_frames_is_not_known():
    way = approach()
    there = drive(9, np.full(260, 100.0))  # so that no frame is without a vehicle
    frames = merged(drive(1, way), [None] * 160 + drive(2, way), [None] * 190 + drive(3, way), there)
    for blind in (range(0), range(90, 130)):  # two seconds between the first vehicle and the second
        state, told = nothing_counted(), {}
        for k, now in enumerate(frames):
            if k not in blind:
                moment = Moment(START_US + k * FRAME_US, k, tick=False)
                state, counts = count(state, moment, now, measured_of(now), LANES, SETUP)
                told |= {x.track: x.headway_s for x in counts.crossings}

        assert np.isnan(told[2]) == (len(blind) > 0)
        assert told[3] == pytest.approx(30 * FRAME_US / 1e6, abs=0.02)


def test_who_crossed_before_a_blind_stretch_and_is_told_after_it_leads_nobody():
    way = approach()  # over the line at frame 33, told ten frames later
    frames = merged(drive(1, way), [None] * 100 + drive(2, way), drive(9, np.full(170, 100.0)))
    state, told = nothing_counted(), {}
    for k, now in enumerate(frames):
        if k not in range(40, 64):
            moment = Moment(START_US + k * FRAME_US, k, tick=False)
            state, counts = count(state, moment, now, measured_of(now), LANES, SETUP)
            told |= {x.track: x.headway_s for x in counts.crossings}

    assert sorted(told) == [1, 2]
    assert np.isnan(told[2])
