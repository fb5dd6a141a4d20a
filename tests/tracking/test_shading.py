"""Who stands in the edge of a shadow is seen in part, and is not where the mean of its echoes is."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from service.tracking import assigning, shading_kernels
from service.tracking import boxes as b
from service.tracking.parameters import SensorModel, TrackerParameters
from service.tracking.shading import ShadingParameters, shade
from service.tracking.state import Tracks, no_tracks
from tests.tracking.test_tracker import detections, frame, leaping, numbers, run, vehicle, with_recovery

MAST_M, ECHO_M = 6.0, 0.6
TRUCK = 12.0, 2.5
CAR = 4.4, 1.9
RECEDING, APPROACHING = 0.0, math.pi


def box(x, y, size=CAR, heading=RECEDING):
    row = np.zeros(b.BOX_COLUMNS)
    row[[b.BX, b.BY, b.BSIN, b.BCOS]] = x, y, math.sin(heading), math.cos(heading)
    row[[b.BLEN, b.BWID]] = size
    row[b.BHIDDEN] = 1.0
    return row


def shaded(*rows, hits=50, p=None, mast_m=MAST_M):
    """Return the boxes as they are once shadows have been thrown; hits of all, or of each."""
    boxes = np.array(rows).reshape(-1, b.BOX_COLUMNS)
    blank = no_tracks(0)
    columns = (getattr(blank, field.name) for field in dataclasses.fields(blank))
    tracks = Tracks(*(np.zeros((len(rows), *c.shape[1:]), c.dtype) for c in columns)).but(
        status=np.ones(len(rows), np.uint8), hits=np.broadcast_to(hits, len(rows)).astype(np.int64)
    )
    assert tracks.confirmed.all()
    shade(
        boxes, tracks, SensorModel(mount_height_m=mast_m, scatter_height_m=ECHO_M), p or ShadingParameters()
    )
    return boxes


def shift(*rows, **options):
    """Return how far to the right of its middle the echoes of the last box are moved."""
    return shaded(*rows, **options)[-1, b.BSHIFT]


@pytest.mark.parametrize(("heading", "side"), [(RECEDING, 1.0), (APPROACHING, -1.0)])
def test_of_a_car_half_behind_a_truck_the_other_half_is_seen(heading, side):
    # the truck's near corner, 1.25 m aside at 54 m, hides what is less than 1.8 m aside at 77.8 m: half a car
    right = shift(box(0.0, 60.0, TRUCK), box(1.8, 80.0, heading=heading))
    left = shift(box(0.0, 60.0, TRUCK), box(-1.8, 80.0, heading=heading))

    assert side * right == pytest.approx(0.45, abs=0.12)
    assert left == pytest.approx(-right, abs=1e-9)


def test_its_place_is_the_less_certain_the_more_it_is_put_right():
    part = shaded(box(0.0, 60.0, TRUCK), box(1.8, 80.0))

    assert part[1, b.BVAR_SHIFT] == pytest.approx((0.5 * part[1, b.BSHIFT]) ** 2)
    assert part[0, b.BSHIFT] == part[0, b.BVAR_SHIFT] == 0.0
    assert part[:, b.BHIDDEN].tolist() == [0.0, 1.0]


def test_a_shadow_is_as_long_as_its_vehicle_is_high():
    far = box(1.4, 90.0)

    assert shift(box(0.0, 60.0), box(1.0, 70.0)) > 0.2
    assert shift(box(0.0, 60.0), far) == 0.0
    assert shift(box(0.0, 60.0, TRUCK), far) > 0.2
    assert shift(box(0.0, 60.0), far, mast_m=1.4) > 0.2  # no higher than the car: without an end
    assert shaded(box(0.0, 60.0), far)[1, b.BHIDDEN] == 0.0


def test_over_a_car_the_radar_sees_most_of_a_truck():
    pair = box(0.0, 50.0), box(0.9, 61.0, TRUCK)

    assert 0.0 < shift(*pair) < 0.5 * shift(*pair, p=ShadingParameters(long_echo_m=ECHO_M))


def test_two_boxes_on_one_vehicle_do_not_push_one_another_aside():
    bus = box(2.0, 65.0, TRUCK)

    assert shift(box(1.2, 60.0, TRUCK), bus) == 0.0
    assert shift(box(0.0, 50.0, TRUCK), bus) > 0.3  # another bus before it
    assert shift(box(-0.4, 58.0, TRUCK), bus) > 0.1  # or beside it, in the next lane


@pytest.mark.parametrize("hits", [(29, 50), (50, 29)])
def test_only_what_has_been_seen_often_counts(hits):
    pair = box(0.0, 60.0, TRUCK), box(1.8, 80.0)

    assert shift(*pair, hits=hits) == 0.0
    assert shift(*pair, hits=30) > 0.3


def test_who_may_be_hidden_by_what_is_not_certain_stays_so():
    assert shaded(box(0.0, 50.0, TRUCK), box(0.0, 60.0), hits=(29, 50))[1, b.BHIDDEN] == 1.0
    assert shaded(box(0.0, 53.9, TRUCK), box(0.0, 60.0))[1, b.BHIDDEN] == 1.0  # the tail is in the car's gate
    assert shaded(box(6.0, 50.0, TRUCK), box(0.0, 60.0))[1, b.BHIDDEN] == 0.0


def test_a_truck_alongside_hides_what_it_has_not_yet_passed():
    car = box(23.5, 35.0)

    assert shift(box(20.0, 37.0, (16.0, 2.5)), car) == pytest.approx(0.6, abs=0.1)
    assert shift(box(20.0, 37.2, (16.0, 2.5)), car) == pytest.approx(0.6, abs=0.1)  # it is farther off now


@pytest.mark.parametrize("turn", [0.5, 1.5, math.pi, 3.15, 4.0])
def test_the_scene_may_lie_anywhere_around_the_radar(turn):
    s, c = math.sin(turn), math.cos(turn)
    pair = [(0.3, 50.0, TRUCK), (1.5, 60.0, CAR)]
    turned = [box(c * x + s * y, c * y - s * x, size, turn) for x, y, size in pair]

    assert shift(*turned) == pytest.approx(shift(*(box(*place) for place in pair)), abs=1e-6)
    assert shift(*turned) > 0.1


def test_a_ray_along_a_face_is_like_one_a_hair_beside_it():
    truck = box(0.3, 50.0, (9.0, 3.0))

    assert shift(truck, box(0.8, 60.0)) == pytest.approx(shift(truck, box(0.8 + 1e-6, 60.0)), abs=1e-3)


def test_a_radar_no_higher_than_the_echoes_tells_nothing():
    pair = np.array([box(0.0, 60.0, TRUCK), box(1.8, 80.0)])

    assert np.array_equal(shaded(*pair, mast_m=ECHO_M), pair)


def test_who_is_seen_from_the_side_is_left_alone():
    assert shift(box(0.0, 60.0, TRUCK), box(1.8, 80.0, heading=0.5 * math.pi)) == 0.0


def test_it_can_be_switched_off_and_nothing_is_nothing():
    pair = np.array([box(0.0, 60.0, TRUCK), box(1.8, 80.0)])

    assert np.array_equal(shaded(*pair, p=ShadingParameters(enabled=False)), pair)
    assert len(shaded()) == 0


def test_the_order_of_the_boxes_does_not_matter():
    rng = np.random.default_rng(5)
    rows = [
        box(x, y, CAR if k % 3 else TRUCK)
        for k, (x, y) in enumerate(rng.uniform((-8, 30), (8, 120), (20, 2)))
    ]
    order = rng.permutation(20)

    there = shaded(*rows)

    assert np.count_nonzero(there[:, b.BSHIFT]) > 3
    assert np.array_equal(shaded(*np.array(rows)[order]), there[order])


def blocked(row, height_m, x, y):
    """Return whether the straight way from the radar to an echo leads through the box, in many steps."""
    t = np.linspace(0.0, 1.0, 20_001)[:-1]
    dx, dy = t * x - row[b.BX], t * y - row[b.BY]
    u, w = row[b.BSIN] * dx + row[b.BCOS] * dy, row[b.BCOS] * dx - row[b.BSIN] * dy
    inside = (np.abs(u) < 0.5 * row[b.BLEN]) & (np.abs(w) < 0.5 * row[b.BWID])
    return bool((inside & (MAST_M + t * (ECHO_M - MAST_M) < height_m)).any())


def test_what_a_box_hides_is_what_lies_behind_it():
    rng = np.random.default_rng(8)
    hidden = 0
    for _ in range(40):
        row = box(
            *rng.uniform((-6, 30), (6, 60)), TRUCK if rng.random() < 0.5 else CAR, rng.uniform(0.0, 6.3)
        )
        height_m = float(rng.uniform(1.2, 3.5))
        reach = rng.uniform(1.0, 1.7, shading_kernels.SAMPLES)
        x = row[b.BX] * reach + rng.uniform(-2, 2, len(reach))
        y = row[b.BY] * reach
        loss = np.zeros(len(reach))
        shading_kernels._darken.py_func(row, x, y, MAST_M, ECHO_M, height_m, loss)
        truth = [blocked(row, height_m, *place) for place in zip(x, y, strict=True)]
        hidden += sum(truth)
        assert np.count_nonzero((loss > 0.0) != truth) <= 1  # one may lie on an edge, between two steps
        assert loss.max() <= shading_kernels.MOST_DB
    assert 100 < hidden < 460


def test_a_measurement_is_put_right_by_the_shift():
    rows = np.array([box(3.0, 70.0), box(3.0, 70.0)])
    rows[1, [b.BSHIFT, b.BVAR_SHIFT]] = 0.4, 0.09
    points = np.zeros((2, b.POINT_COLUMNS))
    points[:, b.PX], points[:, b.PY], points[:, b.PWEIGHT] = (3.2, 3.8), 67.8, 1.0
    points[:, b.PG] = np.hypot(points[:, b.PX], points[:, b.PY])
    pair, owner = np.arange(2), np.zeros(2, np.int64)

    without, with_shift = b.measure_boxes(pair, np.zeros(2, np.int64), owner, points, rows, 20.0)

    assert with_shift[b.M_W] - without[b.M_W] == pytest.approx(-0.4)
    assert with_shift[b.M_VAR_W] - without[b.M_VAR_W] == pytest.approx(0.09)


def half_seen(*, enabled):
    """Return where a car that follows a truck, half in its shadow, is after four seconds; it is at 1.8 m."""
    rng, frames = np.random.default_rng(3), []
    for k in range(80):
        y = 60.0 + 0.4 * k
        truck = vehicle(rng, 0.0, y, 0.0, 8.0, length=12.0, width=2.5, points=14)
        u = np.concatenate([np.zeros(4), rng.uniform(0.0, 4.4, 2)])  # its rear, and its roof
        edge = 1.25 * (y + 17.8) / (y - 6.0)  # the truck's near corner, from the radar, on the car's rear
        w = rng.uniform(np.full(6, edge), 2.75)
        car = detections(rng, w, y + 17.8 + u, np.zeros(6), np.full(6, 8.0), 22.0)
        frames.append(frame(k, truck, car))
    parameters = TrackerParameters().with_setting("shading.enabled", str(enabled).lower())
    _, outputs = run(frames, parameters)
    last = outputs[-1]
    ahead = last.y_m > last.y_m.min() + 10.0
    assert np.count_nonzero(ahead) == 1
    return float(last.x_m[ahead][0])


def test_a_car_in_the_edge_of_a_shadow_is_tracked_where_it_is():
    assert half_seen(enabled=True) == pytest.approx(1.8, abs=0.15)
    assert half_seen(enabled=False) > 2.0


def test_a_track_is_set_anew_where_its_vehicle_is_and_not_by_the_shadow_it_was_in(monkeypatch):
    frames = leaping(np.random.default_rng(7), 3.0)[:64]
    _, in_sight = run(frames, with_recovery())

    def in_a_shadow_while_lost(boxes, tracks, _sensor, _p):
        boxes[:, b.BSHIFT] = np.where(tracks.empty > 0, 0.6, 0.0)

    monkeypatch.setattr(assigning, "shade", in_a_shadow_while_lost)
    _, shaded_then = run(frames, with_recovery())

    assert numbers(shaded_then) == [1]
    assert in_sight[-1].x_m[0] > 5.5
    np.testing.assert_array_equal(shaded_then[-1].x_m, in_sight[-1].x_m)
