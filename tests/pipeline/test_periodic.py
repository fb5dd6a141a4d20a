"""The thread that does one thing again and again."""

from __future__ import annotations

import threading

import pytest
from structlog.testing import capture_logs

from service.errors import Unavailable
from service.pipeline import periodic as periodic_module
from service.pipeline.periodic import Periodic

SOON_S = 0.01
LONG_S = 3600.0
PATIENCE_S = 30.0


@pytest.mark.parametrize(
    ("fault", "told"),
    [(Unavailable("the database is away"), "put off"), (KeyError("x"), "put off by a fault of the program")],
)
def test_a_fault_is_told_and_does_not_end_the_work(fault, told):
    calls, thrice = [], threading.Event()

    def act():
        calls.append(None)
        if len(calls) == 1:
            raise fault
        if len(calls) == 3:
            thrice.set()

    with capture_logs() as logs:
        periodic = Periodic("test", SOON_S, act)
        periodic.start()
        assert thrice.wait(PATIENCE_S)
        periodic.stop()
    assert [(entry["event"], entry["thread"]) for entry in logs] == [(told, "wayside-test")]
    assert len(calls) >= 3
    assert not [thread for thread in threading.enumerate() if thread.name == "wayside-test"]


def told_of(faults):
    """Return (event, with a trace) of each line about faults that come in turn; None: none comes."""
    calls, through = iter(faults), threading.Event()

    def act():
        try:
            fault = next(calls)
        except StopIteration:
            through.set()
            return
        if fault is not None:
            fault()

    with capture_logs() as logs:
        periodic = Periodic("test", 0.0, act)
        periodic.start()
        assert through.wait(PATIENCE_S)
        periodic.stop()
    return [(entry["event"], "exc_info" in entry) for entry in logs]


def no_key():
    {}["x"]


def no_item():
    [].pop()


FAULT, STILL = "put off by a fault of the program", "still put off by a fault of the program"


def test_a_fault_that_lasts_is_told_with_its_trace_once():
    assert told_of([no_key] * 50) == [(FAULT, True)]
    assert told_of([no_key, None, no_key]) == [(FAULT, True)]


def test_another_fault_is_told_with_its_trace():
    assert told_of([no_key, no_key, no_item, no_item, no_key]) == [(FAULT, True)] * 3


def test_a_fault_that_lasts_is_told_again_by_a_line_and_later_with_its_trace(monkeypatch):
    monkeypatch.setattr(periodic_module, "TELL_AGAIN_S", 0.0)
    assert told_of([no_key] * 3) == [(FAULT, True), (STILL, False), (STILL, False)]
    monkeypatch.setattr(periodic_module, "TRACE_AGAIN_S", 0.0)
    assert told_of([no_key] * 3) == [(FAULT, True)] * 3


def test_a_stop_does_not_wait_for_the_interval():
    called = threading.Event()
    periodic = Periodic("test", LONG_S, called.set)
    periodic.start()
    assert called.wait(PATIENCE_S)
    periodic.stop()  # returns: the test would otherwise outlast its limit
    assert not [thread for thread in threading.enumerate() if thread.name == "wayside-test"]


def test_what_never_began_can_be_stopped():
    called = threading.Event()
    Periodic("test", SOON_S, called.set).stop()
    assert not called.is_set()
