from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import counts
from service.formats.sensor import CountLine, SensorConfig
from service.simulation.scenario import scenario_named, simulate
from service.traffic.cells import CELL, along
from service.traffic.counting import count, nothing_counted
from service.traffic.edie import CellTable, edie_table
from service.traffic.flow import Received
from service.traffic.line_placing import place_lines
from service.traffic.measured import measured_of
from service.traffic.model import Lane, LaneMap, Moment
from service.traffic.parameters import traffic_setup
from service.traffic.records import MINUTE_US
from tests.traffic.tracks import FRAME_US, START_US, estimates

POINTS = np.array([[0.0, y] for y in np.arange(110.0, 9.0, -2.0)])  # 100 m, approaching
ROAD = LaneMap(3, START_US, 0, 50, "learned", (
    Lane(1, "L1", "lane", "approaching", POINTS, np.full(51, 3.5), 0.9, 50),
    Lane(2, "L2", "lane", "approaching", POINTS + np.array([3.5, 0.0]), np.full(51, 3.5), 0.9, 50),
    Lane(3, "L3", "lane", "receding", POINTS[::-1] - np.array([8.0, 0.0]), np.full(51, 3.5), 0.9, 50),
))  # fmt: skip
SETUP = traffic_setup(SensorConfig(count_lines=(CountLine(line_id="C40", p0=(-9.0, 40.0), p1=(9.0, 40.0)),)))


def driven(places, *, vy_mps=-10.0, start_us=START_US, lane=1, silent=()):
    """The sums of the cells after a vehicle was at these places, by (minute, cell): metres and seconds.

    silent: frames that do not come.
    """
    state, sums = nothing_counted(), {}
    for k, y in enumerate(places):
        if k in silent and k % 20:
            continue  # there is a tick each second
        now = estimates([1] if y is not None else [], 0.0, y or 0.0, 0.0, vy_mps)
        now.lane[:] = lane
        moment = Moment(start_us + k * FRAME_US, k, tick=k in silent)
        state, counts = count(state, moment, now, measured_of(now), ROAD, SETUP)
        sums |= {(part.minute, part.map_version): part for part in counts.cells}
    end = Moment(start_us + len(places) * FRAME_US + 1_000_000, len(places), tick=True)
    state, counts = count(
        state, end, estimates([], 0, 0, 0, 0), measured_of(estimates([], 0, 0, 0, 0)), ROAD, SETUP
    )
    sums |= {(part.minute, part.map_version): part for part in counts.cells}
    return {
        (minute, int(row["cell"])): (float(row["distance_m"]), float(row["time_s"]))
        for (minute, _), part in sums.items()
        for row in part.records.reshape(-1).view(CELL)
    }


def test_a_way_is_cut_exactly_at_the_edges_of_cells():
    found = driven(np.arange(115.0, 5.0, -0.5))

    minute = START_US // MINUTE_US
    assert found == {(minute, cell): (20.0, 2.0) for cell in range(5)}  # and nothing beyond the lane's ends


def test_a_way_is_cut_at_the_edge_of_a_minute():
    found = driven(np.arange(99.0, 91.0, -0.5), start_us=START_US + MINUTE_US - 250_000)

    minute = START_US // MINUTE_US
    assert found[minute, 0] == (2.5, 0.25)
    assert found[minute + 1, 0] == (5.0, 0.5)


def test_a_gap_that_the_tracker_bridged_is_driven_through():
    places = np.arange(115.0, 5.0, -0.5).tolist()

    assert driven([*places[:60], *[None] * 20, *places[80:]]) == driven(places)


def test_a_vehicle_that_is_listed_again_under_its_number_was_there_all_the_while():
    """It stops at 60 m, is hidden for ten seconds, and goes on from 58 m."""
    before, after = np.arange(105.0, 60.0, -0.5).tolist(), np.arange(58.0, 30.0, -0.5).tolist()

    found = driven([*before, *[None] * 200, *after])

    metres, seconds = np.sum(list(found.values()), axis=0)
    assert metres == pytest.approx(105.0 - 30.5, abs=1e-3)
    assert seconds == pytest.approx((len(before) + 200 + len(after) - 1) * FRAME_US / 1e6, abs=1e-3)

    unseen = driven([*before, *[None] * 200, *after], silent=range(len(before), len(before) + 200))
    metres, seconds = np.sum(list(unseen.values()), axis=0)
    assert seconds == pytest.approx(
        (len(before) + len(after) - 2) * FRAME_US / 1e6, abs=1e-3
    )  # no frame came


def test_a_number_that_comes_back_elsewhere_bridges_nothing():
    before, after = np.arange(105.0, 60.0, -0.5).tolist(), np.arange(70.0, 30.0, -0.5).tolist()

    found = driven([*before, *[None] * 200, *after])  # ten metres back

    _, seconds = np.sum(list(found.values()), axis=0)
    assert seconds == pytest.approx((len(before) + len(after) - 2) * FRAME_US / 1e6, abs=1e-3)


def test_the_trembling_of_a_standing_vehicle_adds_time_and_no_distance():
    rng = np.random.default_rng(2)
    places = np.concatenate([[80.0], 80.0 + rng.normal(0, 0.3, 200), [80.0]])

    ((distance_m, time_s),) = driven(places, vy_mps=0.0).values()

    assert abs(distance_m) < 1e-3
    assert time_s == pytest.approx(201 * 0.05)


def test_edies_flow_is_density_times_speed():
    table = np.zeros(2, CELL)
    table["lane"], table["length_m"], table["distance_m"], table["time_s"] = 1, 20.0, 200.0, [20.0, 10.0]
    minute = START_US // MINUTE_US + np.arange(2)
    cells = CellTable(minute, np.ones(2, int), np.ones(2, int), table)
    got = Received(minute, *(np.full(2, n) for n in (1200, 1200, MINUTE_US)))

    (edie,) = (edie_table(cells, got, START_US + np.array([0, 2]) * MINUTE_US),)

    assert edie.flow_vph.tolist() == [3600 * 400 / (20 * 120)]
    assert edie.speed_mps.tolist() == [400 / 30]
    assert edie.flow_vph[0] == pytest.approx(3.6 * edie.density_per_km[0] * edie.speed_mps[0], rel=1e-9)


def test_places_along_a_bent_line_are_lengths_of_its_way():
    corner = np.array([[0.0, 0.0], [0.0, 10.0], [10.0, 10.0]])

    found = along(corner, np.array([0.5, 4.0, 12.0, 0.0]), np.array([3.0, 10.5, 10.0, -2.0]))

    np.testing.assert_allclose(found, [3.0, 14.0, 22.0, -2.0])


def test_without_drawn_lines_one_is_placed_across_the_lanes_of_each_direction():
    first, second = place_lines(ROAD, SETUP.parameters.counting)

    assert (first.line_id, second.line_id) == ("auto-1", "auto-2")
    assert (first.y0_m, first.y1_m) == (60.0, 60.0)
    assert sorted((first.x0_m, first.x1_m)) == [-2.5, 6.0]
    assert sorted((second.x0_m, second.x1_m)) == [-10.5, -5.5]
    assert first.x0_m > first.x1_m  # approaching traffic goes to the left of the way from right to left
    assert second.x0_m < second.x1_m


def test_placed_lines_stay_while_the_map_has_the_same_lanes():
    setup = traffic_setup(SensorConfig())
    nobody = estimates([], 0, 0, 0, 0)

    def lines_after(state, lanes, k):
        state, _ = count(
            state, Moment(START_US + k * FRAME_US, k, tick=False), nobody, measured_of(nobody), lanes, setup
        )
        return state, state.lines

    moved = [replace(lane, points_m=lane.points_m + np.array([0.2, 0.0])) for lane in ROAD.lanes]
    state, first = lines_after(nothing_counted(), ROAD, 1)
    state, second = lines_after(state, replace(ROAD, version=4, lanes=tuple(moved)), 2)
    state, third = lines_after(state, replace(ROAD, version=5, lanes=tuple(moved[:2])), 3)

    assert len(first) == 2
    assert second == first
    assert len(third) == 1


def test_the_measures_of_a_queue_are_right_where_the_tracks_are():
    scenario = scenario_named("queue")
    frames = list(simulate(scenario, seed=1, duration_s=40.0))
    config, lanes = SensorConfig(sensor_id="radar-1"), counts.lane_map(scenario)
    tracks = []
    for k, simulated in enumerate(frames):
        v = simulated.vehicles
        now = estimates(v.vehicle_id + 1, v.x_m, v.y_m, v.vx_mps, v.vy_mps)
        tracks.append((simulated.frame.time_us, k, now, False))
    nobody = estimates(np.zeros(0), *np.zeros((4, 0)))
    tracks += [(tracks[-1][0] + k * 1_000_000, len(frames), nobody, True) for k in range(1, 5)]
    cell_m = traffic_setup(config).parameters.counting.cell_m
    true = counts.true_cells(lanes, frames, cell_m)
    run = counts.Run("queue", False, config, lanes, 40.0, [], true, tracks)

    errors = counts.edie([counts.tally(run)])

    assert errors["edie_cells"] >= 5
    assert max(errors[f"edie_{name}_mean_abs"] for name in "qkv") < 0.01
