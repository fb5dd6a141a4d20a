"""Scenarios give the same frames for the same seed, and truth that belongs to them."""

from __future__ import annotations

import dataclasses
import gzip
import itertools

import numpy as np
import pytest

from service.errors import InvalidInput, NotFound
from service.simulation.frames import SimulatedFrame
from service.simulation.scenario import SCENARIOS, START_US, endless_frames, from_trajectories, simulate
from service.simulation.trajectories import TrajectorySampler, read_trajectories

HEADER = "vehicle_id,t_s,x_m,y_m,vx_mps,vy_mps,length_m,width_m,class,lane_id\n"


def quick(name: str):
    return dataclasses.replace(SCENARIOS[name], warm_up_s=15.0)


def equal(a: SimulatedFrame, b: SimulatedFrame) -> bool:
    columns = ("range_m", "azimuth_rad", "radial_velocity_mps", "snr_db")
    same_frame = all(np.array_equal(getattr(a.frame, c), getattr(b.frame, c)) for c in columns)
    return (
        same_frame and a.frame.time_us == b.frame.time_us and np.array_equal(a.vehicles.x_m, b.vehicles.x_m)
    )


def test_equal_seeds_give_equal_frames_and_others_do_not():
    first, again, other = (list(simulate(quick("wide"), seed=s, duration_s=0.5)) for s in (7, 7, 8))

    assert len(first) == len(again)
    assert all(equal(a, b) for a, b in zip(first, again, strict=True))
    assert not all(equal(a, b) for a, b in zip(first, other, strict=False))


def test_another_radar_sees_the_same_traffic():
    clear = quick("motorway")
    noisy = dataclasses.replace(clear, radar=dataclasses.replace(clear.radar, false_alarms=30.0))
    a, b = (list(simulate(s, seed=3, duration_s=0.5)) for s in (clear, noisy))

    assert all(np.array_equal(p.vehicles.x_m, q.vehicles.x_m) for p, q in zip(a, b, strict=True))
    assert sum(len(q.frame) for q in b) > sum(len(p.frame) for p in a)


def test_frames_come_at_the_rate_with_growing_numbers():
    frames = [f.frame for f in simulate(quick("curve"), seed=1, duration_s=1.0)]

    assert [f.sequence for f in frames] == list(range(20))
    assert [f.time_us - START_US for f in frames] == [50_000 * k for k in range(20)]


def test_dropped_frames_leave_gaps_and_times_jitter():
    scenario = quick("wide")
    rough = dataclasses.replace(
        scenario,
        traffic=dataclasses.replace(scenario.traffic, approaching_vph=300.0),
        radar=dataclasses.replace(scenario.radar, drop_probability=0.3),
    )
    frames = [f.frame for f in simulate(rough, seed=1, duration_s=5.0)]
    missing = 100 - len(frames)
    off = np.array([f.time_us - START_US - 50_000 * f.sequence for f in frames])

    # 100 frames, each dropped with chance 0.3: four standard deviations are 18
    assert 12 < missing < 48
    assert np.all(np.diff([f.sequence for f in frames]) >= 1)
    assert np.all(np.diff([f.time_us for f in frames]) > 0)
    assert 2_500 < off.std() < 6_000
    assert np.abs(off).max() <= 20_000


def test_labels_name_vehicles_of_the_truth():
    for f in simulate(quick("two_way"), seed=2, duration_s=0.5):
        assert len(f.source) == len(f.frame)
        assert set(f.source[f.source > 0].tolist()) <= set(f.vehicles.vehicle_id.tolist())
        assert set(f.source[f.source <= 0].tolist()) <= {0, -1, -2}


def test_points_lie_where_their_vehicles_are():
    gaps = []
    for f in simulate(quick("motorway"), seed=2, duration_s=1.0):
        ground = np.sqrt(f.frame.range_m.astype(np.float64) ** 2 - 5.4**2)
        x, y = ground * np.sin(f.frame.azimuth_rad), ground * np.cos(f.frame.azimuth_rad)
        for i in range(len(f.vehicles)):
            mine = f.source == f.vehicles.vehicle_id[i]
            gaps += np.hypot(x[mine] - f.vehicles.x_m[i], y[mine] - f.vehicles.y_m[i]).tolist()

    # half a 16 m truck, plus the azimuth noise at 150 m
    assert len(gaps) > 100
    assert np.percentile(gaps, 99) < 10.0


def test_the_demo_has_the_traffic_it_promises_and_does_not_end():
    frames = list(itertools.islice(simulate(quick("demo"), seed=1), 40))
    shown = np.mean([np.sum((f.vehicles.y_m > 20.0) & (f.vehicles.y_m < 150.0)) for f in frames])

    assert len(frames) == 40
    assert 4 < shown < 20
    assert next(endless_frames(quick("demo"), seed=1, sensor_id="gate-7")).sensor_id == "gate-7"


def test_an_unknown_scenario_is_refused_with_those_that_exist():
    with pytest.raises(NotFound, match="motorway"):
        simulate("autobahn", seed=1)


def trajectory_file(folder, rows):
    path = folder / "site.csv.gz"
    path.write_bytes(gzip.compress((HEADER + "\n".join(rows) + "\n").encode()))
    return path


def drive(folder):
    """Two vehicles at 10 Hz: one drives north-east at 14.14 m/s, one stands after it drove east."""
    rows = []
    for k in range(21):
        t = k / 10
        rows.append(f"5,{t:.1f},{100 + 10 * t:.3f},{200 + 10 * t:.3f},10,10,4.5,1.8,car,2")
        rows.append(
            f"9,{t:.1f},{130 + (5 * t if k < 4 else 1.5):.3f},240,{5 if k < 4 else 0},0,12.0,2.5,truck,1"
        )
    return trajectory_file(folder, rows)


def test_given_trajectories_are_interpolated_between_their_rows(tmp_path):
    sampler = TrajectorySampler(read_trajectories(drive(tmp_path)))
    v = sampler.states_at(0.75)

    assert v.vehicle_id.tolist() == [5, 9]
    assert v.x_m[0] == pytest.approx(107.5)
    assert v.y_m[0] == pytest.approx(207.5)
    assert v.heading_rad[0] == pytest.approx(np.pi / 4)
    assert v.heading_rad[1] == pytest.approx(np.pi / 2)  # kept from when it drove
    assert v.height_m[1] >= 3.0
    assert [sampler.trajectories.lane_ids[k] for k in v.lane] == ["2", "1"]
    assert len(sampler.states_at(2.5)) == 0


def test_a_radar_can_be_put_anywhere_before_given_trajectories(tmp_path):
    north_east = read_trajectories(drive(tmp_path)).moved(x_m=80.0, y_m=180.0, heading_rad=np.pi / 4)
    frames = list(from_trajectories(north_east, seed=1))
    v = frames[0].vehicles

    # the first vehicle is on the boresight, 28.3 m away, and drives along it
    assert v.x_m[0] == pytest.approx(0.0, abs=1e-9)
    assert v.y_m[0] == pytest.approx(np.hypot(20.0, 20.0))
    assert v.vy_mps[0] == pytest.approx(np.hypot(10.0, 10.0))
    assert len(frames) == 41
    assert sum(int(f.points[0]) for f in frames) > 100


def test_a_trajectory_file_of_another_kind_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match="vehicle_id"):
        read_trajectories(_packed(tmp_path / "a.csv.gz", "id,t\n1,2\n"))
    with pytest.raises(InvalidInput, match="tram"):
        read_trajectories(_packed(tmp_path / "b.csv.gz", HEADER + "1,0,0,0,0,0,30,2.4,tram,1\n"))
    with pytest.raises(InvalidInput, match="north"):
        read_trajectories(_packed(tmp_path / "c.csv.gz", HEADER + "1,0,north,0,0,0,4,2,car,1\n"))
    with pytest.raises(InvalidInput, match="cannot be read"):
        read_trajectories(tmp_path / "absent.csv.gz")


def _packed(path, text):
    path.write_bytes(gzip.compress(text.encode()))
    return path
