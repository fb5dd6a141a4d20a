from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from service.formats.sensor import CountLine, SensorConfig
from service.tracking.model import TrackStatus
from service.traffic.counting import count, nothing_counted
from service.traffic.measured import measured_of
from service.traffic.model import NO_MAP, Moment
from service.traffic.parameters import traffic_setup
from service.traffic.records import MINUTE_US
from tests.traffic.tracks import FRAME_US, START_US, estimates

LINE = CountLine(line_id="C40", p0=(-6.0, 40.0), p1=(6.0, 40.0))
SETUP = traffic_setup(SensorConfig(count_lines=(LINE,)))
NOBODY = estimates([], 0, 0, 0, 0)


def watch(frames, *, ticks=5, setup=SETUP, period_us=FRAME_US, lanes=NO_MAP):
    """Return what became certain over the frames and the seconds after them, and the state then."""
    state, told = nothing_counted(), []
    for k, now in enumerate(frames):
        state, counts = count(
            state, Moment(START_US + k * period_us, k, tick=False), now, measured_of(now), lanes, setup
        )
        told.append(counts)
    end_us = START_US + len(frames) * period_us
    for second in range(ticks):
        moment = Moment(end_us + second * 1_000_000, len(frames), tick=True)
        state, counts = count(state, moment, NOBODY, measured_of(NOBODY), lanes, setup)
        told.append(counts)
    return told, state


def crossings(frames, **changes):
    return [crossing for counts in watch(frames, **changes)[0] for crossing in counts.crossings]


def drive(number, y_m, *, x_m=0.0, vy_mps=-12.0, status=TrackStatus.CONFIRMED):
    """One vehicle at these places, frame by frame."""
    return [estimates([number], x_m, y, 0.0, vy_mps, status=status) for y in y_m]


def approach(start_m=60.0, end_m=20.0, speed_mps=12.0):
    return np.arange(start_m, end_m, -speed_mps * FRAME_US / 1e6)


def merged(*parts):
    """Several vehicles in the same frames; parts may be of different length."""
    frames = []
    for k in range(max(map(len, parts))):
        here = [part[k] for part in parts if k < len(part) and part[k] is not None]
        columns = [np.concatenate([getattr(one, name) for one in here]) for name in ("number", "x_m", "y_m")]
        speeds = [np.concatenate([getattr(one, name) for one in here]) for name in ("vx_mps", "vy_mps")]
        order = np.argsort(columns[0])
        frames.append(estimates(*(column[order] for column in (*columns, *speeds))))
    return frames


def test_a_vehicle_crosses_once_at_the_moment_when_its_centre_is_on_the_line():
    (crossing,) = crossings(drive(7, approach()))

    assert crossing.time_us - START_US == pytest.approx(20 / 12 * 1e6, abs=1000)  # told to the millisecond
    assert (crossing.line_id, crossing.track, crossing.direction) == ("C40", 7, -1)
    assert crossing.speed_mps == pytest.approx(12.0, abs=1e-5)
    assert crossing.y_m == pytest.approx(40.0, abs=1e-4)
    assert math.isnan(crossing.headway_s)


def test_the_other_way_is_the_other_direction():
    away = [estimates([1], 2.0, y, 0.0, 12.0) for y in approach(60, 20)[::-1]]

    assert [crossing.direction for crossing in crossings(away)] == [1]


def test_a_line_that_lies_askew_is_crossed_at_its_own_place():
    askew = CountLine(line_id="askew", p0=(-10.0, 30.0), p1=(10.0, 50.0))
    setup = traffic_setup(SensorConfig(count_lines=(askew,)))
    east = [estimates([1], x, 40.0, 10.0, 0.0) for x in np.arange(-15.0, 15.0, 0.5)]

    (crossing,) = crossings(east, setup=setup)

    assert crossing.time_us - START_US == pytest.approx(1.5e6, abs=1000)
    assert crossing.direction == -1  # to the right of the way from p0 to p1


def test_standing_and_trembling_on_the_line_counts_once_when_it_goes_on():
    rng = np.random.default_rng(8)
    stand = 40.0 + rng.normal(0, 0.4, 300)
    places = np.concatenate([approach(60, 40), stand, approach(40, 20)])

    (crossing,) = crossings(drive(1, places))

    assert (crossing.time_us - START_US) / 50_000 == pytest.approx(34 + 300, abs=60)


def test_a_vehicle_that_creeps_back_and_forth_over_the_line_counts_once():
    creep = 40.0 + 4.0 * np.sin(np.arange(0, 40, 0.05))

    assert len(crossings(drive(1, np.concatenate([approach(60, 40), creep, approach(40, 20)])))) == 1


def test_whoever_turns_back_before_the_line_is_behind_it_does_not_cross():
    places = np.concatenate([approach(60, 39), approach(60, 39)[::-1]])

    assert crossings(drive(1, places)) == []


@pytest.mark.parametrize("broken_m", [52.0, 41.0, 39.5, 35.0])
@pytest.mark.parametrize("gap_s", [0.1, 0.5, 1.5])
def test_a_vehicle_whose_track_breaks_counts_once(broken_m, gap_s):
    places = approach()
    first = int(np.argmax(places < broken_m))
    second = first + round(gap_s * 20)
    pieces = [*drive(1, places[:first]), *[NOBODY] * (second - first), *drive(2, places[second:])]

    (crossing,) = crossings(pieces)

    assert crossing.vehicle == 1
    assert crossing.time_us - START_US == pytest.approx(20 / 12 * 1e6, abs=20_000)


@pytest.mark.parametrize("back_m", [39.0, 60.0])
def test_a_vehicle_whose_number_comes_back_after_a_long_rest_is_not_counted_again(back_m):
    other = drive(2, np.full(400, 50.0), x_m=20.0, vy_mps=0.0)
    away, again = approach(60.0, 32.0), approach(back_m, 20.0)
    rested = [*drive(1, away), *[None] * 100, *drive(1, again)]

    found = crossings(merged(other, rested))

    assert [(crossing.track, crossing.vehicle) for crossing in found] == [(1, 1)]
    assert found[0].time_us - START_US == pytest.approx(20 / 12 * 1e6, abs=20_000)


def test_of_two_vehicles_one_behind_the_other_both_count():
    follower = [None] * 30 + drive(2, approach())

    found = crossings(merged(drive(1, approach()), follower))

    assert [crossing.track for crossing in found] == [1, 2]


def test_a_ghost_beside_an_older_track_does_not_count():
    ghost = [None] * 20 + drive(2, approach(60 - 12 + 2.5, 20), x_m=0.8)

    assert [crossing.track for crossing in crossings(merged(drive(1, approach()), ghost))] == [1]


@pytest.mark.parametrize("x_m", [1.4, 3.5])  # the first: a motorcycle, or two tracks that lean to one another
def test_a_vehicle_in_the_next_lane_is_no_ghost(x_m):
    beside = [None] * 20 + drive(2, approach(60 - 12, 20), x_m=x_m)

    assert len(crossings(merged(drive(1, approach()), beside))) == 2


def test_a_track_that_only_coasts_over_the_line_does_not_count():
    coasting = drive(1, approach(41, 20), status=TrackStatus.COASTING)

    assert crossings([*drive(1, approach(60, 41)), *coasting]) == []
    assert len(crossings([*drive(1, approach(60, 41)), *coasting[:10], *drive(1, approach(35, 20))])) == 1


def test_a_flash_of_a_track_does_not_count():
    assert crossings(drive(1, approach(45, 36))) == []  # 0.75 s


def test_whoever_passes_beside_the_ends_of_the_line_does_not_cross():
    assert crossings(drive(1, approach(), x_m=7.0)) == []


def test_a_vehicle_that_was_first_listed_behind_the_line_was_born_before_it():
    late = [estimates([1], 0.0, y, 0.0, -12.0) for y in approach(38, 15)]
    for one in late:
        one.born_us[:] = START_US - 1_000_000  # 12 m ago

    (crossing,) = crossings(late)

    assert crossing.time_us - START_US == pytest.approx(-2 / 12 * 1e6, abs=1000)


def test_the_running_minute_is_told_again_when_it_grows_and_a_late_crossing_gets_a_part_of_its_own():
    standing = np.full(300, 39.0)  # over the line, but not far enough behind it, for 150 s
    way = np.concatenate([np.arange(60, 39, -1.5), standing, np.arange(39, 20, -1.5)])
    known = dataclasses.replace(NO_MAP, version=1)
    told, _ = watch(drive(1, way, vy_mps=-3.0), period_us=500_000, lanes=known)

    (block,) = [block for counts in told for block in counts.blocks]
    assert block.part > 0
    assert block.minute == START_US // MINUTE_US
    assert block.table()["track"].tolist() == [1]

    told, _ = watch(drive(1, way, vy_mps=-3.0), period_us=500_000)  # no lanes yet: the minute is still open

    assert [block.part for counts in told for block in counts.blocks] == [0]


def test_frames_received_are_told_at_once_each_ten_seconds_and_finally():
    told, state = watch(drive(1, np.full(500, 80.0)))

    latest = {part.minute: part for counts in told for part in counts.received}
    (minute,) = latest.values()
    assert (minute.frames, minute.expected, minute.observed_us) == (500, 1200, 24_950_000)
    assert sum(bool(counts.received) for counts in told) == 4
    assert state.idle


def test_time_without_frames_is_not_observed():
    state = nothing_counted()
    for k in [*range(100), *range(300, 400)]:  # ten seconds are missing
        state, _ = count(
            state, Moment(START_US + k * FRAME_US, k, tick=False), NOBODY, measured_of(NOBODY), NO_MAP, SETUP
        )

    assert sum(part.observed_us for part in state.coverage.minutes) == pytest.approx(9.95e6, abs=1)


def test_the_probability_is_the_existence_of_the_track_and_that_it_is_no_second_one():
    frames = drive(1, approach())
    for now in frames:
        now.existence[:] = 0.8

    (crossing,) = crossings(frames)

    assert crossing.probability == pytest.approx(0.8 * SETUP.parameters.counting.real_share, abs=1e-6)


WIDE = traffic_setup(SensorConfig(count_lines=(CountLine(line_id="C40", p0=(-20.0, 40.0), p1=(20.0, 40.0)),)))


def ahead_and_behind(behind):
    """A vehicle in the lane 8 m aside and, listed a little later, another that is where `behind` says."""
    frames = []
    for k, y in enumerate(approach(75.0, 10.0, 15.0)):
        x_m, y_m = behind(8.0, y)
        late = k >= 10
        now = estimates([1, 2][: 1 + late], [8.0, x_m][: 1 + late], [y, y_m][: 1 + late], 0.0, -15.0)
        now.born_us[1:] += 5 * FRAME_US
        frames.append(now)
    return frames


def late_echo(x, y, late_m=14.0):
    stretch = 1.0 + late_m / math.hypot(x, y)
    return x * stretch, y * stretch


def test_a_late_echo_of_a_vehicle_does_not_count():
    found = crossings(ahead_and_behind(late_echo), setup=WIDE)

    assert [crossing.track for crossing in found] == [1]


@pytest.mark.parametrize("aside_m", [0.0, 1.0, 3.5])
def test_one_that_follows_in_its_lane_or_beside_it_does(aside_m):
    found = crossings(ahead_and_behind(lambda x, y: (x + aside_m, y + 14.0)), setup=WIDE)

    assert [crossing.track for crossing in found] == [1, 2]
