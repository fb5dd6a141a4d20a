"""What is known of the count lines after a scan: who drives where, and who was counted; to infer from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from service.traffic.cells import Ruler
from service.traffic.crossings import LineStates, View
from service.traffic.ended import Ended
from service.traffic.lane_places import Stands, Way, stands
from service.traffic.records import MINUTE_US, Crossing, MinuteBlock
from service.traffic.stitching import Joined

SAME_LANE_M = 1.75  # from where one vehicle crosses a line to another in its lane


class Crossed(NamedTuple):
    """That somebody went over a line."""

    time_us: int
    x_m: float
    y_m: float
    direction: int
    names: tuple[int, ...]  # numbers of tracks of the vehicle


@dataclass(frozen=True, slots=True)
class Observed:
    """Time in which frames came: until `until_us`, and again from `since_us` to `now_us`."""

    until_us: int
    since_us: int
    now_us: int

    def holds(self, time_us: int) -> bool:
        """Return whether a moment of the last seconds was observed."""
        return time_us <= self.until_us or self.since_us <= time_us <= self.now_us


@dataclass(frozen=True)  # without slots: a cached property wants a place
class Known:
    """The vehicles after a scan and how they stand to the lines, and the crossings of the last minutes."""

    joined: Joined
    states: LineStates
    view: View
    ruler: Ruler
    told: Sequence[MinuteBlock]
    found: Sequence[Crossing]  # that were seen and became certain in this scan
    observed: Observed
    ended: Sequence[Ended]  # of the last minute

    @cached_property
    def last_us(self) -> Mapping[int, int]:
        """When each vehicle of the last minute was seen last, by its names."""
        v = self.joined.vehicles
        times = {name: x.last_us for x in self.ended for name in (x.number, x.vehicle)}
        for names in (v.vehicle, v.number):
            times.update(zip(names.tolist(), v.last_us.tolist(), strict=True))
        return times

    @cached_property
    def stands(self) -> Stands:
        """How each vehicle stands to each line along its lane."""
        return stands(self.joined.vehicles.real, self.view.lines, self.ruler)

    def crossed(self, line: int, way: Way, inferred: Sequence[Crossing]) -> list[Crossed]:
        """Return who went over a line in the lane of a way: told, certain or probable.

        inferred: crossings that nobody saw and that are not told yet.
        """
        line_id = self.view.lines[line].line_id
        sure = (x for x in (*self.found, *inferred) if x.line_id == line_id)
        found = [Crossed(x.time_us, x.x_m, x.y_m, x.direction, (x.track, x.vehicle)) for x in sure]
        found += [
            Crossed(x.time_us, x.x_m, x.y_m, x.direction, (x.number, x.vehicle))
            for x in self.states.pending if x.line == line
        ]  # fmt: skip
        return [
            x for x in (*found, *_told(line_id, self.told))
            if x.direction == way.direction and math.hypot(x.x_m - way.x_m, x.y_m - way.y_m) < SAME_LANE_M
        ]  # fmt: skip


def _told(line_id: str, told: Sequence[MinuteBlock]) -> Iterator[Crossed]:
    """Yield the told crossings of a line."""
    for block in told:
        if block.line_id == line_id:
            table = block.table()
            times_us = block.minute * MINUTE_US + table["time_us"].astype(np.int64)
            columns = [table[name].tolist() for name in ("x_m", "y_m", "direction", "track", "vehicle")]
            for time_us, x_m, y_m, direction, *names in zip(times_us.tolist(), *columns, strict=True):
                yield Crossed(time_us, x_m, y_m, direction, tuple(names))
