"""The thread that does one thing again and again."""

from __future__ import annotations

import threading

import pytest
from structlog.testing import capture_logs

from service.errors import Unavailable
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
