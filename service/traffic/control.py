"""Turn the lanes that a user put into the sensor's configuration into a map's lanes."""

from __future__ import annotations

import zlib

import numpy as np

from service.formats.sensor import LaneControl
from service.traffic.identity import IdentityParameters, direction_of
from service.traffic.mapping import Given
from service.traffic.model import Lane


def given_lanes(control: LaneControl, p: IdentityParameters) -> Given:
    """Return the user's lanes, none where they are learned."""
    if control.mode == "learned":
        return Given(None, 0)
    text = control.model_dump_json(include={"mode", "lanes"})
    lanes = []
    for lane in control.lanes:
        points = np.array(lane.points_m, dtype=np.float64)
        lanes.append(
            Lane(
                index=lane.index,
                lane_id=f"L{lane.index}",
                kind=lane.kind,
                direction=direction_of(points, p),
                points_m=points,
                width_m=np.full(len(points), lane.width_m),
                confidence=1.0,
                vehicles=lane.vehicles,
            )
        )
    return Given(tuple(sorted(lanes, key=lambda lane: lane.index)), zlib.crc32(text.encode()) + 1)
