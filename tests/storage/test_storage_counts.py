from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from service.errors import NotFound
from service.formats.length_class import LENGTH_CLASSES
from service.formats.sensor import SensorConfig
from service.storage.counts import known_lines, read_cells, read_crossings, read_received, save_counts
from service.storage.database import connection, session_scope
from service.storage.rows import CellRow, CrossingBlock, MinuteRow
from service.storage.sites import update_sensor
from service.traffic.cells import CELL
from service.traffic.records import MINUTE_US, Crossing, record_of
from tests.storage.conftest import NOW_US, START_S

MINUTE = START_S // 60


def block(
    *seconds, line_id="C40", minute=MINUTE, part=0, as_of=5, epoch=1, length_m=math.nan
) -> CrossingBlock:
    """A block with a crossing at each of these seconds of its minute."""
    records = b"".join(
        record_of(
            Crossing(
                line_id=line_id, time_us=minute * MINUTE_US + round(second * 1e6), track=k + 1, vehicle=k + 1,
                frame=k, lane=2, direction=-1, x_m=1.0, y_m=40.0, speed_mps=12.3456, length_m=length_m,
                probability=0.99, number=k + 1,
            )
        ).tobytes()
        for k, second in enumerate(seconds)
    )  # fmt: skip
    return CrossingBlock("radar-1", epoch, line_id, minute, part, as_of, records)


def save(engine, *, crossings=(), minutes=(), cells=()):
    with session_scope(engine) as writer:
        save_counts(writer, crossings, minutes, cells, now_us=NOW_US)


def crossings(engine, start_s=0, end_s=120, **given):
    with connection(engine) as reader:
        base_us = MINUTE * MINUTE_US
        return read_crossings(
            reader, "radar-1", base_us + start_s * 1_000_000, base_us + end_s * 1_000_000, **given
        )


def test_stored_crossings_are_classed_by_the_bounds_that_the_sensor_has_now(engine, sensor):
    save(engine, crossings=[block(1.0, length_m=2.2), block(2.0, minute=MINUTE + 1)])
    before = crossings(engine)
    with session_scope(engine) as writer:
        config = SensorConfig(sensor_id=sensor, length_bounds_m=(2.0, 6.55, 14.9))
        update_sensor(writer, sensor, {"config": config}, now_us=NOW_US)

    assert before.length_class.tolist() == [LENGTH_CLASSES.index("motorcycle"), -1]
    assert crossings(engine).length_class.tolist() == [LENGTH_CLASSES.index("short"), -1]


def test_a_block_gives_way_only_to_a_later_one(engine, sensor):
    save(engine, crossings=[block(1.0, 2.5)])
    save(engine, crossings=[block(1.0, 2.5, 3.0, as_of=9)])
    save(engine, crossings=[block(1.0, as_of=7)])  # an old one, written again after a restart

    found = crossings(engine)

    assert ((found.time_us - MINUTE * MINUTE_US) / 1e6).tolist() == [1.0, 2.5, 3.0]
    assert found.speed_mps.tolist() == [12.346] * 3  # exact to what is told: the millimetre
    assert np.isnan(found.length_m).all()


def test_crossings_are_read_by_time_over_lines_minutes_and_parts(engine, sensor):
    save(
        engine,
        crossings=[
            block(30.0, 59.9),
            block(10.0, line_id="C80"),
            block(5.0, minute=MINUTE + 1),
            block(20.0, part=77),
        ],
    )

    assert crossings(engine).line_id.tolist() == ["C80", "C40", "C40", "C40", "C40"]
    assert len(crossings(engine, line_id="C40")) == 4
    assert len(crossings(engine, 10, 30)) == 2  # half-open
    with connection(engine) as reader:
        assert known_lines(reader, "radar-1") == ["C40", "C80"]
        with pytest.raises(NotFound):
            read_crossings(reader, "nobody", 0, 1)


def test_frames_of_two_epochs_in_a_minute_add_up(engine, sensor):
    first = MinuteRow("radar-1", 1, MINUTE, 3, frames=400, expected=1200, observed_us=20_000_000)
    save(engine, minutes=[first, replace(first, epoch=2, frames=500, observed_us=25_000_000)])
    save(engine, minutes=[replace(first, as_of=2, frames=1)])

    with connection(engine) as reader:
        found = read_received(reader, "radar-1", MINUTE * MINUTE_US, (MINUTE + 1) * MINUTE_US)

    assert found.minute.tolist() == [MINUTE]
    assert (found.frames[0], found.expected[0], found.observed_us[0]) == (900, 1200, 45_000_000)


def test_sums_of_cells_come_back_as_they_were(engine, sensor):
    table = np.zeros(2, CELL)
    table["lane"], table["cell"], table["distance_m"], table["time_s"] = [1, 2], [3, 4], [200.5, 10], [20, 1]
    save(engine, cells=[CellRow("radar-1", 1, MINUTE, 7, 3, table.tobytes())])

    with connection(engine) as reader:
        found = read_cells(reader, "radar-1", MINUTE * MINUTE_US, (MINUTE + 1) * MINUTE_US)

    np.testing.assert_array_equal(found.table, table)
    assert found.map_version.tolist() == [7, 7]
