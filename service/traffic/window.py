"""The last seconds of all tracks: what a fit or a comparison of two tracks looks back at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, I64, U8, TrackEstimates, TrackStatus


@dataclass(frozen=True, slots=True)
class Scan:
    """The confirmed tracks that were measured in one frame, (T,) each, by number."""

    time_us: int
    frame: int  # its number
    number: I64
    x_m: F64
    y_m: F64
    vx_mps: F64
    vy_mps: F64
    length_m: F64  # NaN: not known yet
    existence: F64
    lane: U8  # index of the lane, 0: none
    born_us: I64  # when its first point was seen, long before it was certain enough to be listed


@dataclass(frozen=True, slots=True)
class Samples:
    """The N samples of some tracks by time, (N,) each; time in seconds after a given moment."""

    time_s: F64
    x_m: F64
    y_m: F64
    vx_mps: F64
    vy_mps: F64
    length_m: F64
    existence: F64
    lane: U8
    frame: I64


_COLUMNS = ("x_m", "y_m", "vx_mps", "vy_mps", "length_m", "existence")


def scan_of(time_us: int, frame: int, estimates: TrackEstimates) -> Scan:
    """Return the tracks that had a measurement in this frame; where others coast to is only a guess."""
    measured = estimates.status == TrackStatus.CONFIRMED
    columns = {name: getattr(estimates, name)[measured].astype(np.float64) for name in _COLUMNS}
    lane, born_us = estimates.lane[measured], estimates.born_us[measured]
    return Scan(time_us, frame, estimates.number[measured], **columns, lane=lane, born_us=born_us)


def remember(window: tuple[Scan, ...], scan: Scan, window_us: int) -> tuple[Scan, ...]:
    """Return the window with one more scan and without those that are too old."""
    oldest = scan.time_us - window_us
    first = 0
    while first < len(window) and window[first].time_us < oldest:
        first += 1
    return (*window[first:], scan)


def samples_of(window: tuple[Scan, ...], numbers: tuple[int, ...], since_us: int) -> Samples:
    """Return all samples in the window of the pieces of one vehicle; times are relative to `since_us`."""
    found = []
    for scan in window:
        for number in numbers:
            i = int(np.searchsorted(scan.number, number))
            if i < len(scan.number) and scan.number[i] == number:
                row = [getattr(scan, name)[i] for name in _COLUMNS]
                found.append(((scan.time_us - since_us) / 1e6, *row, scan.lane[i], scan.frame))
    table = np.array(found, dtype=np.float64).reshape(-1, 3 + len(_COLUMNS)).T
    lane, frame = table[-2].astype(np.uint8), table[-1].astype(np.int64)
    return Samples(table[0], **dict(zip(_COLUMNS, table[1:-2], strict=True)), lane=lane, frame=frame)
