"""One step of counting: the tracks of a frame turn into crossings of the count lines, and into Edie's sums.

The crossings of a line and minute are collected in a block, which is given out again each time it grows, so
that the newest counts can be read; a block stays open for another minute, for vehicles that crossed long
before they were far enough behind the line. The sums of a minute are given out every
ten seconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.tracking.model import TrackEstimates
from service.traffic.cells import NO_RULER, MinuteCells, Ruler, cell_records, drive, ruler_of
from service.traffic.count_parameters import CountParameters
from service.traffic.coverage import NOTHING_RECEIVED, Coverage, receive
from service.traffic.crossing_lanes import passing_s, relabelled, way_across
from service.traffic.crossings import LineStates, View, cross, no_line_states
from service.traffic.ended import Ended, given_up, resumed
from service.traffic.known import Known, Observed
from service.traffic.lane_places import lanes_at
from service.traffic.line_placing import place_lines
from service.traffic.lines import Line
from service.traffic.measured import Measured
from service.traffic.model import LaneMap, Moment
from service.traffic.parameters import TrafficSetup
from service.traffic.records import (
    CROSSING,
    MINUTE_US,
    CellSums,
    Counts,
    Crossing,
    Leader,
    MinuteBlock,
    Received,
    record_of,
)
from service.traffic.stitching import Vehicles, join, no_vehicles
from service.traffic.unseen import UnseenState, unseen
from service.traffic.window import Scan, remember, scan_of

OPEN_US = 2 * MINUTE_US  # after the start of its minute a block, and the sums of a minute, are closed
TELL_US = 10_000_000  # between two reports of the running minute
UNMAPPED_OPEN_US = 15 * MINUTE_US  # ... and while no lanes are known: they get theirs with the first map


@dataclass(frozen=True, slots=True)
class CountState:
    """What counting remembers of a sensor; a value, never changed in place."""

    lines: tuple[Line, ...]
    placed_on: tuple[int, ...]  # lanes that the lines were placed across; none where lines are drawn
    vehicles: Vehicles
    states: LineStates
    window: tuple[Scan, ...]
    leaders: tuple[Leader, ...]
    blocks: tuple[MinuteBlock, ...]  # that may still grow
    coverage: Coverage
    ruler: Ruler
    cells: tuple[MinuteCells, ...]
    crossings: int  # given out in this epoch
    ended: tuple[Ended, ...] = ()
    unseen: UnseenState = UnseenState()  # noqa: RUF009 - it cannot be changed
    until_us: int = 0  # of the last frame before the last stretch without any
    since_us: int = 0  # ... and of the first one after it

    @property
    def idle(self) -> bool:
        """True when the passing of time alone gives nothing more out."""
        return self.coverage.told and not self.states.pending and not self.unseen.waiting


def nothing_counted() -> CountState:
    """Return the state before the first frame."""
    return CountState(
        (), (), no_vehicles(), no_line_states(0, 0), (), (), (), NOTHING_RECEIVED, NO_RULER, (), 0
    )


def count(  # noqa: PLR0913, PLR0917 - the state, the frame, the map
    state: CountState,
    moment: Moment,
    estimates: TrackEstimates,
    measured: Measured,
    lanes: LaneMap,
    setup: TrafficSetup,
) -> tuple[CountState, Counts]:
    """Return the state after a frame or tick, and what has become certain."""
    p, now_us = setup.parameters.counting, moment.time_us
    state = _with_lines(state, setup.lines, lanes, p)
    scan = scan_of(now_us, moment.frame, estimates, measured)
    window = remember(state.window, scan, round(p.window_s * 1e6))
    joined = join(state.vehicles, scan, p)
    view = View(window, state.lines, p)
    states, found = cross(state.states, joined, view)
    ruler = state.ruler if state.ruler.version == lanes.version else ruler_of(lanes, p.cell_m)
    coverage = state.coverage
    if not moment.tick:
        if coverage.last_us is None or now_us - coverage.last_us > p.blind_s * 1e6:
            # who drove since the last frame was not seen
            state = replace(state, leaders=(), until_us=coverage.last_us or 0, since_us=now_us)
        coverage = receive(coverage, now_us, setup.config.rate_hz, p.blind_s)
    ended = given_up(state.ended, state.vehicles, joined, now_us)
    coming = resumed(joined, ended, state.since_us, now_us)
    cells = drive(state.cells, ruler, coming, scan.lane, now_us)
    mapped: tuple[MinuteBlock, ...] = state.blocks
    relabelled_blocks: tuple[MinuteBlock, ...] = ()
    if ruler is not state.ruler and lanes.lanes:
        mapped, relabelled_blocks, leaders = relabelled(state.blocks, state.leaders, state.lines, ruler, p)
        state = replace(state, leaders=leaders)
    known = Known(
        joined, states, view, ruler, mapped, found,
        Observed(state.until_us, state.since_us, coverage.last_us or 0), ended,
    )  # fmt: skip
    others, beyond = unseen(state.unseen, state.vehicles, state.states, known)
    if beyond:
        found = tuple(sorted((*found, *beyond), key=lambda x: (x.time_us, x.track)))
    found = _once(found, mapped)
    crossings, leaders = _followed(found, state, ruler, p)
    blocks, grown = _collected(mapped, crossings, now_us, UNMAPPED_OPEN_US if not lanes.version else OPEN_US)
    grown = _newest(relabelled_blocks, grown)
    state = CountState(
        lines=state.lines, placed_on=state.placed_on, vehicles=joined.vehicles, states=states, window=window,
        leaders=leaders, blocks=blocks, coverage=coverage, ruler=ruler, cells=cells,
        crossings=state.crossings + len(crossings), ended=ended, unseen=others,
        until_us=state.until_us, since_us=state.since_us,
    )  # fmt: skip
    state, received, sums = _told(state, moment)
    return state, Counts(crossings, grown, received, sums)


def report(state: CountState) -> Counts:
    """Return all that is known and not final, where an epoch ends."""
    return Counts(received=state.coverage.minutes, cells=_sums(state.cells))


def _with_lines(state: CountState, drawn: tuple[Line, ...], lanes: LaneMap, p: CountParameters) -> CountState:
    """Return the state with the lines drawn, or placed; to others, where vehicles stand must be seen anew.

    Placed lines stay where they are while the map has the same lanes, however its centre lines shift.
    """
    across = () if drawn else tuple(lane.index for lane in lanes.lanes)
    kept = state.lines == drawn if drawn or not across else state.placed_on == across
    if kept:
        return state
    lines = drawn or place_lines(lanes, p)
    states = no_line_states(len(state.vehicles), len(lines))
    return replace(state, lines=lines, placed_on=across, states=states, leaders=(), unseen=UnseenState())


def _once(found: Sequence[Crossing], told: Sequence[MinuteBlock]) -> tuple[Crossing, ...]:
    """Return the crossings without those of a vehicle that was told of at that line before.

    One that was lost for longer than pieces are stitched may be listed again under its number.
    """
    fresh: dict[tuple[str, int], Crossing] = {}
    for x in found:
        names = (x.vehicle, x.track)  # the chain may be forgotten, and named by another of its pieces
        tables = (block.table() for block in told if block.line_id == x.line_id)
        if not any(np.isin(t["vehicle"], names).any() or np.isin(t["track"], names).any() for t in tables):
            fresh.setdefault((x.line_id, x.vehicle), x)
    return tuple(fresh.values())


def _followed(
    found: Sequence[Crossing], state: CountState, ruler: Ruler, p: CountParameters
) -> tuple[tuple[Crossing, ...], tuple[Leader, ...]]:
    """Return the crossings with number, map, headway and gap, and whom the next ones follow."""
    if not found:
        return (), state.leaders
    leaders = {(x.line_id, x.lane, x.direction): x for x in state.leaders}
    lines = {line.line_id: line for line in state.lines}
    place = np.array([(crossing.x_m, crossing.y_m) for crossing in found])
    way = np.array([way_across(lines[crossing.line_id], crossing.direction) for crossing in found])
    lanes = lanes_at(place, way, np.array([crossing.lane for crossing in found], dtype=np.int64), ruler)
    crossings = []
    for k, (crossing, lane) in enumerate(zip(found, lanes.tolist(), strict=True), start=state.crossings + 1):
        passing = passing_s(crossing.length_m, crossing.speed_mps, p)
        front_us = crossing.time_us - round(passing / 2 * 1e6)
        key = (crossing.line_id, lane, crossing.direction)
        leader = leaders.get(key) if lane else None
        headway_s = gap_s = math.nan
        if leader is not None and front_us > leader.front_us:
            headway_s = (front_us - leader.front_us) / 1e6
            gap_s = headway_s - leader.passing_s
        if lane and front_us >= state.since_us and (leader is None or front_us > leader.front_us):
            leaders[key] = Leader(*key, front_us, passing)
        crossings.append(
            replace(
                crossing, number=k, lane=lane, map_version=ruler.version, headway_s=headway_s, gap_s=gap_s
            )
        )
    return tuple(crossings), tuple(leaders.values())


def _collected(
    blocks: tuple[MinuteBlock, ...], crossings: Sequence[Crossing], now_us: int, open_us: int
) -> tuple[tuple[MinuteBlock, ...], tuple[MinuteBlock, ...]]:
    """Return the blocks that stay open, and those that have grown."""
    if not crossings:
        return tuple(x for x in blocks if now_us - x.minute * MINUTE_US < open_us), ()
    opened = {(x.line_id, x.minute): x for x in blocks if now_us - x.minute * MINUTE_US < open_us}
    grown: dict[tuple[str, int], MinuteBlock] = {}
    for crossing in crossings:
        minute = crossing.time_us // MINUTE_US
        late = now_us - minute * MINUTE_US >= open_us
        key = (crossing.line_id, minute)
        block = grown.get(key) or opened.get(key)
        if block is None:
            part = now_us // 1000 if late else 0
            block = MinuteBlock(*key, part, np.zeros((0, CROSSING.itemsize), dtype=np.uint8))
        grown[key] = replace(block, records=np.concatenate([block.records, record_of(crossing)]))
        if not late:
            opened[key] = grown[key]
    return tuple(opened.values()), tuple(grown.values())


def _newest(first: tuple[MinuteBlock, ...], then: tuple[MinuteBlock, ...]) -> tuple[MinuteBlock, ...]:
    """Return each block of either as it is in the last of them."""
    if not first:
        return then
    return tuple({(x.line_id, x.minute, x.part): x for x in (*first, *then)}.values())


def _told(state: CountState, moment: Moment) -> tuple[CountState, tuple[Received, ...], tuple[CellSums, ...]]:
    """Return the state without minutes that are final, and every ten seconds what is known of the others."""
    coverage, now_us = state.coverage, moment.time_us
    before_us = state.window[-2].time_us if len(state.window) > 1 else 0
    due = moment.tick or now_us // TELL_US != before_us // TELL_US
    if coverage.told or not due:
        return state, (), ()
    received, sums = coverage.minutes, _sums(state.cells)
    final = (now_us - OPEN_US) // MINUTE_US
    kept = tuple(x for x in received if x.minute > final)
    cells = tuple(x for x in state.cells if x.minute > final)
    return replace(state, coverage=Coverage(kept, coverage.last_us, told=True), cells=cells), received, sums


def _sums(cells: Sequence[MinuteCells]) -> tuple[CellSums, ...]:
    return tuple(CellSums(x.minute, x.version, cell_records(x)) for x in cells)
