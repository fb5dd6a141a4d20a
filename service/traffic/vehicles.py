"""What is remembered of each vehicle from frame to frame, for its lane and its motion state: two tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, I64

# columns of `whole`
LANE, CANDIDATE, PAST_US, CROSSED_US, SEEN_US, MOTION, ZONE, IN_A_ROW, STOPPED_US, ENTERED_US = range(10)
WHOLE_COLUMNS = 10
# columns of `real`
LAST_X, LAST_Y, CROSSED_X, CROSSED_Y, AHEAD_X, AHEAD_Y = range(6)
REAL_COLUMNS = 6
# of the motion state, in both tables
MOTION_COLUMNS = [MOTION, ZONE, IN_A_ROW, STOPPED_US]
AHEAD_COLUMNS = [AHEAD_X, AHEAD_Y]


@dataclass(frozen=True, slots=True)
class Vehicles:
    """T tracks by number."""

    number: I64  # (T,)
    whole: I64  # (T, WHOLE_COLUMNS)
    real: F64  # (T, REAL_COLUMNS)


def no_vehicles(number: I64 | None = None) -> Vehicles:
    """Return tracks of which nothing is known yet."""
    known = np.zeros(0, dtype=np.int64) if number is None else number
    whole = np.zeros((len(known), WHOLE_COLUMNS), dtype=np.int64)
    return Vehicles(known, whole, np.zeros((len(known), REAL_COLUMNS)))


def aligned(vehicles: Vehicles, number: I64) -> Vehicles:
    """Return the tracks now listed, in tables of their own that may be written to."""
    if np.array_equal(vehicles.number, number):
        return Vehicles(number, vehicles.whole.copy(), vehicles.real.copy())
    found = no_vehicles(number)
    before = find(vehicles.number, number)
    here = np.flatnonzero(before >= 0)
    before = before[here]
    found.whole[here], found.real[here] = vehicles.whole[before], vehicles.real[before]
    return found


def find(numbers: I64, wanted: I64) -> I64:
    """Return where each wanted number stands in the ascending `numbers`, -1 where it does not."""
    if not len(numbers):
        return np.full(len(wanted), -1)
    where = numbers.searchsorted(wanted)
    where[where == len(numbers)] = 0
    where[numbers[where] != wanted] = -1
    return where


def lost(vehicles: Vehicles, number: I64) -> Vehicles:
    """Return the tracks that are not among those now listed."""
    if np.array_equal(vehicles.number, number):
        return no_vehicles()
    gone = find(number, vehicles.number) < 0
    return Vehicles(vehicles.number[gone], vehicles.whole[gone], vehicles.real[gone])
