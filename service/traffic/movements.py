"""Turn crossings into turning movements: who came in over one gate and went out over another.

Every count line is a gate. A vehicle's entry is the first line that it crossed, its exit the last; one that
crossed a single line has no exit. It counts in the interval in which it entered.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass

import numpy as np

from service.formats.length_class import LENGTH_CLASSES
from service.tracking.model import I64
from service.traffic.flow import CrossingTable

LONGEST_US = 300_000_000  # from entry to exit: a signal's cycle and more


@dataclass(frozen=True, slots=True)
class Movement:
    """How many vehicles of a class made one movement in one interval."""

    start_us: int
    end_us: int
    entry: str
    exit: str | None  # None: nothing was seen of the vehicle at another gate
    length_class: str | None  # None: not known
    volume: int
    expected: float  # sum of the probabilities that the vehicles are real


def movements(crossings: CrossingTable, edges_us: I64) -> list[Movement]:
    """Return the movements of each interval between two edges, by time, entry, exit and class.

    crossings: also those up to LONGEST_US around the intervals, so that no vehicle is cut in two.
    """
    if not len(crossings):
        return []
    order = np.lexsort((crossings.time_us, crossings.vehicle, crossings.epoch))
    c = crossings.take(order)
    same = (c.vehicle[1:] == c.vehicle[:-1]) & (c.epoch[1:] == c.epoch[:-1])
    same &= np.diff(c.time_us) <= LONGEST_US
    first = np.flatnonzero(np.append(True, ~same))
    last = np.append(first[1:], len(c)) - 1
    place = np.searchsorted(edges_us, c.time_us[first], side="right") - 1
    kinds = c.length_class
    volume: Counter[tuple[int, str, str, int]] = Counter()
    expected: defaultdict[tuple[int, str, str, int], float] = defaultdict(float)
    for a, b, k in zip(first.tolist(), last.tolist(), place.tolist(), strict=True):
        if 0 <= k < len(edges_us) - 1:
            key = (k, str(c.line_id[a]), str(c.line_id[b]) if b > a else "", int(kinds[b]))
            volume[key] += 1
            expected[key] += float(min(c.probability[a], c.probability[b]))
    return [
        Movement(
            start_us=int(edges_us[k]),
            end_us=int(edges_us[k + 1]),
            entry=entry,
            exit=leave or None,
            length_class=LENGTH_CLASSES[kind] if kind >= 0 else None,
            volume=volume[k, entry, leave, kind],
            expected=round(expected[k, entry, leave, kind], 3),
        )
        for k, entry, leave, kind in sorted(volume)
    ]
