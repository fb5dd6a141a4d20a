"""Vehicles as chains of tracks, by the number of their newest one."""

import numpy as np

from service.traffic.count_parameters import CountParameters
from service.traffic.stitching import join, no_vehicles
from service.traffic.window import Scan
from tests.traffic.tracks import FRAME_US, START_US

P = CountParameters()


def scan(k, *tracks):
    """Return a frame with tracks (number, x_m, y_m), all going ahead at 10 m/s and born a second ago."""
    number, x_m, y_m = (np.array(column) for column in zip(*tracks, strict=True))
    time_us = START_US + k * FRAME_US
    still = np.zeros(len(number))
    real = np.array([x_m, y_m, still, still + 10.0, still + 4.5, still + 1.0])
    lane, born_us = np.zeros(len(number), np.uint8), np.full(len(number), time_us - 1_000_000)
    return Scan(time_us, k, number.astype(np.int64), real, lane, born_us)


def test_vehicles_stand_by_the_number_of_their_newest_track():
    before = join(no_vehicles(), scan(0, (1, 0.0, 50.0), (5, 9.0, 50.0)), P).vehicles
    place = 50.0 + 10.0 * FRAME_US / 1e6

    joined = join(before, scan(1, (3, 30.0, 20.0), (5, 9.0, place), (8, 0.0, place)), P)

    assert joined.vehicles.number.tolist() == [3, 5, 8]
    assert joined.vehicles.vehicle.tolist() == [3, 5, 1]  # 8 goes on where 1 was lost
    assert joined.origin.tolist() == [-1, 1, 0]
    assert joined.measured.tolist() == [0, 1, 2]
    assert joined.from_number.tolist() == [3, 5, 1]
    assert joined.from_y_m.tolist() == [10.0, 50.0, 50.0]  # a new one is moved back to its birth
    assert joined.vehicles.track_us.tolist() == [START_US + FRAME_US, START_US, START_US + FRAME_US]


def test_one_that_is_not_seen_stays_where_it_was_until_a_gap_is_too_long():
    before = join(no_vehicles(), scan(0, (1, 0.0, 50.0), (5, 9.0, 50.0)), P).vehicles

    soon = join(before, scan(1, (5, 9.0, 50.5)), P)
    late = join(soon.vehicles, scan(1 + round(P.stitch_gap_s * 1e6 / FRAME_US), (5, 9.0, 80.0)), P)

    assert soon.origin is None
    assert soon.vehicles.real[1].tolist() == [50.0, 50.5]
    assert soon.vehicles.last_us.tolist() == [START_US, START_US + FRAME_US]
    assert (late.vehicles.number.tolist(), late.origin.tolist()) == ([5], [1])
