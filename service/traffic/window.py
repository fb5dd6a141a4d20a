"""The last seconds of all tracks: what a fit or a comparison of two tracks looks back at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, I64, U8, TrackEstimates
from service.traffic.measured import EXISTENCE, Measured


@dataclass(frozen=True, slots=True)
class Scan:
    """The confirmed tracks that were measured in one frame, (T,) each, by number."""

    time_us: int
    frame: int  # its number
    number: I64
    real: F64  # (6, T): as in Measured, up to existence; the length is NaN while it is not known
    lane: U8  # index of the lane, 0: none
    born_us: I64  # when its first point was seen, long before it was certain enough to be listed


@dataclass(frozen=True, slots=True)
class Past:
    """All samples of a window as one table, N of them by time, then number."""

    scan: I64  # (N,) place of the sample's scan in the window
    number: I64  # (N,)
    real: F64  # (6, N) as in Scan
    lane: U8  # (N,)
    time_us: I64  # (S,) of the scans
    frame: I64  # (S,)


@dataclass(frozen=True, slots=True)
class Samples:
    """The N samples of some tracks by time, (N,) each; time in seconds after a given moment."""

    time_s: F64
    real: F64  # (6, N) as in Scan
    lane: U8
    frame: I64


def scan_of(time_us: int, frame: int, estimates: TrackEstimates, measured: Measured) -> Scan:
    """Return the tracks that had a measurement in this frame."""
    e, row, real = estimates, measured.row, measured.real[: EXISTENCE + 1]
    if measured.everybody:
        return Scan(time_us, frame, e.number, real, e.lane, e.born_us)
    return Scan(time_us, frame, e.number[row], real, e.lane[row], e.born_us[row])


def remember(window: tuple[Scan, ...], scan: Scan, window_us: int) -> tuple[Scan, ...]:
    """Return the window with one more scan and without those that are too old."""
    oldest = scan.time_us - window_us
    first = 0
    while first < len(window) and window[first].time_us < oldest:
        first += 1
    return (*window[first:], scan)


def past_of(window: tuple[Scan, ...]) -> Past:
    """Return the scans of a window as one table."""
    counts = np.array([len(scan.number) for scan in window], dtype=np.int64)
    return Past(
        scan=np.repeat(np.arange(len(window)), counts),
        number=np.concatenate([scan.number for scan in window]),
        real=np.concatenate([scan.real for scan in window], axis=1),
        lane=np.concatenate([scan.lane for scan in window]),
        time_us=np.array([scan.time_us for scan in window], dtype=np.int64),
        frame=np.array([scan.frame for scan in window], dtype=np.int64),
    )


def samples_of(past: Past, numbers: tuple[int, ...], since_us: int) -> Samples:
    """Return all samples of the pieces of one vehicle; times are relative to `since_us`."""
    mine = past.number == numbers[0]
    for number in numbers[1:]:
        mine |= past.number == number
    which = np.flatnonzero(mine)
    scan = past.scan[which]
    time_s = (past.time_us[scan] - since_us) / 1e6
    return Samples(time_s, past.real.take(which, axis=1), past.lane[which], past.frame[scan])
