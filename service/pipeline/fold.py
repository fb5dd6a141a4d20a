"""Fold a sensor's log into tracks and rows, one record at a time; the same function live and offline.

No clock, no randomness, no I/O: time comes from the records. Where two frames are more than a second
apart, the fold puts a tick at each whole second in between, just as the host does while the sensor is
silent, so that a live log with ticks and a file without them give one history.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from service.errors import InvalidInput
from service.formats.sensor import SensorConfig
from service.pipeline.blocks import Moment, collect_frame, collect_tick, end_all, nothing_collected
from service.pipeline.fold_state import Folded, FoldOutput, FoldState, S, Tracker
from service.pipeline.order import Admission, Fate, OrderState, Released, admit, flush, pass_time
from service.pipeline.records import ControlRecord, DamagedRecord, FrameRecord, Record, TickRecord
from service.pipeline.traffic_rows import traffic_rows
from service.storage.rows import EventRow, Rows, merge_rows
from service.tracking.model import TrackEstimates
from service.traffic import closing, monitor
from service.traffic.model import LaneMap
from service.traffic.model import Moment as TrafficMoment
from service.traffic.parameters import traffic_setup

TICK_US = 1_000_000
RECORD_DAMAGED = "record_damaged"
CONFIGURATION_REFUSED = "configuration_refused"
CLOCK_SET_BACK = "the sensor's clock was set back"


@dataclass(slots=True)
class _Output:
    """What has been given out so far while one record is folded."""

    folded: list[Folded] = field(default_factory=list)
    rows: list[Rows] = field(default_factory=list)


def start(
    sensor_id: str, epoch: int, config: SensorConfig, tracker: Tracker[S], *, first_position: int = 1
) -> FoldState[S]:
    """Return the empty state of an epoch whose first record is at `first_position`.

    Raises InvalidInput when a parameter of the configuration is wrong.
    """
    parameters = config.tracker_parameters()
    return FoldState(
        sensor_id=sensor_id,
        epoch=epoch,
        epoch_first_position=first_position,
        position=first_position - 1,
        config=config.canonical_json(),
        parameters=parameters,
        setup=traffic_setup(config),
        tracker=tracker.initial_state(parameters),
        traffic=monitor.initial_state(),
        order=OrderState(),
        collected=nothing_collected(),
    )


def step(
    state: FoldState[S], position: int, record: Record, tracker: Tracker[S]
) -> tuple[FoldState[S], FoldOutput]:
    """Return the state after the record at `position`, and what the record led to."""
    out = _Output()
    restarted = None
    match record:
        case FrameRecord():
            order, admission = admit(state.order, record.frame)
            if admission.clock_step:
                restarted = CLOCK_SET_BACK
                state = _begin_anew(replace(state, position=position), out, tracker)
        case ControlRecord() | TickRecord():
            order, admission = flush(state.order)
        case DamagedRecord():
            order, admission = state.order, Admission(Fate.DAMAGED)
            if record.fatal:
                order, _ = flush(state.order)
                admission = Admission(Fate.DAMAGED, dropped=len(state.order.held))
    state = replace(state, position=position, order=order)
    for released in admission.released:
        state = _fold_frame(state, released, out, tracker)
    match record:
        case ControlRecord():
            state = _configure(state, record, out)
            admission = replace(admission, fate=Fate.CONTROL)
        case TickRecord():
            state = _fold_ticks(state, record.time_us + 1, out, tracker)
            admission = replace(admission, fate=Fate.TICK)
        case DamagedRecord():
            state = _tell_of_damage(state, record, out)
    return state, _result(admission, out, restarted)


def _result(admission: Admission, out: _Output, restarted: str | None) -> FoldOutput:
    return FoldOutput(
        fate=admission.fate,
        folded=tuple(out.folded),
        # Of a track that is summed up twice in one step only the later summary: both have one `as_of`.
        rows=merge_rows(out.rows),
        missing=admission.missing,
        dropped=admission.dropped,
        restarted=restarted,
    )


def _fold_frame(state: FoldState[S], released: Released, out: _Output, tracker: Tracker[S]) -> FoldState[S]:
    frame = released.frame
    state = _fold_ticks(state, frame.time_us, out, tracker)
    tracked, estimates, report = tracker.step(state.tracker, frame, state.parameters)
    state, estimates = _watch(state, frame.time_us, released.number, estimates, out)
    moment = _moment(state, frame.time_us)
    collected, rows = collect_frame(
        state.collected, moment, released.number, estimates, tracked.resting_numbers
    )
    out.rows.append(rows)
    out.folded.append(
        Folded(
            state.position,
            state.epoch,
            released.number,
            released.boot,
            frame.time_us,
            estimates,
            report,
            frame,
        )
    )
    return replace(
        state,
        tracker=tracked,
        collected=collected,
        frame_us=frame.time_us,
        frame_number=released.number,
        boot=released.boot,
        ticks=0,
    )


def _fold_ticks(state: FoldState[S], before_us: int, out: _Output, tracker: Tracker[S]) -> FoldState[S]:
    """Fold the ticks that stand between the newest frame and a time, as long as they change something."""
    while state.frame_us is not None and not (state.quiet or state.tired):
        time_us = state.frame_us + (state.ticks + 1) * TICK_US
        if time_us >= before_us:
            break
        tracked, estimates, report = tracker.coast(state.tracker, time_us, state.parameters)
        state, estimates = _watch(state, time_us, None, estimates, out)
        collected, rows = collect_tick(
            state.collected, _moment(state, time_us), estimates, tracked.resting_numbers
        )
        out.rows.append(rows)
        out.folded.append(
            Folded(
                state.position, state.epoch, state.frame_number, state.boot, time_us, estimates, report, None
            )
        )
        state = replace(state, tracker=tracked, collected=collected, ticks=state.ticks + 1)
        if state.order.time_us is None or time_us > state.order.time_us:
            state = replace(state, order=pass_time(state.order, time_us))
    return state


def _watch(
    state: FoldState[S], time_us: int, frame_number: int | None, estimates: TrackEstimates, out: _Output
) -> tuple[FoldState[S], TrackEstimates]:
    """Analyse the traffic after a frame, or after a tick (no number); return the tracks with their lanes."""
    tick = frame_number is None
    moment = TrafficMoment(time_us, state.frame_number if frame_number is None else frame_number, tick)
    traffic, estimates, found = monitor.step(state.traffic, moment, estimates, state.setup)
    rows, events = traffic_rows(found, _moment(state, time_us), state.events)
    out.rows.append(rows)
    return replace(state, traffic=traffic, events=events), estimates


def _tell_of_damage(state: FoldState[S], record: DamagedRecord, out: _Output) -> FoldState[S]:
    """Give out an event for a record of the log that cannot be read, so that it is no silent hole."""
    event = EventRow(
        sensor_id=state.sensor_id,
        epoch=state.epoch,
        number=state.events + 1,
        as_of=state.position,
        kind=RECORD_DAMAGED,
        time_us=state.frame_us or 0,
        detail={"position": state.position, "reason": record.reason},
    )
    out.rows.append(Rows(events=(event,)))
    return replace(state, events=state.events + 1)


def _configure(state: FoldState[S], record: ControlRecord, out: _Output) -> FoldState[S]:
    """Take over a new configuration; a wrong one is refused by an event, and the old one stays."""
    try:
        config = SensorConfig.model_validate_json(record.config)
        parameters, setup = config.tracker_parameters(), traffic_setup(config)
    except (InvalidInput, ValueError) as error:
        event = EventRow(
            sensor_id=state.sensor_id,
            epoch=state.epoch,
            number=state.events + 1,
            as_of=state.position,
            kind=CONFIGURATION_REFUSED,
            time_us=record.received_us,
            detail={"reason": str(error)},
        )
        out.rows.append(Rows(events=(event,)))
        return replace(state, events=state.events + 1)
    return replace(state, config=config.canonical_json(), parameters=parameters, setup=setup)


def _begin_anew(state: FoldState[S], out: _Output, tracker: Tracker[S]) -> FoldState[S]:
    """End every track and open the next epoch with an empty state, at the record that is being folded."""
    last_us = state.order.time_us if state.order.time_us is not None else 0
    moment = _moment(state, last_us)
    rows, _ = traffic_rows(monitor.last_words(state.traffic), moment, state.events)
    out.rows += [end_all(state.collected, moment), rows]
    return replace(
        state,
        epoch=state.epoch + 1,
        epoch_first_position=state.position,
        tracker=tracker.initial_state(state.parameters),
        traffic=monitor.begun_anew(state.traffic),
        collected=nothing_collected(),
        frame_us=None,
        ticks=0,
        events=0,
    )


def _moment(state: FoldState[S], time_us: int) -> Moment:
    bounds_m = state.setup.config.length_bounds_m
    return Moment(state.sensor_id, state.epoch, state.position, time_us, bounds_m)


def at_an_end(state: FoldState[S]) -> tuple[LaneMap, Rows]:
    """Return the lanes that a whole recording tells of, and the rows that are others by them."""
    time_us = state.order.newest_us or 0
    lanes = closing.whole_map(state.traffic, state.setup)
    found = closing.told_by(lanes, state.traffic, time_us, state.setup)
    return lanes, traffic_rows(found, _moment(state, time_us), state.events)[0]
