"""Traffic on simulated roads is plausible: nobody overlaps, leaders are followed, lanes change smoothly."""

from __future__ import annotations

import numpy as np
import pytest

from service.simulation.car_following import Driver, advance, idm_acceleration
from service.simulation.roads import bend, one_way, two_way
from service.simulation.scenario import SCENARIOS
from service.simulation.traffic import Signal, SlowZone, Stop, Traffic, TrafficParameters
from service.simulation.vehicles import VehicleStates

DT_S = 0.05


def traffic(name: str, seed: int, *, warm_up_s: float = 40.0) -> Traffic:
    scenario = SCENARIOS[name]
    made = Traffic(scenario.road, scenario.traffic, np.random.default_rng(seed))
    made.run(warm_up_s, 0.1)
    return made


def one_lane(seed: int = 1, *, vph: float = 700.0, **changes) -> Traffic:
    parameters = TrafficParameters(receding_vph=vph, speed_limit_mps=15.0, **changes)
    return Traffic(one_way(1, approaching=False), parameters, np.random.default_rng(seed))


def overlapping_pairs(v: VehicleStates) -> int:
    """Count pairs of boxes that touch, by the separating axis theorem on their four axes."""
    forward = np.stack([np.sin(v.heading_rad), np.cos(v.heading_rad)], axis=1)
    right = np.stack([np.cos(v.heading_rad), -np.sin(v.heading_rad)], axis=1)
    apart = np.stack([v.x_m[:, None] - v.x_m[None], v.y_m[:, None] - v.y_m[None]], axis=2)
    separated = np.zeros((len(v), len(v)), dtype=bool)
    for axis, own in ((forward, v.length_m), (right, v.width_m)):
        other = sum(
            np.abs(axis @ side.T) * size[None, :] / 2
            for side, size in ((forward, v.length_m), (right, v.width_m))
        )
        gap = np.abs(np.einsum("ijk,ik->ij", apart, axis))
        separated |= gap > own[:, None] / 2 + other
    separated |= separated.T
    np.fill_diagonal(separated, val=True)
    return int((~separated).sum()) // 2


def test_a_vehicle_far_from_others_reaches_its_wanted_speed():
    driver = Driver(*(np.array([q]) for q in (20.0, 1.5, 2.0, 1.2, 2.0)))
    speed = np.array([0.0])
    for _ in range(1200):
        _, speed = advance(speed, idm_acceleration(driver, speed, np.array([1e6]), speed), DT_S)

    assert speed[0] == pytest.approx(20.0, abs=0.05)


def test_following_settles_at_the_gap_where_the_model_is_in_equilibrium():
    driver = Driver(*(np.array([q]) for q in (20.0, 1.5, 2.0, 1.2, 2.0)))
    gap, speed, leader = np.array([60.0]), np.array([20.0]), np.array([10.0])
    for _ in range(4000):
        moved, speed = advance(speed, idm_acceleration(driver, speed, gap, leader), DT_S)
        gap = gap + leader * DT_S - moved

    # equilibrium: gap = (s0 + v T) / sqrt(1 - (v / v0)^4)
    assert gap[0] == pytest.approx(14.0 / np.sqrt(1 - 0.5**4), abs=0.05)


def test_braking_to_a_halt_moves_the_stopping_distance_and_no_farther():
    moved, speed = advance(np.array([1.0]), np.array([-4.0]), 1.0)

    assert speed[0] == 0.0
    assert moved[0] == pytest.approx(1.0 / 8.0)


@pytest.mark.parametrize("name", list(SCENARIOS))
def test_no_two_vehicles_overlap(name):
    flow = traffic(name, seed=5, warm_up_s=30.0)
    for _ in range(15):
        flow.run(1.0, 0.1)

        assert overlapping_pairs(flow.states()) == 0


def test_the_overlap_check_finds_an_overlap():
    v = traffic("queue", seed=5).states()
    pushed = v.take(np.array([0, 0]))
    pushed.x_m[1] += 0.3

    assert overlapping_pairs(pushed) == 1


def test_time_gaps_between_followers_are_those_of_drivers():
    flow = traffic("motorway", seed=2)
    gaps = []
    for _ in range(20):
        flow.run(1.0, 0.1)
        fleet = flow.fleet
        for lane in range(3):
            mine = np.flatnonzero((fleet.lane == lane) & (fleet.old_lane == lane))
            mine = mine[np.argsort(fleet.travel_m[mine])]
            space = np.diff(fleet.travel_m[mine]) - (fleet.length_m[mine][1:] + fleet.length_m[mine][:-1]) / 2
            gaps += (space / fleet.speed_mps[mine][:-1]).tolist()

    assert len(gaps) > 150
    assert min(gaps) > 0.3  # just after a lane change before somebody
    assert 1.0 < np.median(gaps) < 6.0  # 1,000 vehicles an hour and lane: 3.6 s apart on average


@pytest.mark.slow
def test_the_demand_arrives():
    flow = one_lane(seed=3)
    flow.run(600.0, 0.2)
    arrived = int(flow.fleet.vehicle_id.max())

    # 700 an hour for 600 s: 117; five standard deviations of a Poisson count are 54
    assert 63 < arrived < 171


def test_lane_changes_are_smooth_and_last_three_to_five_seconds_at_road_speed():
    flow = traffic("dense", seed=4)
    offsets: dict[int, list[tuple[float, float]]] = {}
    for _ in range(300):
        flow.step(DT_S)
        states = flow.states()
        _, offset = flow.road.locate(states.x_m, states.y_m)
        for i, o, speed in zip(flow.fleet.vehicle_id, offset, flow.fleet.speed_mps, strict=True):
            offsets.setdefault(int(i), []).append((float(o), float(speed)))
    moves = []
    for rows in offsets.values():
        offset, speed = np.array(rows).T
        lateral = np.diff(offset) / DT_S
        # minimum jerk: 1.875 times the mean rate of 3.5 m in 3 s, and the swing inside the lane
        assert np.abs(lateral).max(initial=0.0) < 1.875 * 3.5 / 3.0 + 0.15
        if np.ptp(offset) > 3.0 and speed.min() > 5.0:
            moving = np.flatnonzero(np.abs(lateral) > 0.15)
            moves.append((moving[-1] - moving[0]) * DT_S)

    assert len(moves) >= 3
    assert all(m > 2.0 for m in moves)


def test_velocity_is_the_derivative_of_position():
    flow = traffic("curve", seed=6)
    before = flow.states()
    flow.step(0.01)
    after = flow.states()
    common, i, j = np.intersect1d(before.vehicle_id, after.vehicle_id, return_indices=True)

    assert len(common) > 5
    # 0.01 s of at most 8 m/s2: half of 0.08 m/s off
    assert np.allclose((after.x_m[j] - before.x_m[i]) / 0.01, after.vx_mps[j], atol=0.05)
    assert np.allclose((after.y_m[j] - before.y_m[i]) / 0.01, after.vy_mps[j], atol=0.05)


def test_a_red_signal_makes_a_queue_and_green_lets_it_go():
    signal = Signal(100.0, 1, green_s=30.0, amber_s=3.0, red_s=30.0)
    flow = one_lane(seed=2, vph=1200.0, signals=(signal,))
    flow.run(62.0, 0.1)
    front = flow.fleet.travel_m + flow.fleet.length_m / 2
    queued = (flow.fleet.speed_mps < 0.5) & (front < 100.0)

    assert queued.sum() >= 3
    assert not np.any((front > 100.0) & (flow.fleet.speed_mps < 0.5))

    waiting = flow.fleet.vehicle_id[queued]
    flow.run(25.0, 0.1)
    still = np.isin(flow.fleet.vehicle_id, waiting)
    assert np.all(flow.fleet.travel_m[still] > 90.0)


def test_an_ordered_stop_stands_at_its_place_and_goes_on_afterwards():
    flow = one_lane(seed=2, vph=400.0, stops=(Stop("L1", 120.0, start_s=30.0, duration_s=20.0),))
    flow.run(30.0, 0.1)
    stood: list[tuple[int, float, float]] = []
    for _ in range(600):
        flow.step(0.1)
        fleet = flow.fleet
        still = np.flatnonzero(fleet.speed_mps < 0.2)
        stood += [(int(fleet.vehicle_id[i]), float(fleet.travel_m[i]), flow.time_s) for i in still]

    first = stood[0][0]
    mine = [row for row in stood if row[0] == first]
    assert mine[0][1] == pytest.approx(
        120.0, abs=12.0
    )  # front near the line, the centre half a vehicle before
    assert 19.0 < mine[-1][2] - mine[0][2] < 24.0
    assert first not in flow.fleet.vehicle_id or flow.fleet.speed_mps[flow.fleet.vehicle_id == first][0] > 1.0


def test_a_slow_zone_slows_vehicles_inside_it_only_while_it_lasts():
    zone = SlowZone(50.0, 150.0, 4.0, start_s=60.0, duration_s=40.0)
    flow = one_lane(seed=2, slow_zones=(zone,))
    flow.run(60.0, 0.1)
    inside = (flow.fleet.travel_m > 50.0) & (flow.fleet.travel_m < 150.0)
    assert flow.fleet.speed_mps[inside].min() > 8.0

    flow.run(35.0, 0.1)
    inside = (flow.fleet.travel_m > 100.0) & (flow.fleet.travel_m < 150.0)
    assert inside.any()
    assert flow.fleet.speed_mps[inside].max() < 6.5


@pytest.mark.slow
def test_traffic_that_never_ends_keeps_its_size():
    flow = traffic("demo", seed=1)
    sizes = []
    for _ in range(20):
        flow.run(20.0, 0.2)
        sizes.append(len(flow.fleet))

    assert max(sizes) < 80
    assert min(sizes) > 10


def test_placing_and_locating_are_inverse_on_a_bend():
    for radius in (250.0, -180.0):
        road = bend(two_way(2), radius_m=radius, straight_to_m=30.0, heading_rad=0.1)
        s, offset = (q.ravel() for q in np.meshgrid(np.linspace(-20.0, 160.0, 19), np.linspace(-8.0, 8.0, 5)))
        back_s, back_offset = road.locate(*road.place(s, offset))

        assert np.allclose(back_s, s, atol=1e-9)
        assert np.allclose(back_offset, offset, atol=1e-9)


def test_a_bend_to_the_right_goes_to_positive_x():
    road = bend(one_way(1, approaching=False), radius_m=250.0, straight_to_m=15.0)
    x, y = road.place(np.array([15.0, 150.0]), np.zeros(2))

    assert x[0] == pytest.approx(0.0)
    assert x[1] == pytest.approx(250.0 * (1 - np.cos(135.0 / 250.0)))
    assert y[1] == pytest.approx(15.0 + 250.0 * np.sin(135.0 / 250.0))
