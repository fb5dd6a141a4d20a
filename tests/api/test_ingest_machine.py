"""Any order of new, repeated, altered, late, early and refused frames and reboots, against a plain model."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test

from service.formats.rfc3339 import format_time_exact
from service.pipeline.records import FrameRecord
from tests.api.serving import serving

NOW_US = 1_764_000_000_000_000
PERIOD_US = 50_000
IDS = itertools.count()


class Boot:
    """What a reader of docs/ingest.md would expect of one run of the sensor's counter."""

    def __init__(self, start_us) -> None:
        self.start_us = start_us  # the time of number 0
        self.seen = {}  # number -> content
        self.held = set()
        self.released = None

    def time_us(self, number):
        return self.start_us + number * PERIOD_US

    def expect(self, number, content):
        if number in self.seen:
            return "duplicate" if self.seen[number] == content else "conflict"
        self.seen[number] = content
        if self.released is not None and number <= self.released:
            return "late"
        self.held.add(number)
        while self.held:
            first = min(self.held)
            if self.released is not None and first != self.released + 1 and len(self.held) <= 2:
                break
            self.held.remove(first)
            self.released = first
        return "accepted"


class Ingest(RuleBasedStateMachine):
    service = None  # set by the test

    @initialize()
    def register(self):
        self.sensor_id = f"machine-{next(IDS)}"
        assert self.service.post("/sensors", json={"sensor_id": self.sensor_id}).status_code == 201
        self.boot = Boot(NOW_US - 600_000_000)
        self.logged = 0

    def post(self, number, content, **changes):
        frame = {
            "timestamp": format_time_exact(self.boot.time_us(number)),
            "frame": number,
            "detections": [{"range_m": 30.0 + content, "azimuth_deg": 1.0}],
        }
        return self.service.post(f"/sensors/{self.sensor_id}/frames", json=frame | changes)

    def check(self, number, content):
        expected = self.boot.expect(number, content)
        reply = self.post(number, content)
        if expected == "conflict":
            assert reply.status_code == 409
        else:
            assert (reply.json().get("status"), reply.status_code) == (
                expected,
                200 if expected == "duplicate" else 202,
            )
        self.logged += 1

    @rule(step=st.sampled_from([1, 1, 1, 2, 3, 5]), content=st.integers(0, 3))
    def go_on(self, step, content):
        self.check(max(self.boot.seen, default=0) + step, content)

    @rule(back=st.integers(0, 12), content=st.integers(0, 3))
    def come_back_to_an_earlier_number(self, back, content):
        number = max(self.boot.seen, default=0) - back
        if number >= 0 and self.boot.seen:
            self.check(number, content)

    @rule(first=st.integers(0, 3))
    def reboot(self, first):
        """The counter starts again while time goes on; nothing of a former boot is sent any more."""
        newest = max(self.boot.seen, default=0)
        if newest <= first:
            return
        after_us = self.boot.time_us(newest) + PERIOD_US
        self.boot = Boot(after_us - first * PERIOD_US)
        self.check(first, 0)

    @rule(changes=st.sampled_from([
        {"timestamp": "2999-01-01T00:00:00Z"},
        {"frame": -1},
        {"detections": {"range_m": [1.0], "azimuth_deg": []}},
        {"sensor_id": "another"},
    ]))  # fmt: skip
    def send_what_is_refused(self, changes):
        assert self.post(max(self.boot.seen, default=0) + 1, 0, **changes).status_code == 422

    @invariant()
    def the_log_holds_what_was_not_refused_and_nothing_else(self):
        log = self.service.host._frame_log
        records = log.read(self.sensor_id, 0, 1000)
        assert sum(isinstance(record, FrameRecord) for _, record in records) == self.logged


@pytest.mark.slow
def test_ingest_keeps_to_its_contract_in_any_order(tmp_path):
    with serving(tmp_path, clock=lambda: NOW_US) as running:
        Ingest.service = running
        run_state_machine_as_test(
            Ingest,
            settings=settings(
                max_examples=25,
                stateful_step_count=30,
                derandomize=True,
                database=None,
                deadline=None,
                suppress_health_check=list(HealthCheck),
            ),
        )
