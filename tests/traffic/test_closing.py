"""What a recording tells when it has ended."""

from __future__ import annotations

import numpy as np
import pytest

from service.formats.sensor import GivenLane, LaneControl, SensorConfig
from service.traffic import closing, monitor
from service.traffic.model import NO_LANE, Moment
from service.traffic.parameters import traffic_setup
from tests.traffic.test_monitor import scene
from tests.traffic.tracks import FRAME_US, START_US, estimates

LINE = {"line_id": "A", "p0": [-10.0, 60.0], "p1": [10.0, 60.0]}
CONFIG = SensorConfig(sensor_id="radar-1", count_lines=[LINE])
SHORT_S = 20.0  # too short for a live map, long enough for a whole one


def recorded(seconds, config=CONFIG):
    """Fold a recording of two lanes until every vehicle has gone; return state, setup, outputs, end."""
    setup = traffic_setup(config)
    state, outputs, now_us = monitor.initial_state(), [], START_US
    for k, now in enumerate(scene(seconds)):
        now_us = START_US + k * FRAME_US
        state, _, found = monitor.step(state, Moment(now_us, k, tick=False), now, setup)
        outputs.append(found)
    nobody = estimates(np.zeros(0, np.int64), np.zeros(0), np.zeros(0), 0.0, 0.0)
    for _ in range(10):
        now_us += 1_000_000
        state, _, found = monitor.step(state, Moment(now_us, k, tick=True), nobody, setup)
        outputs.append(found)
    return state, setup, outputs, now_us


@pytest.fixture(scope="module")
def short():
    return recorded(SHORT_S)


def lanes_of(blocks):
    return np.concatenate([block.table()["lane"] for block in blocks])


def test_crossings_of_a_recording_without_a_live_map_get_the_lanes_of_the_whole_one(short):
    state, setup, _, end_us = short
    assert state.map.version == 0
    before = lanes_of(state.counts.blocks)

    whole = closing.whole_map(state, setup)
    found = closing.told_by(whole, state, end_us, setup)

    after = lanes_of(found.counts.blocks)
    assert (before == NO_LANE).all()
    assert len(after) == len(before) >= 8
    assert set(after.tolist()) == {lane.index for lane in whole.lanes}
    assert {int(v) for block in found.counts.blocks for v in block.table()["map_version"]} == {1}


def test_its_changes_of_lanes_are_told(short):
    state, setup, outputs, end_us = short
    assert not any(found.changes for found in outputs)

    (change,) = closing.told_by(closing.whole_map(state, setup), state, end_us, setup).changes

    assert change.number == 8
    assert (change.time_us - START_US) / 1e6 == pytest.approx(7 * 1.5 + 2.5 + 1.5, abs=0.35)


def test_what_a_live_map_told_is_not_told_again():
    state, setup, outputs, end_us = recorded(60.0)
    assert state.map.version > 0
    told = [change for found in outputs for change in found.changes]

    found = closing.told_by(closing.whole_map(state, setup), state, end_us, setup)

    assert len(told) == 1
    assert found.changes == ()
    assert all((block.table()["lane"] != NO_LANE).all() for block in found.counts.blocks)


def test_lanes_that_were_given_tell_nothing_new():
    drawn = GivenLane(index=9, points_m=((1.8, 120.0), (1.8, 20.0)))
    config = CONFIG.model_copy(update={"lanes": LaneControl(mode="replaced", lanes=(drawn,))})
    state, setup, _, end_us = recorded(12.0, config)

    whole = closing.whole_map(state, setup)

    assert whole is state.map
    assert closing.told_by(whole, state, end_us, setup) == monitor.Outputs()


def test_of_too_little_there_is_no_map_and_nothing_to_tell():
    state, setup, _, end_us = recorded(4.0)

    whole = closing.whole_map(state, setup)

    assert whole.lanes == ()
    assert closing.told_by(whole, state, end_us, setup) == monitor.Outputs()
