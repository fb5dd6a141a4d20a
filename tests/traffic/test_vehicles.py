"""What is remembered of vehicles when others are listed than before."""

import numpy as np

from service.traffic.vehicles import Vehicles, no_vehicles, parted


def known(*numbers):
    """Return vehicles that can be told apart by what is remembered of them."""
    blank = no_vehicles(np.array(numbers, dtype=np.int64))
    return Vehicles(blank.number, blank.whole + blank.number[:, None], blank.real - blank.number[:, None])


def test_each_keeps_its_own_and_a_new_one_has_nothing():
    here, gone = parted(known(2, 5, 7, 9), np.array([1, 5, 6, 9, 11]))

    assert here.whole[:, 0].tolist() == [0, 5, 0, 9, 0]
    assert here.real[:, -1].tolist() == [0, -5, 0, -9, 0]
    assert (gone.number.tolist(), gone.whole[:, 0].tolist()) == ([2, 7], [2, 7])
    assert gone.real[:, 0].tolist() == [-2, -7]


def test_what_is_returned_is_written_to_without_a_change_of_what_was():
    before = known(1, 2)

    here, gone = parted(before, before.number)
    here.whole[:] = here.real[:] = 0

    assert (len(gone.number), before.whole[:, 0].tolist(), before.real[:, 0].tolist()) == (
        0,
        [1, 2],
        [-1, -2],
    )
