"""Roads in the plan frame: a reference line (straight, then an arc), lanes and rails beside it.

Arc length `s` runs along the reference line away from the radar; `offset` is to its right, metres. The
reference line passes the radar at s = 0.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64

LANE_WIDTH_M = 3.5
SHOULDER_M = 0.8  # from the edge of the outer lane to the guard rail
LINE_MARGIN_M = 1.0  # by which a count line is longer than the carriageway at each end
COUNT_LINES_M = (40.0, 80.0, 120.0)
LANE_STEP_M = 2.0  # between the points of a lane's centre line


@dataclass(frozen=True, slots=True)
class Lane:
    """One lane: its place beside the reference line, and its direction (+1 receding, -1 approaching)."""

    lane_id: str
    offset_m: float
    direction: int
    width_m: float = LANE_WIDTH_M

    @property
    def direction_name(self) -> str:
        """Return the direction as written in files."""
        return "receding" if self.direction > 0 else "approaching"


@dataclass(frozen=True, slots=True)
class Road:
    """A road with its lanes; `curvature_per_m` is positive for a bend to the right."""

    lanes: tuple[Lane, ...]
    rail_offsets_m: tuple[float, ...]
    start_m: float = -60.0  # where receding traffic comes in and approaching traffic goes out
    end_m: float = 340.0
    x_m: float = 0.0  # reference line at s = 0
    heading_rad: float = 0.0
    straight_to_m: float = 0.0
    curvature_per_m: float = 0.0
    count_lines_m: tuple[float, ...] = COUNT_LINES_M

    def heading_at(self, s_m: F64) -> F64:
        """Return the bearing of the reference line, clockwise from +y."""
        return self.heading_rad + self.curvature_per_m * np.maximum(s_m - self.straight_to_m, 0.0)

    def place(self, s_m: F64, offset_m: F64) -> tuple[F64, F64]:
        """Return x, y of points given along and beside the reference line."""
        s_m = np.asarray(s_m, dtype=np.float64)
        straight = np.minimum(s_m, self.straight_to_m)
        turned = self.curvature_per_m * (s_m - straight)
        # chord of an arc: 2 R sin(turned / 2), at half the turned angle; sinc keeps it exact for no curvature
        chord = (s_m - straight) * np.sinc(turned / 2 / np.pi)
        along = self.heading_rad + turned / 2
        x = self.x_m + straight * math.sin(self.heading_rad) + chord * np.sin(along)
        y = straight * math.cos(self.heading_rad) + chord * np.cos(along)
        end = self.heading_rad + turned
        return x + offset_m * np.cos(end), y - offset_m * np.sin(end)

    def locate(self, x_m: F64, y_m: F64) -> tuple[F64, F64]:
        """Return arc length and offset of points, the inverse of `place`."""
        sine, cosine = math.sin(self.heading_rad), math.cos(self.heading_rad)
        dx = np.asarray(x_m, dtype=np.float64) - self.x_m
        forward, right = dx * sine + y_m * cosine, dx * cosine - y_m * sine
        if self.curvature_per_m == 0:
            return forward, right
        beyond = forward - self.straight_to_m
        radius = 1 / self.curvature_per_m  # signed; the arc's centre lies at offset `radius`
        side = math.copysign(1.0, radius)
        turned = np.arctan2(beyond * side, (radius - right) * side)
        on_arc = beyond > 0
        s = np.where(on_arc, self.straight_to_m + radius * turned, forward)
        offset = np.where(on_arc, radius - side * np.hypot(beyond, radius - right), right)
        return s, offset

    def shrink(self, s_m: F64, offset_m: F64) -> F64:
        """Return metres of path at an offset for one metre of reference line."""
        return np.where(np.asarray(s_m) > self.straight_to_m, 1 - self.curvature_per_m * offset_m, 1.0)

    def lane_points(self, lane: Lane) -> F64:
        """Return (N, 2) points of the centre line of a lane in driving direction."""
        s = np.arange(self.start_m, self.end_m, LANE_STEP_M)[:: lane.direction]
        return np.stack(self.place(s, np.full(len(s), lane.offset_m)), axis=1)

    def edges_m(self) -> tuple[float, float]:
        """Return the offsets of the left and the right edge of the carriageway."""
        return (
            min(lane.offset_m - lane.width_m / 2 for lane in self.lanes),
            max(lane.offset_m + lane.width_m / 2 for lane in self.lanes),
        )

    def count_line(self, s_m: float) -> F64:
        """Return (2, 2) end points of a line across the whole road."""
        left, right = self.edges_m()
        offset = np.array([left - LINE_MARGIN_M, right + LINE_MARGIN_M])
        return np.stack(self.place(np.full(2, s_m), offset), axis=1)

    def neighbours(self) -> tuple[tuple[int, ...], ...]:
        """Return for each lane the indices of the lanes beside it that are driven the same way."""
        return tuple(
            tuple(
                j
                for j, other in enumerate(self.lanes)
                if other.direction == lane.direction
                and 0 < abs(other.offset_m - lane.offset_m) < (other.width_m + lane.width_m) / 2 * 1.01
            )
            for lane in self.lanes
        )


def one_way(lanes: int, *, approaching: bool, width_m: float = LANE_WIDTH_M, x_m: float = 0.0) -> Road:
    """Return a straight road driven one way; lane L1 is the rightmost in driving direction."""
    direction = -1 if approaching else 1
    offsets = [direction * ((lanes - 1) / 2 - i) * width_m for i in range(lanes)]
    half = lanes * width_m / 2 + SHOULDER_M
    return Road(
        lanes=tuple(Lane(f"L{i + 1}", offset, direction, width_m) for i, offset in enumerate(offsets)),
        rail_offsets_m=(-half, half),
        x_m=x_m,
    )


def two_way(lanes: int, *, width_m: float = LANE_WIDTH_M, median_m: float = 2.0, x_m: float = 0.0) -> Road:
    """Return a straight road driven on the right, with a rail in its median; R1 and A1 are outermost."""
    offsets = [median_m / 2 + (lanes - i - 0.5) * width_m for i in range(lanes)]
    half = median_m / 2 + lanes * width_m + SHOULDER_M
    return Road(
        lanes=tuple(
            Lane(f"{name}{i + 1}", direction * offset, direction, width_m)
            for name, direction in (("R", 1), ("A", -1))
            for i, offset in enumerate(offsets)
        ),
        rail_offsets_m=(-half, 0.0, half),
        x_m=x_m,
    )


def bend(road: Road, *, radius_m: float, straight_to_m: float, heading_rad: float = 0.0) -> Road:
    """Return the road with an arc from `straight_to_m` on, to the right for a positive radius."""
    quarter_m = straight_to_m + abs(radius_m) * math.pi / 2  # beyond a quarter turn it would come back
    return dataclasses.replace(
        road,
        curvature_per_m=1 / radius_m,
        straight_to_m=straight_to_m,
        heading_rad=heading_rad,
        end_m=min(road.end_m, quarter_m),
    )
