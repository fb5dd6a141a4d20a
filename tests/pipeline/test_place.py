"""Where a tracker process is, whom its deaths are charged to, and when it hangs."""

from __future__ import annotations

import os
import time

from service.pipeline.blame import Blame, BlameBook, PlaceFile
from service.pipeline.place import Place, Stall, nowhere, open_place, shared_memory


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


def test_deaths_and_what_was_set_aside_outlive_the_service(tmp_path):
    heard = []
    asked = lambda _, position: 1000 * position  # noqa: E731
    assert not any(BlameBook(tmp_path, asked, heard.append).died_at("radar-1", 7) for _ in range(2))
    assert heard == []
    assert BlameBook(tmp_path, asked, heard.append).died_at("radar-1", 7)
    assert heard == ["radar-1"]

    again = BlameBook(tmp_path, asked, heard.append)
    assert (again.of("radar-1").set_aside, again.of("radar-1").digests) == ([7], [7000])
    for position in (8, 9, 10):
        for _ in range(3):
            again.died_at("radar-1", position)
    assert again.of("radar-1").failure == "the tracker's process ends at every record, last at 10"
    again.forgive("radar-1")
    assert BlameBook(tmp_path, asked, heard.append).of("radar-1").failure is None
    again.forget("radar-1")
    assert BlameBook(tmp_path, asked, heard.append).of("radar-1") == Blame()


def test_a_place_is_found_after_both_processes_were_killed(tmp_path):
    book = BlameBook(tmp_path, lambda *_: None, lambda _: None)
    pid = os.fork()
    if pid == 0:
        inner = nowhere(PlaceFile(book.place_path(3)))
        inner.begin(7, 2**40)
        os._exit(9)
    os.waitpid(pid, 0)
    idle = nowhere(PlaceFile(book.place_path(0)))
    idle.begin(7, 5)
    idle.end()

    assert book.take_places() == [(7, 2**40)]
    assert book.take_places() == []


def test_a_file_of_blames_that_cannot_be_read_is_no_obstacle(tmp_path):
    (tmp_path / "set_aside.json").write_text("{")
    assert BlameBook(tmp_path, lambda *_: None, lambda _: None).of("radar-1") == Blame()


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


def test_telling_the_place_takes_next_to_nothing(tmp_path):
    place = Place(bytearray(24), PlaceFile(tmp_path / "place"))
    begun_s = time.thread_time()
    for position in range(20_000):
        place.begin(1, position)
        place.end()

    assert (time.thread_time() - begun_s) / 20_000 < 20e-6  # 3 us measured; a frame takes 2 ms
