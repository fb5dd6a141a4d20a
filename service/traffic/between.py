"""Tell when a vehicle crossed a line unseen that now drives between two of its lane that were seen crossing.

Nobody overtakes within a lane. Of the vehicles that drive between the two now, all crossed between their
crossings, and where fewer were counted there than drive here, one that was hidden at the line is missing.
That holds however long ago it was, which its own speed does not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from service.traffic.known import SAME_LANE_M, Known
from service.traffic.lane_places import Way
from service.traffic.records import Crossing

Other = tuple[float, float | None]  # how far ahead of a vehicle the line is, and when it crossed it [us]


def crossed_between(
    row: int, line: int, way: Way, known: Known, inferred: Sequence[Crossing]
) -> float | None:
    """Return when the vehicle of a row crossed a line [us], by the order of its lane; None: nobody can say.

    way: how it stands to the line; inferred: crossings that nobody saw and that are not told yet.
    """
    there = known.crossed(line, way, inferred)
    when_us = {name: x.time_us for x in there for name in x.names}
    v = known.joined.vehicles
    if int(v.number[row]) in when_us or int(v.vehicle[row]) in when_us:
        return None
    others = _others(row, line, way, known, when_us)
    sure = [(ahead_m, time_us) for ahead_m, time_us in others if time_us is not None]
    first = max((x for x in sure if x[0] < way.ahead_m), default=None)
    last = min((x for x in sure if x[0] > way.ahead_m), default=None)
    if first is None or last is None or last[1] <= first[1]:
        return None
    here = 1 + sum(time_us is None and first[0] < ahead_m < last[0] for ahead_m, time_us in others)
    # whoever was seen beside it for a while is another, who was lost since
    seen_us = known.last_us
    beside_us = int(v.first_us[row]) + round(1e6 * known.view.parameters.least_life_s)
    counted = sum(
        first[1] < x.time_us < last[1] and all(seen_us.get(name, -1) < beside_us for name in x.names)
        for x in there
    )
    if here <= counted:
        return None
    share = (way.ahead_m - first[0]) / (last[0] - first[0])
    return first[1] + share * (last[1] - first[1])


def _others(row: int, line: int, mine: Way, known: Known, crossed_us: Mapping[int, int]) -> list[Other]:
    """Return how the other vehicles of a lane that are seen now stand to a line.

    One before the line crosses it later than now.
    """
    v, others = known.joined.vehicles, list[Other]()
    here = known.stands.beside(line, mine, SAME_LANE_M) & (known.joined.measured >= 0)
    here[row] = False
    for other in np.flatnonzero(here).tolist():
        names = (int(v.number[other]), int(v.vehicle[other]))
        when = next((crossed_us[name] for name in names if name in crossed_us), None)
        ahead_m = float(known.stands.ahead_m[other, line])
        others.append((ahead_m, float(known.view.time_us) if ahead_m >= 0.0 else when))
    return others
