"""What is remembered of each vehicle from frame to frame, for its lane and its motion state: two tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.kernel import kernel
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


_NOBODY = no_vehicles()


def parted(vehicles: Vehicles, number: I64) -> tuple[Vehicles, Vehicles]:
    """Return the tracks now listed, in tables of their own that may be written to, and those now gone."""
    if np.array_equal(vehicles.number, number):
        return Vehicles(number, vehicles.whole.copy(), vehicles.real.copy()), _NOBODY
    whole, real, gone = _parted(vehicles.number, vehicles.whole, vehicles.real, number)
    if not len(gone):
        return Vehicles(number, whole, real), _NOBODY
    left = Vehicles(vehicles.number[gone], vehicles.whole[gone], vehicles.real[gone])
    return Vehicles(number, whole, real), left


def aligned(vehicles: Vehicles, number: I64) -> Vehicles:
    """Return the tracks now listed, in tables of their own that may be written to."""
    return parted(vehicles, number)[0]


@kernel
def _parted(before: I64, whole: I64, real: F64, number: I64) -> tuple[I64, F64, I64]:
    """Return the tables of the tracks that are listed now, and the rows of those before that are not."""
    now_whole = np.zeros((len(number), whole.shape[1]), np.int64)
    now_real = np.zeros((len(number), real.shape[1]))
    gone, count, k = np.empty(len(before), np.int64), 0, 0
    for i in range(len(before)):
        while k < len(number) and number[k] < before[i]:
            k += 1
        if k == len(number) or number[k] != before[i]:
            gone[count] = i
            count += 1
            continue
        for column in range(whole.shape[1]):
            now_whole[k, column] = whole[i, column]
        for column in range(real.shape[1]):
            now_real[k, column] = real[i, column]
    return now_whole, now_real, gone[:count]


def find(numbers: I64, wanted: I64) -> I64:
    """Return where each wanted number stands in the ascending `numbers`, -1 where it does not."""
    if not len(numbers):
        return np.full(len(wanted), -1)
    where = numbers.searchsorted(wanted)
    where[where == len(numbers)] = 0
    where[numbers[where] != wanted] = -1
    return where
