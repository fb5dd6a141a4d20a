from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from service.formats.sensor import GivenLane, LaneControl, SensorConfig
from service.tracking import snapshot
from service.tracking.model import TrackEstimates
from service.traffic import closing, monitor
from service.traffic.mapping import lanes_in_steps
from service.traffic.model import Moment
from service.traffic.parameters import traffic_setup
from service.traffic.paths import join
from service.traffic.steps import Progress, at_once
from tests.traffic.roads import drive, evidence_of, straight
from tests.traffic.tracks import FRAME_US, START_US, estimates

SETUP = traffic_setup(SensorConfig(sensor_id="radar-1"))
SPEED_MPS = 16.0
LENGTH_M = 120.0
LANES_X_M = (-1.8, 1.8)


def scene(seconds, *, every_s=1.5, shift_m=0.0, seed=5, changer=7, first=1) -> list[TrackEstimates]:
    """Vehicles that follow one another in two lanes towards the radar; one of them changes lanes."""
    rng = np.random.default_rng(seed)
    count = int(seconds / every_s)
    wobble, phase = rng.normal(0, 0.15, count), rng.uniform(0, 6, count)
    frames = []
    for k in range(int(seconds * 1e6 / FRAME_US)):
        t = k * FRAME_US / 1e6
        age = t - every_s * np.arange(count)
        here = np.flatnonzero((age >= 0) & (age * SPEED_MPS < LENGTH_M))
        x = np.array(LANES_X_M)[here % 2] + shift_m + wobble[here] + 0.1 * np.sin(age[here] + phase[here])
        changing = here == changer
        x[changing] -= 3.6 * np.clip((age[here][changing] - 2.5) / 3.0, 0, 1)
        frames.append(estimates(first + here, x, 140 - SPEED_MPS * age[here], 0.0, -SPEED_MPS))
    return frames


def watch(frames, state=None, setup=SETUP, start=0):
    """Fold the frames; return the state, the outputs and the estimates."""
    state = state or monitor.initial_state()
    outputs, seen = [], []
    for k, now in enumerate(frames, start=start):
        moment = Moment(START_US + k * FRAME_US, k, tick=False)
        state, judged, found = monitor.step(state, moment, now, setup)
        outputs.append(found)
        seen.append(judged)
    return state, outputs, seen


def maps(outputs):
    return [(k, found.map) for k, found in enumerate(outputs) if found.map is not None]


def changes(outputs):
    return [(k, change) for k, found in enumerate(outputs) for change in found.changes]


@pytest.fixture(scope="module")
def minute():
    frames = scene(60)
    return frames, *watch(frames)


def test_lanes_are_learned_and_every_vehicle_is_in_its_own(minute):
    frames, state, outputs, seen = minute
    first = maps(outputs)[0][0]

    assert len(state.map.lanes) == 2
    assert {lane.direction for lane in state.map.lanes} == {"approaching"}
    middles = {lane.index: float(lane.points_m[:, 0].mean()) for lane in state.map.lanes}
    for before, judged in zip(frames[first:], seen[first:], strict=True):
        settled = before.y_m < 60  # the one that changes has arrived
        nearest = np.array([min(middles, key=lambda k, x=x: abs(middles[k] - x)) for x in before.x_m])
        np.testing.assert_array_equal(judged.lane[settled], nearest[settled])


def test_a_change_before_the_first_map_is_found_when_the_map_comes(minute):
    _, _, outputs, _ = minute
    first = maps(outputs)[0][0]

    ((told, change),) = changes(outputs)

    assert told == first
    assert change.number == 8
    assert (change.time_us - START_US) / 1e6 == pytest.approx(7 * 1.5 + 2.5 + 1.5, abs=0.35)
    assert change.from_lane != change.to_lane


def test_a_map_comes_into_force_a_fixed_number_of_frames_after_the_state_it_was_learned_from(minute):
    frames, _, outputs, _ = minute
    begun, states = {}, states_of(frames)
    for k, state in enumerate(states):
        if state.mapping.study is not None:
            begun.setdefault(state.mapping.study.begun, k)

    told = [k for k, _ in maps(outputs)]
    assert told
    assert {k - 40 for k in told} <= set(begun.values())
    for k in told:
        before, known = states[k - 40].mapping, states[k].map.lanes
        assert before.study is not None
        evidence = before.study.evidence
        lanes = at_once(lanes_in_steps(evidence, before.map.lanes, before.gone, SETUP.parameters))
        assert [lane.points_m.tobytes() for lane in lanes] == [lane.points_m.tobytes() for lane in known]


def queue(seconds, count=None, *, changer=None, every_s=1.5, gap_m=7.0, stop_y_m=25.0, seed=5):
    """Vehicles that come in two lanes towards the radar and stand behind one another: nobody leaves.

    changer: number of the one that goes over to the other lane on its way, before it is at 80 m.
    """
    count = count or int(seconds / every_s)
    wobble = np.random.default_rng(seed).normal(0, 0.15, count)
    stop_y = stop_y_m + gap_m * (np.arange(count) // 2)
    frames = []
    for k in range(int(seconds * 1e6 / FRAME_US)):
        age = k * FRAME_US / 1e6 - every_s * np.arange(count)
        here = np.flatnonzero(age >= 0)
        y = np.maximum(140 - SPEED_MPS * age[here], stop_y[here])
        speed = np.where(y > stop_y[here], -SPEED_MPS, 0.0)
        other = np.where(1 + here == changer, np.clip((100.0 - y) / 20.0, 0.0, 1.0), 0.0)
        own, beside = np.array(LANES_X_M)[here % 2], np.array(LANES_X_M)[1 - here % 2]
        frames.append(estimates(1 + here, own + other * (beside - own) + wobble[here], y, 0.0, speed))
    return frames


def test_lanes_are_learned_from_vehicles_in_view_where_nobody_has_left_yet():
    state, outputs, seen = watch(queue(30))

    assert not any(found.finished for found in outputs)
    first = maps(outputs)[0][1]
    middles = sorted(float(lane.points_m[:, 0].mean()) for lane in first.lanes)
    np.testing.assert_allclose(middles, LANES_X_M, atol=0.2)
    assert first.vehicles >= 8
    assert set(seen[-1].lane.tolist()) == {lane.index for lane in state.map.lanes}
    assert not len(state.mapping.evidence.paths)  # their paths go there once they are complete


def test_vehicles_in_view_are_traced_back_by_a_first_map_before_anybody_has_left():
    state, outputs, _ = watch(queue(32, changer=3))

    assert not any(found.finished for found in outputs)
    first_us = START_US + maps(outputs)[0][0] * FRAME_US
    past = join((state.paths.past, *state.paths.recent))
    assert (past.lane[past.time_us < first_us] > 0).mean() > 0.95
    (_, change) = changes(outputs)[0]
    assert change.number == 3
    assert change.time_us < first_us


def test_a_queue_that_stands_is_not_learned_from_again_and_again():
    states = states_of(queue(75, 20))  # the last one stands after 37 s

    begun = {s.mapping.study.begun * FRAME_US / 1e6 for s in states if s.mapping.study is not None}
    assert len(begun) >= 2
    assert max(begun) < 50


@pytest.mark.parametrize("parameter", ["young_paths", "view_paths"])
def test_vehicles_in_view_tell_no_more_of_lanes_once_many_paths_are_known(parameter):
    few = {f"traffic.mapping.{parameter}": "8"}
    setup = traffic_setup(SensorConfig(sensor_id="radar-1", parameters=few))
    states = states_of(scene(100), setup)

    studies = {id(s.mapping.study): s.mapping.study for s in states if s.mapping.study is not None}
    grown = [study for study in studies.values() if len(study.evidence.paths) > 8]
    assert grown
    for study in grown:
        assert any(s.mapping.evidence is study.evidence for s in states)


def states_of(frames, setup=SETUP):
    states = [monitor.initial_state()]
    for k, now in enumerate(frames):
        moment = Moment(START_US + k * FRAME_US, k, tick=False)
        states.append(monitor.step(states[-1], moment, now, setup)[0])
    return states[1:]


def test_learning_is_spread_over_the_frames_before_the_map_comes(minute):
    frames, _, outputs, _ = minute
    first = maps(outputs)[0][0]
    study = states_of(frames[: first - 30])[-1].mapping.study

    steps = lanes_in_steps(study.evidence, study.before, study.gone, SETUP.parameters)
    progress = Progress(steps)
    progress.go_on(1)
    work = [progress.work]
    while not progress.ended:
        progress.go_on(work[-1] + 1)
        work.append(progress.work)

    assert len(work) > 10
    assert max(np.diff(work)) <= SETUP.parameters.mapping.work_a_frame
    assert work[-1] < 39 * SETUP.parameters.mapping.work_a_frame  # nothing is left when the map comes


def test_two_that_go_on_from_one_state_come_to_the_same_map(minute):
    frames, _, outputs, _ = minute
    first = maps(outputs)[0][0]
    half = states_of(frames[: first - 20])[-1]

    one, _, _ = watch(frames[first - 20 : first + 1], half, start=first - 20)
    other, _, _ = watch(frames[first - 20 : first + 1], half, start=first - 20)

    assert one.map.version == 1
    assert snapshot.dump(one) == snapshot.dump(other)


def test_other_parameters_end_what_is_being_learned_by_the_old_ones(minute):
    frames, _, outputs, _ = minute
    first = maps(outputs)[0][0]
    half = states_of(frames[: first - 20])[-1]
    other = traffic_setup(SensorConfig(sensor_id="radar-1", parameters={"traffic.learning.width_m": "3.3"}))

    later, told, _ = watch(frames[first - 20 :], half, other, start=first - 20)

    assert maps(told)[0][0] > 20  # learned anew
    assert len(later.map.lanes) == 2


def test_a_state_from_its_bytes_goes_on_to_the_same_bytes(minute):
    frames, _, outputs, seen = minute
    half = maps(outputs)[0][0] - 20  # a map is on its way
    state, _, _ = watch(frames[:half])
    again = snapshot.load(monitor.TrafficState, snapshot.dump(state))

    end, later, judged = watch(frames[half:], again, start=half)

    assert repr(later) == repr(outputs[half:])
    assert [j.lane.tobytes() + j.motion.tobytes() for j in judged] == [
        j.lane.tobytes() + j.motion.tobytes() for j in seen[half:]
    ]
    assert snapshot.dump(end) == snapshot.dump(watch(frames)[0])


def test_sensors_learn_at_different_times():
    frames = scene(60)
    firsts = set()
    for sensor_id in ("radar-1", "radar-2", "north"):
        _, outputs, _ = watch(frames, setup=traffic_setup(SensorConfig(sensor_id=sensor_id)))
        firsts.add(maps(outputs)[0][0])

    assert len(firsts) == 3


def test_a_recording_played_twice_keeps_its_lanes_and_their_numbers(minute):
    frames, once, _, _ = minute
    again = scene(60, first=101)

    twice, _outputs, _ = watch(again, once, start=len(frames))

    assert [lane.index for lane in twice.map.lanes] == [lane.index for lane in once.map.lanes]
    for one, other in zip(once.map.lanes, twice.map.lanes, strict=True):
        assert abs(one.points_m[:, 0].mean() - other.points_m[:, 0].mean()) < 0.15


def test_lanes_that_a_user_draws_are_in_force_at_once_and_are_not_learned_away(minute):
    frames, state, _, _ = minute
    given = GivenLane(index=9, points_m=((0.0, 140.0), (0.0, 20.0)), width_m=8.0)
    drawn = SensorConfig(sensor_id="radar-1", lanes=LaneControl(mode="replaced", lanes=(given,)))

    later, outputs, seen = watch(frames, state, traffic_setup(drawn), start=len(frames))

    ((at, lane_map),) = maps(outputs)
    assert (at, lane_map.source, lane_map.version) == (0, "user", state.map.version + 1)
    assert [lane.index for lane in later.map.lanes] == [9]
    assert set(np.concatenate([now.lane for now in seen[200:]]).tolist()) == {9}
    learned, outputs, _ = watch(frames, later, SETUP, start=2 * len(frames))
    assert len(learned.map.lanes) == 2
    assert learned.map.source == "learned"


def test_an_alarm_is_told_when_the_mast_has_moved_and_the_lanes_are_learned_anew(minute):
    frames, state, _, _ = minute
    moved = scene(150, shift_m=6.5, first=201, changer=-1)
    calm = traffic_setup(SensorConfig(parameters={"traffic.mapping.young_paths": "10"}))

    later, outputs, _ = watch(moved, state, calm, start=len(frames))

    told = [found.drift for found in outputs if found.drift is not None]
    assert [news.opened for news in told] == [True, False]
    assert told[0].share >= 0.4
    middles = sorted(float(lane.points_m[:, 0].mean()) for lane in later.map.lanes)
    assert middles == pytest.approx([6.5 - 1.8, 6.5 + 1.8], abs=0.4)


def test_a_new_epoch_begins_with_the_lanes_of_the_one_before(minute):
    frames, state, _, _ = minute

    later, outputs, _ = watch(frames[:3], monitor.begun_anew(state), start=len(frames))

    ((at, lane_map),) = maps(outputs)
    assert (at, lane_map.version) == (0, 1)
    assert [lane.index for lane in later.map.lanes] == [lane.index for lane in state.map.lanes]


def test_ticks_coast_and_end_what_is_left(minute):
    frames, state, _, _ = minute
    time_us = START_US + len(frames) * FRAME_US + 1_000_000

    _, judged, _ = monitor.step(state, Moment(time_us, len(frames), tick=True), frames[-1], SETUP)
    later, _, found = monitor.step(
        state, Moment(time_us + 1_000_000, len(frames), tick=True), estimates([], 0, 0, 0, 0), SETUP
    )

    assert set(judged.lane.tolist()) <= {1, 2}
    assert [path.number for path in found.finished] == frames[-1].number.tolist()
    assert len(later.vehicles.number) == 0


def test_parameters_are_set_by_their_dotted_names():
    config = SensorConfig(parameters={"traffic.assignment.hold_s": "1.5", "clustering.window_frames": "6"})

    assert traffic_setup(config).parameters.assignment.hold_s == 1.5
    assert config.tracker_parameters().clustering.window_frames == 6
    changed = dataclasses.replace(SETUP.parameters).digest()
    assert traffic_setup(config).parameters.digest() != changed


def test_while_the_map_is_young_every_new_map_judges_anew_what_was_seen(monkeypatch):
    traced = []
    judge = monitor.judged

    def watched(found, *rest):
        traced.append(len(found))
        return judge(found, *rest)

    monkeypatch.setattr(monitor, "judged", watched)
    _, outputs, _ = watch(scene(60, seed=6))

    assert len(traced) == len(maps(outputs))
    assert len(changes(outputs)) == 1  # ... and tells a change once


def test_the_map_of_a_whole_recording_has_the_lanes_that_few_drove_in():
    rng = np.random.default_rng(11)  # real drivers wander; five in a lane leave a live map in doubt
    paths = [
        drive(3 * k + lane, straight(), 3.6 * lane, rng, sigma_m=0.6) for k in range(5) for lane in range(3)
    ]
    gathered = dataclasses.replace(monitor.initial_state().mapping, evidence=evidence_of(paths))
    p = SETUP.parameters
    live = at_once(lanes_in_steps(gathered.evidence, (), (), p))

    state = dataclasses.replace(monitor.initial_state(), mapping=gathered)
    whole = closing.whole_map(state, SETUP)

    assert len(live) < 3
    assert [round(float(np.mean(lane.points_m[:, 0])) / 3.6) for lane in whole.lanes] in (
        [0, 1, 2],
        [2, 1, 0],
    )
