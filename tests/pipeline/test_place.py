"""Where a tracker process is, whom its deaths are charged to, and when it hangs."""

from __future__ import annotations

import os
import time

from service.pipeline.place import Blame, Place, Stall, nowhere, open_place, shared_memory


def test_another_process_reads_what_was_being_folded_when_this_one_died():
    memory = shared_memory()
    place = open_place(memory)
    pid = os.fork()
    if pid == 0:
        inner = open_place(memory)
        inner.begin(7, 2**40)
        inner.end()
        inner.begin(7, 2**40 + 1)
        os._exit(9)
    os.waitpid(pid, 0)
    os.close(memory)

    assert place.read() == (7, 2**40 + 1, 3)
    place.end()
    assert place.read()[0] == 0


def test_three_deaths_in_a_row_at_one_position_set_it_aside():
    blame = Blame()
    found = [blame.died_at(position) for position in (5, 5, 4, 5, 5, 5, 5, 9)]

    assert found == [False, False, False, False, False, True, False, False]
    assert blame.set_aside == [5]


def test_a_sensor_is_hopeless_when_records_near_each_other_are_set_aside():
    near, far = Blame(), Blame()
    for k in range(4):
        for _ in range(3):
            assert not near.hopeless
            near.died_at(10 + k)
            far.died_at(1 + 400 * k)

    assert near.hopeless
    assert far.set_aside == [1, 401, 801, 1201]
    assert not far.hopeless


def test_a_process_hangs_when_neither_message_nor_step_is_seen():
    place = nowhere()
    stall = Stall(place, 60.0, 0.0)

    assert not stall.over(59.0, heard=False)
    assert not stall.over(61.0, heard=True)
    place.begin(1, 1)
    assert not stall.over(120.0, heard=False)
    assert not stall.over(179.0, heard=False)
    assert stall.over(180.0, heard=False)
    assert not stall.over(181.0, heard=False)  # once each time


def test_telling_the_place_takes_next_to_nothing():
    place = Place(bytearray(24))
    begun_s = time.thread_time()
    for position in range(20_000):
        place.begin(1, position)
        place.end()

    assert (time.thread_time() - begun_s) / 20_000 < 20e-6  # 0.4 us measured; a frame takes 2 ms
