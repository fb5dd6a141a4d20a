"""The whole chain on small made-up traffic: what a tracker must never get wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from service.errors import InvalidInput
from service.tracking import snapshot
from service.tracking.filters.registry import filter_names, make_filter
from service.tracking.model import Frame, TrackStatus
from service.tracking.parameters import TrackerParameters
from service.tracking.tracker import TrackerState, coast, initial_state, step

T0_US = 1_750_000_000_000_000
PERIOD_US = 50_000


def vehicle(rng, x, y, vx, vy, *, length=4.5, width=1.8, points=6):
    """Points (n, 4), range, azimuth, rate, SNR, of the near face and a side of a box that drives along y."""
    side = points // 3  # seen along the side that faces the radar, the rest on the near face
    u = np.concatenate([np.full(points - side, -length / 2), rng.uniform(-length / 2, length / 2, side)])
    face = rng.uniform(-width / 2, width / 2, points - side)
    w = np.concatenate([face, np.full(side, -np.sign(x) * width / 2)])
    px, py = x + w + rng.normal(0, 0.05, points), y + u + rng.normal(0, 0.1, points)
    return detections(rng, px, py, np.full(points, vx), np.full(points, vy), 25.0)


def detections(rng, px, py, vx, vy, snr_db):
    ground = np.hypot(px, py)
    slant = np.hypot(ground, 5.4)
    rate = (vx * px + vy * py) / slant + rng.normal(0, 0.08, len(px))
    azimuth = np.arctan2(px, py) + rng.normal(0, np.deg2rad(0.2), len(px))
    return np.stack([slant, azimuth, rate, np.full(len(px), snr_db)], axis=1)


def frame(k, *parts):
    rows = np.concatenate([np.zeros((0, 4)), *parts])
    columns = [rows[:, c].astype(np.float32) for c in range(4)]
    return Frame("radar-1", T0_US + k * PERIOD_US, k, None, *columns)


def run(frames, parameters=None, state=None):
    parameters = parameters or TrackerParameters()
    state = state or initial_state(parameters)
    outputs = []
    for f in frames:
        state, estimates, _ = step(state, f, parameters)
        outputs.append(estimates)
        cov = state.tracks.cov
        assert np.array_equal(cov, cov.transpose(0, 2, 1))
        assert (np.linalg.eigvalsh(cov) > 0).all()
    return state, outputs


def numbers(outputs):
    return sorted({int(n) for e in outputs for n in e.number})


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def test_one_car_is_one_track_with_its_centre_and_velocity(rng):
    frames = [frame(k, vehicle(rng, 3.5, 120.0 - 0.75 * k, 0.0, -15.0)) for k in range(100)]

    _, outputs = run(frames)

    assert len(numbers(outputs)) == 1
    last = outputs[-1]
    assert last.x_m[0] == pytest.approx(3.5, abs=0.4)
    assert last.y_m[0] == pytest.approx(120.0 - 0.75 * 99, abs=0.8)
    assert last.vy_mps[0] == pytest.approx(-15.0, abs=0.3)
    assert last.length_m[0] == pytest.approx(4.5, abs=1.0)
    first = next(k for k, e in enumerate(outputs) if len(e))
    assert first <= 8  # 0.4 s at 20 Hz


def test_two_cars_side_by_side_stay_two(rng):
    frames = [
        frame(k, vehicle(rng, 0.0, 90.0 - 0.6 * k, 0.0, -12.0), vehicle(rng, 3.5, 90.0 - 0.6 * k, 0.0, -12.0))
        for k in range(90)
    ]

    _, outputs = run(frames)

    assert len(numbers(outputs)) == 2
    assert all(len(e) == 2 for e in outputs[15:])


def test_a_truck_is_one_track_and_long(rng):
    frames = [
        frame(k, vehicle(rng, 3.0, 110.0 - 0.6 * k, 0.0, -12.0, length=14.0, width=2.5, points=16))
        for k in range(120)
    ]

    _, outputs = run(frames)

    assert all(len(e) <= 1 for e in outputs[30:])
    assert outputs[-1].length_m[0] == pytest.approx(14.0, abs=1.5)


def turned(rng, x, y, heading, speed, *, length=4.5, width=1.8, points=6):
    """Return the points of the sides that the radar sees of a box in any heading, clockwise from +y."""
    s, c = np.sin(heading), np.cos(heading)
    ahead, right = np.sign(-(s * x + c * y)), np.sign(-(c * x - s * y))
    share = width * abs(s * x + c * y) / (width * abs(s * x + c * y) + length * abs(c * x - s * y))
    end = rng.random(points) < share
    u = np.where(end, ahead * length / 2, rng.uniform(-length / 2, length / 2, points))
    w = np.where(end, rng.uniform(-width / 2, width / 2, points), right * width / 2)
    px, py = x + s * u + c * w + rng.normal(0, 0.1, points), y + c * u - s * w + rng.normal(0, 0.1, points)
    return detections(rng, px, py, np.full(points, speed * s), np.full(points, speed * c), 22.0)


def test_a_car_that_turns_across_the_line_of_sight_keeps_its_number_and_heading(rng):
    x, y, heading, frames, truth = 4.0, 45.0, 0.0, [], []
    for k in range(120):
        heading += 0.05 if 60 <= k < 60 + np.pi / 2 / 0.05 else 0.0  # 1 rad/s at 8 m/s: a radius of 8 m
        x, y = x + 0.4 * np.sin(heading), y + 0.4 * np.cos(heading)
        truth.append(heading)
        frames.append(frame(k, turned(rng, x, y, heading, 8.0)))

    _, outputs = run(frames)

    assert len(numbers(outputs)) == 1
    assert all(len(e) == 1 for e in outputs[20:])
    lag = [h - float(e.heading_rad[0]) for h, e in zip(truth, outputs, strict=True) if len(e)]
    assert max(np.abs(lag[75:])) < 0.35


def entering(rng, x, y, vy, *, length, points, view_from_m=18.0):
    """Return the points of a vehicle that drives away, without those that are too near to be seen."""
    rows = vehicle(rng, x, y, 0.0, vy, length=length, width=2.5, points=points)
    u = rng.uniform(-length / 2, length / 2, points)  # seen from above: echoes of all its length
    rows[:, 0] = np.hypot(np.hypot(x, y + u), 5.4) + rng.normal(0, 0.1, points)
    rows[:, 1] = np.arctan2(x, y + u) + rng.normal(0, np.deg2rad(0.2), points)
    return rows[np.hypot(x, y + u) > view_from_m]


def test_a_truck_that_drives_into_the_view_from_below_is_one_track(rng):
    frames = [frame(k, entering(rng, -4.0, 8.0 + 0.6 * k, 12.0, length=14.0, points=24)) for k in range(100)]

    _, outputs = run(frames)

    assert len(numbers(outputs)) == 1
    assert all(len(e) == 1 for e in outputs[20:])
    assert outputs[-1].length_m[0] == pytest.approx(14.0, abs=1.5)
    assert outputs[-1].y_m[0] == pytest.approx(8.0 + 0.6 * 99, abs=1.0)


def test_a_car_that_brakes_and_stands_is_kept(rng):
    y, v, frames = 100.0, -12.0, []
    for k in range(400):
        v = min(0.0, v + 0.15) if k > 60 else v
        y += v * 0.05
        frames.append(frame(k, vehicle(rng, 2.0, y, 0.0, v)))

    state, outputs = run(frames)

    assert numbers(outputs[20:]) == numbers(outputs[-1:])
    assert abs(outputs[-1].vy_mps[0]) < 0.3
    assert outputs[-1].y_m[0] == pytest.approx(y, abs=1.0)
    assert state.tracks.confirmed.sum() == 1


def test_posts_make_no_tracks(rng):
    x, y = np.array([-6.0, -6.0, -6.0, 7.0, 7.0]), np.array([40.0, 44.0, 48.0, 60.0, 80.0])
    frames = [frame(k, detections(rng, x, y, np.zeros(5), np.zeros(5), 25.0)) for k in range(200)]

    _, outputs = run(frames)

    assert all(len(e) == 0 for e in outputs)


def test_three_posts_near_one_another_are_no_vehicle_that_stands(rng):
    x, y = np.array([-6.0, -6.0, -6.0]), np.array([60.0, 61.2, 62.4])
    frames = [frame(k, detections(rng, x, y, np.zeros(3), np.zeros(3), 25.0)) for k in range(200)]

    _, outputs = run(frames)

    assert all(len(e) == 0 for e in outputs)


def test_the_number_of_a_post_does_not_rest(rng):
    x, y = np.array([-6.0, -6.0, -6.0]), np.array([60.0, 61.2, 62.4])
    posts = detections(rng, x, y, np.zeros(3), np.zeros(3), 25.0)
    frames = [
        frame(k, *([posts] if k < 45 else [])) for k in range(60)
    ]  # silent when they are found to be posts
    p = TrackerParameters()
    loose = dataclasses.replace(p.birth, standing_points_per_frame=2.0)

    state, outputs = run(frames, dataclasses.replace(p, birth=loose))

    assert len(outputs[44]) == 1
    assert len(outputs[-1]) == 0
    assert len(state.resting.number) == 0


def test_a_post_that_had_a_track_gets_no_other(rng):
    x, y = np.array([-6.0, -6.0, -6.0]), np.array([60.0, 61.2, 62.4])
    frames = []
    for k in range(400):
        posts = detections(rng, x, y, np.zeros(3), np.zeros(3), 14.0)[rng.random(3) < 0.5]
        frames.append(frame(k, posts, vehicle(rng, 5.0, 140.0 - 0.75 * (k % 150), 0.0, -15.0, points=4)))
    p = TrackerParameters()
    loose = dataclasses.replace(p.birth, standing_points_per_frame=1.0)

    _, outputs = run(frames, dataclasses.replace(p, birth=loose))

    on_posts = {int(n) for e in outputs for n, at in zip(e.number, e.x_m, strict=True) if at < -3.0}
    assert len(on_posts) == 1


def test_a_car_seen_to_stop_where_nobody_has_driven_is_no_post(rng):
    y, v, frames = 125.0, -3.0, []
    for k in range(400):
        v = min(0.0, v + 0.075) if k > 5 else v
        y += v * 0.05
        frames.append(frame(k, vehicle(rng, -6.0, y, 0.0, v, points=1)))
    known = dataclasses.replace(TrackerParameters().road, mature_tracks=0.0)  # elsewhere the road is known

    _, outputs = run(frames, dataclasses.replace(TrackerParameters(), road=known))

    assert all(len(e) == 1 for e in outputs[200:])
    assert numbers(outputs[200:]) == numbers(outputs[-1:])
    assert outputs[-1].y_m[0] == pytest.approx(y, abs=2.2)  # half a car, of one point


def test_a_short_shadow_does_not_change_the_number(rng):
    frames = [
        frame(k, *([] if 50 <= k < 54 else [vehicle(rng, 1.0, 100.0 - 0.75 * k, 0.0, -15.0)]))
        for k in range(100)
    ]

    _, outputs = run(frames)

    assert len(numbers(outputs)) == 1
    assert outputs[53].status[0] == TrackStatus.COASTING
    assert outputs[-1].status[0] == TrackStatus.CONFIRMED


def test_a_vehicle_without_doppler_is_tracked(rng):
    def blind(rows):
        rows[:, 2] = np.nan
        return rows

    frames = [frame(k, blind(vehicle(rng, 3.5, 120.0 - 0.75 * k, 0.0, -15.0))) for k in range(100)]

    _, outputs = run(frames)

    assert len(numbers(outputs)) == 1
    assert outputs[-1].vy_mps[0] == pytest.approx(-15.0, abs=1.0)


def test_ticks_coast_and_end_the_tracks(rng):
    p = TrackerParameters()
    state, _ = run([frame(k, vehicle(rng, 1.0, 100.0 - 0.75 * k, 0.0, -15.0)) for k in range(40)], p)
    last_us = T0_US + 39 * PERIOD_US

    state, soon, _ = coast(state, last_us + 1_000_000, p)
    state, later, _ = coast(state, last_us + 2_000_000, p)

    assert list(soon.status) == [TrackStatus.COASTING]
    assert len(later) == 0
    assert state.idle


def test_a_turned_mount_is_turned_back(rng):
    offset = np.deg2rad(4.0)
    rows = [vehicle(rng, 0.0, 100.0 - 0.75 * k, 0.0, -15.0) for k in range(60)]
    for r in rows:
        r[:, 1] -= offset
    p = TrackerParameters()
    p = dataclasses.replace(p, sensor=dataclasses.replace(p.sensor, azimuth_offset_rad=offset))

    _, outputs = run([frame(k, r) for k, r in enumerate(rows)], p)

    assert outputs[-1].x_m[0] == pytest.approx(0.0, abs=0.4)


@pytest.mark.parametrize("name", filter_names())
def test_every_filter_by_name_tracks(rng, name):
    p = dataclasses.replace(TrackerParameters(), filter=name)

    _, outputs = run([frame(k, vehicle(rng, 3.5, 120.0 - 0.75 * k, 0.0, -15.0)) for k in range(80)], p)

    assert len(numbers(outputs)) == 1
    assert outputs[-1].vy_mps[0] == pytest.approx(-15.0, abs=0.7)


def test_a_change_of_filter_between_two_frames_keeps_the_tracks(rng):
    frames = [frame(k, vehicle(rng, 3.5, 120.0 - 0.75 * k, 0.0, -15.0)) for k in range(80)]
    state, before = run(frames[:40])

    _, after = run(frames[40:], dataclasses.replace(TrackerParameters(), filter="ekf"), state)

    assert numbers(before) == numbers(after)


def test_a_filter_whose_options_change_what_it_remembers_keeps_the_tracks(rng):
    frames = [frame(k, vehicle(rng, 3.5, 120.0 - 0.75 * k, 0.0, -15.0)) for k in range(80)]
    safe = dataclasses.replace(TrackerParameters(), filter="mast-ukf")
    state, before = run(frames[:40], safe)

    state, after = run(frames[40:], safe.with_setting("filters.mast_ukf.form", "paper"), state)

    assert numbers(before) == numbers(after)
    assert state.tracks.memory.shape[1] > 60


def test_the_models_of_an_imm_follow_what_the_tracker_learns_between_frames(rng):
    p = dataclasses.replace(TrackerParameters(), filter="imm")
    models = make_filter("imm")

    state, _ = run([frame(k, vehicle(rng, 3.5, 120.0 - 0.75 * k, 0.0, -15.0)) for k in range(60)], p)

    mixture = models.unpacked(state.tracks.memory)
    moved = mixture.moved_to(state.tracks.mean, state.tracks.cov)
    assert not np.array_equal(mixture.moments()[0], state.tracks.mean)  # heading and length moved it
    np.testing.assert_allclose(moved.moments()[0], state.tracks.mean, atol=1e-9)


def test_the_order_of_points_in_a_frame_does_not_matter(rng):
    frames = [
        frame(k, vehicle(rng, 0.0, 90.0 - 0.6 * k, 0.0, -12.0), vehicle(rng, 3.5, 70.0 + 0.5 * k, 0.0, 10.0))
        for k in range(60)
    ]
    order = [rng.permutation(len(f)) for f in frames]
    mixed = [
        dataclasses.replace(
            f,
            range_m=f.range_m[o],
            azimuth_rad=f.azimuth_rad[o],
            radial_velocity_mps=f.radial_velocity_mps[o],
            snr_db=f.snr_db[o],
        )
        for f, o in zip(frames, order, strict=True)
    ]

    a, b = run(frames)[1][-1], run(mixed)[1][-1]

    np.testing.assert_allclose(a.x_m, b.x_m, atol=1e-4)  # same sums in another order
    np.testing.assert_allclose(a.y_m, b.y_m, atol=1e-4)


def test_a_restored_snapshot_goes_on_to_the_bit(rng):
    frames = [frame(k, vehicle(rng, 3.5, 120.0 - 0.75 * k, 0.0, -15.0)) for k in range(80)]
    state, _ = run(frames[:40])

    restored = snapshot.load(TrackerState, snapshot.dump(state))
    a, b = run(frames[40:], None, state)[0], run(frames[40:], None, restored)[0]

    assert snapshot.dump(a) == snapshot.dump(b)


def test_empty_frames_and_an_empty_start_are_fine():
    state, outputs = run([frame(k) for k in range(5)])

    assert state.idle
    assert all(len(e) == 0 for e in outputs)


def leaping(rng, sideways_m):
    """A car that its track loses: it is suddenly beside where it was."""
    frames = [frame(k, vehicle(rng, 3.5, 110.0 - 0.75 * k, 0.0, -15.0)) for k in range(60)]
    return frames + [
        frame(k, vehicle(rng, 3.5 + sideways_m, 110.0 - 0.75 * k, 0.0, -15.0)) for k in range(60, 100)
    ]


def with_recovery():
    parameters = TrackerParameters()
    return dataclasses.replace(parameters, recovery=dataclasses.replace(parameters.recovery, enabled=True))


def test_the_recovery_lets_a_lost_car_keep_its_number(rng):
    frames = leaping(rng, 3.0)

    _, without = run(frames)
    _, recovered = run(frames, with_recovery())

    assert numbers(without) == [1, 2]
    assert numbers(recovered) == [1]
    assert recovered[-1].x_m[0] == pytest.approx(6.5, abs=0.4)
    assert recovered[-1].vy_mps[0] == pytest.approx(-15.0, abs=0.4)


def test_the_recovery_changes_nothing_while_no_track_is_lost(rng):
    frames = [
        frame(
            k, vehicle(rng, 3.5, 120.0 - 0.75 * k, 0.0, -15.0), vehicle(rng, 0.0, 90.0 - 0.6 * k, 0.0, -12.0)
        )
        for k in range(80)
    ]

    _, without = run(frames)
    _, recovered = run(frames, with_recovery())

    for one, other in zip(without, recovered, strict=True):
        np.testing.assert_array_equal(one.x_m, other.x_m)


def test_a_snapshot_in_the_middle_of_a_loss_goes_on_alike(rng):
    frames, parameters = leaping(rng, 3.0), with_recovery()
    state, _ = run(frames[:63], parameters)
    assert state.trails.trail.empty.any()

    restored = snapshot.load(TrackerState, snapshot.dump(state))

    after, again = run(frames[63:], parameters, state)[1], run(frames[63:], parameters, restored)[1]
    assert numbers(after) == [1]
    for one, other in zip(after, again, strict=True):
        np.testing.assert_array_equal(one.x_m, other.x_m)


def test_association_by_maximum_probability_gives_each_track_one_measurement(rng):
    frames = [
        frame(
            k,
            vehicle(rng, 1.75, 120.0 - 0.75 * k, 0.0, -15.0),
            vehicle(rng, -1.75, 120.0 - 0.75 * k, 0.0, -15.0),
        )
        for k in range(100)
    ]
    parameters = TrackerParameters().with_setting("boxes.association", "maximum-probability")

    _, outputs = run(frames, parameters)

    assert len(numbers(outputs)) == 2
    assert sorted(outputs[-1].x_m.tolist()) == pytest.approx([-1.75, 1.75], abs=0.4)


def test_an_unknown_association_is_refused():
    with pytest.raises(InvalidInput, match="known are jpda, maximum-probability"):
        TrackerParameters().with_setting("boxes.association", "nearest")


def test_a_post_stays_known_while_its_points_are_not_used(rng):
    post = [detections(rng, *(np.array([c]) for c in (-8.0, 60.0, 0.0, 0.0)), 20.0) for _ in range(300)]

    state, outputs = run([frame(k, p) for k, p in enumerate(post)])

    assert state.clutter.occupancy.max() > 0.6
    assert numbers(outputs) == []
