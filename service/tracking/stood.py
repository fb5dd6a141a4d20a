"""Keep vehicles that drive from taking what stood there before they came.

A box that has lost its vehicle coasts on, and its gate opens, for speeds as well, so that a vehicle that
brakes unseen is met again. Bushes, signs and what stands in a queue lie in its way. What has given echoes
from one place for a second, or from where clutter is known to stand, is of nobody who drives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.tracking.boxes import BSPEED, PG, PVAR_AZ, PX, PY
from service.tracking.kernel import kernel
from service.tracking.model import F64, I64, Bool
from service.tracking.state import Window


@dataclass(frozen=True, slots=True)
class StoodParameters:
    """What has stood for long, and whose it is not."""

    speed_mps: float = 1.5  # a box as fast has come from elsewhere within the second
    share: float = 0.5  # of the last second's frames in which the place gave an echo that nobody claimed ...
    frames: int = 10  # ... if there are so many: after a gap there are not
    along_m: float = 0.6  # how far apart echoes of one place are in range ...
    across_m: float = 0.4  # ... and across it, with ...
    across_std: float = 2.0  # ... so many deviations of the azimuth


class Standing(NamedTuple):
    """What stands now, and what stood in the last second."""

    standing: Bool  # (N,) points of this frame
    known: Bool  # (N,) lie where some clutter is known to stand: enough that nothing is born there
    window: Window  # standing points of the frames before
    frames: int  # of those


def forbid(cost: F64, boxes: F64, points: F64, stood: Standing, gate: float, p: StoodParameters) -> None:
    """Make the costs (T, N) of points that stood there before infinite, in place, for boxes that drive.

    boxes (T, BOX_COLUMNS), points (N, POINT_COLUMNS); beyond `gate` a cost is no claim.
    """
    seen = stood.window
    _forbid(
        cost, boxes, points, stood.standing, stood.known, seen.points, seen.time_us, seen.owned,
        p.share * stood.frames if stood.frames >= p.frames else math.inf,
        (gate, p.speed_mps, p.along_m, p.across_m, p.across_std),
    )  # fmt: skip


@kernel
def _forbid(
    cost: F64, boxes: F64, points: F64, standing: Bool, known: Bool, before: F64, time_us: I64, owned: Bool,
    wanted: float, q: tuple[float, float, float, float, float],
) -> None:  # fmt: skip
    gate, speed, along, across, deviations = q
    for j in range(len(points)):
        if not standing[j]:
            continue
        asked = False
        for i in range(len(boxes)):
            asked |= boxes[i, BSPEED] > speed and cost[i, j] < gate
        if not asked:
            continue  # nearly always
        beside = across + deviations * points[j, PG] * math.sqrt(points[j, PVAR_AZ])
        sine, cosine = points[j, PX] / points[j, PG], points[j, PY] / points[j, PG]
        frames, last = 0.0, -1
        for k in range(len(before)):
            if known[j] or frames >= wanted:
                break
            if owned[k] or time_us[k] == last:
                continue
            dx, dy = before[k, PX] - points[j, PX], before[k, PY] - points[j, PY]
            if abs(sine * dx + cosine * dy) < along and abs(cosine * dx - sine * dy) < beside:
                frames, last = frames + 1.0, time_us[k]
        if frames < wanted and not known[j]:
            continue
        for i in range(len(boxes)):
            if boxes[i, BSPEED] > speed:
                cost[i, j] = np.inf
