"""To which side nearer vehicles move the mean of a vehicle's echoes, by hiding part of it.

The radar looks down from its mast, so a vehicle throws a shadow over the road behind it, the longer the
higher it is. Who stands in its edge is seen in part, and the mean of what is seen lies to one side of the
middle: by half a metre in a queue, frame after frame, which no filter averages away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from service.tracking.model import F64
from service.tracking.shading_kernels import shade_boxes
from service.tracking.state import Tracks

if TYPE_CHECKING:
    from service.tracking.parameters import SensorModel


@dataclass(frozen=True, slots=True)
class ShadingParameters:
    """How high vehicles are, and which shadows are believed."""

    enabled: bool = True
    settled_hits: int = 30  # a box seen so often is put right, and, once confirmed, throws shadows
    car_height_m: float = 1.5
    long_height_m: float = 3.1
    long_m: float = 7.0  # what is longer is a truck or a bus, ...
    long_echo_m: float = 1.2  # ... and most of its echoes come from so high above the road
    end_on: float = 0.8  # least cosine of the aspect of who is put right; side-on, lengths are hidden
    # in its own lane, which reaches so far, nobody hides it who ends this much beyond its near end: a second
    # box on the same vehicle would push it aside
    lane_m: float = 2.2
    clear_m: float = 0.5
    doubt: float = 0.5  # of the shift: the deviation that it adds to the measured place
    lit_face: float = 0.8  # a near end of which so much is lit is not hidden


def shade(boxes: F64, tracks: Tracks, sensor: SensorModel, p: ShadingParameters) -> None:
    """Write how far to the right shadows move the echoes of each box (T, BOX_COLUMNS), and its variance.

    The shift is that of the mean across the box, in metres, against the same without shadows: of samples on
    its near end and its near side, weighted by how they face the radar and by what nearer boxes leave of
    them. BHIDDEN is cleared for boxes whose near end is in sight whatever is there. For a radar that hangs no
    higher than the echoes nothing is done.
    """
    if not p.enabled or sensor.mount_height_m <= sensor.scatter_height_m:
        return
    seen = tracks.hits >= p.settled_hits
    shade_boxes(
        boxes, seen & tracks.confirmed, seen, sensor.mount_height_m, sensor.scatter_height_m,
        (p.car_height_m, p.long_height_m, p.long_m, p.long_echo_m, p.end_on, p.clear_m, p.lane_m, p.doubt,
         p.lit_face),
    )  # fmt: skip
