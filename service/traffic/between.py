"""Tell when a vehicle crossed a line unseen that now drives between two of its lane that were seen crossing.

Nobody overtakes within a lane. Of the vehicles that drive between the two now, all crossed between their
crossings, and where fewer were counted there than drive here, one that was hidden at the line is missing.
That holds however long ago it was, which its own speed does not.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from service.traffic.cells import Ruler
from service.traffic.crossings import View
from service.traffic.line_ways import Way, ways
from service.traffic.records import MINUTE_US, MinuteBlock
from service.traffic.stitching import Joined

SAME_LANE_M = 1.75  # from where one vehicle crosses a line to another in its lane


class Crossed(NamedTuple):
    """That somebody went over a line."""

    time_us: int
    x_m: float
    y_m: float
    direction: int
    names: tuple[int, ...]  # numbers of tracks of the vehicle


Stand = tuple[float, float | None]  # how far ahead of a vehicle the line is, and when it crossed it [us]


def crossed_between(  # noqa: PLR0913, PLR0917 - who, what stands around it, and what was told
    row: int,
    line: int,
    way: Way,
    joined: Joined,
    view: View,
    ruler: Ruler,
    told: Sequence[MinuteBlock],
    also: Iterable[Crossed],
) -> float | None:
    """Return when the vehicle of a row crossed a line [us], by the order of its lane; None: nobody can say.

    way: how it stands to the line; also: crossings of the line that are not told yet.
    """
    there = [
        x for x in (*also, *_told(view.lines[line].line_id, told))
        if x.direction == way.direction and math.hypot(x.x_m - way.x_m, x.y_m - way.y_m) < SAME_LANE_M
    ]  # fmt: skip
    when_us = {name: x.time_us for x in there for name in x.names}
    v = joined.vehicles
    if int(v.number[row]) in when_us or int(v.vehicle[row]) in when_us:
        return None
    stands = _stands(row, line, way, joined, view, ruler, when_us)
    known = [(ahead_m, time_us) for ahead_m, time_us in stands if time_us is not None]
    first = max((x for x in known if x[0] < way.ahead_m), default=None)
    last = min((x for x in known if x[0] > way.ahead_m), default=None)
    if first is None or last is None or last[1] <= first[1]:
        return None
    here = 1 + sum(time_us is None and first[0] < ahead_m < last[0] for ahead_m, time_us in stands)
    counted = sum(first[1] < x.time_us < last[1] for x in there)
    if here <= counted:
        return None
    share = (way.ahead_m - first[0]) / (last[0] - first[0])
    return first[1] + share * (last[1] - first[1])


def _stands(  # noqa: PLR0913, PLR0917 - as for `crossed_between`
    row: int, line: int, mine: Way, joined: Joined, view: View, ruler: Ruler, crossed_us: Mapping[int, int]
) -> list[Stand]:
    """Return how the other vehicles of a lane that are seen now stand to a line.

    One before the line crosses it later than now.
    """
    v, stands = joined.vehicles, list[Stand]()
    for other in np.flatnonzero(joined.measured >= 0).tolist():
        if other == row:
            continue
        for k, way in ways(v.real[:, other], view.lines, ruler):
            beside_m = math.hypot(way.x_m - mine.x_m, way.y_m - mine.y_m)
            if k == line and way.direction == mine.direction and beside_m < SAME_LANE_M:
                names = (int(v.number[other]), int(v.vehicle[other]))
                when = next((crossed_us[name] for name in names if name in crossed_us), None)
                stands.append((way.ahead_m, float(view.time_us) if way.ahead_m >= 0.0 else when))
    return stands


def _told(line_id: str, told: Sequence[MinuteBlock]) -> Iterator[Crossed]:
    """Yield the told crossings of a line."""
    for block in told:
        if block.line_id == line_id:
            table = block.table()
            times_us = block.minute * MINUTE_US + table["time_us"].astype(np.int64)
            columns = [table[name].tolist() for name in ("x_m", "y_m", "direction", "track", "vehicle")]
            for time_us, x_m, y_m, direction, *names in zip(times_us.tolist(), *columns, strict=True):
                yield Crossed(time_us, x_m, y_m, direction, tuple(names))
