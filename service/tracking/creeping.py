"""Remember how far each track has been seen to creep: posts never do, vehicles that stop or set off always.

A vehicle that brakes in view shows every speed on its way down to none. A box that is left on a post goes
from the speed of its vehicle to nothing at once. So the way that the range rates of its points tell while it
goes slowly says, of a track that stands and gives few points, that it is a vehicle, also where nobody is
known to drive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.boxes import M_COUNT, M_V
from service.tracking.kernel import kernel
from service.tracking.model import F64, Bool
from service.tracking.state import Tracks


@dataclass(frozen=True, slots=True)
class CreepingParameters:
    """What counts as creeping, and how much of it shows that something is a vehicle."""

    from_mps: float = 0.6  # range rates below may be a standing one's
    fast_mps: float = 4.0  # whoever goes faster has to be seen to stop again
    proof_m: float = 1.5  # to or from the radar; what sways comes back
    fade_s: float = 4.0  # in which the way fades until it is proof: swaying sums up to anything in the end
    frame_s: float = 0.1  # one frame tells of no longer time


def watch(
    tracks: Tracks, measured: F64, hit: Bool, expected_mps: F64, dt_s: float, p: CreepingParameters
) -> Tracks:
    """Return the tracks after an update with the way that each has crept, away from the radar.

    measured (T, MEASUREMENT_COLUMNS) of each track's own points, hit (T,), expected_mps (T,) the range rates
    beyond which M_V is told.
    """
    if not len(tracks):
        return tracks
    crept = tracks.crept_m.copy()
    limits = (p.from_mps, p.fast_mps, p.proof_m, math.exp(-dt_s / p.fade_s))
    _creep(crept, measured, hit, expected_mps, min(dt_s, p.frame_s), limits)
    return tracks.but(crept_m=crept)


def seen(tracks: Tracks, p: CreepingParameters) -> Bool:
    """Return which tracks (T,) have crept far enough to be vehicles."""
    return np.asarray(np.abs(tracks.crept_m) >= p.proof_m)


@kernel
def _creep(
    crept: F64,
    measured: F64,
    hit: Bool,
    expected: F64,
    dt_s: float,
    limits: tuple[float, float, float, float],
) -> None:
    from_mps, fast_mps, proof, fade = limits
    for i in range(len(crept)):
        if abs(crept[i]) < proof:
            crept[i] *= fade
        if not hit[i] or measured[i, M_COUNT] <= 0.0 or math.isnan(measured[i, M_V]):
            continue
        rate = expected[i] + measured[i, M_V]
        if abs(rate) > fast_mps:
            crept[i] = 0.0
        elif abs(rate) > from_mps:
            crept[i] += rate * dt_s
