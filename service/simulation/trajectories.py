"""Given trajectories, recorded or simulated elsewhere, as vehicles that a simulated radar can look at.

Two file formats: the truth of a scene directory (`truth.csv.gz`, plan frame, a row for each frame and
vehicle), and trajectories of a site (gzip CSV, columns `vehicle_id, t_s, x_m, y_m, vx_mps, vy_mps, length_m,
width_m, class, lane_id`; x about east, y about north).
"""

from __future__ import annotations

import csv
import gzip
import math
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from service.errors import InvalidInput
from service.simulation.vehicles import VehicleKind, VehicleStates, typical_height_m
from service.tracking.model import F64, I64, U8

STANDING_MPS = 0.5  # below this the velocity gives no heading
SAME_TIME_S = 1e-6
LONGEST_GAP_S = 0.5  # between two rows of one vehicle that are joined


@dataclass(frozen=True, slots=True)
class Trajectories:
    """N rows sorted by vehicle, then time; positions of the centres of the boxes in one plane frame."""

    vehicle_id: I64
    time_s: F64
    x_m: F64
    y_m: F64
    vx_mps: F64
    vy_mps: F64
    heading_rad: F64  # clockwise from +y
    length_m: F64
    width_m: F64
    kind: U8
    lane: I64  # index into `lane_ids`, -1: none
    lane_ids: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.vehicle_id)

    def moved(self, *, x_m: float, y_m: float, heading_rad: float) -> Trajectories:
        """Return the trajectories in the plan frame of a radar at (x, y) that looks along `heading`."""
        sine, cosine = math.sin(heading_rad), math.cos(heading_rad)
        dx, dy = self.x_m - x_m, self.y_m - y_m
        return Trajectories(
            self.vehicle_id,
            self.time_s,
            dx * cosine - dy * sine,
            dx * sine + dy * cosine,
            self.vx_mps * cosine - self.vy_mps * sine,
            self.vx_mps * sine + self.vy_mps * cosine,
            (self.heading_rad - heading_rad) % (2 * np.pi),
            self.length_m,
            self.width_m,
            self.kind,
            self.lane,
            self.lane_ids,
        )


class TrajectorySampler:
    """Gives the vehicles of trajectories at any time."""

    def __init__(self, trajectories: Trajectories) -> None:
        self.trajectories = t = trajectories
        _, self._first, rank = np.unique(t.vehicle_id, return_index=True, return_inverse=True)
        self._end = np.append(self._first[1:], len(t))
        self._origin_s = float(t.time_s.min())
        self._stride_s = float(t.time_s.max()) - self._origin_s + 1.0
        self._key = rank * self._stride_s + t.time_s - self._origin_s
        self._share = (t.vehicle_id * (math.sqrt(5) - 1) / 2) % 1.0  # golden ratio: ids spread evenly

    def span_s(self) -> tuple[float, float]:
        """Return the first and the last time."""
        return self._origin_s, self._origin_s + self._stride_s - 1.0

    def states_at(self, time_s: float) -> VehicleStates:
        """Return the vehicles at a time: cubic Hermite between the two rows around it, held sizes and lanes.

        Heights are unknown; each vehicle gets one of its kind's interval that depends only on its id.
        """
        t = self.trajectories
        begun = np.arange(len(self._first)) * self._stride_s + time_s - self._origin_s + SAME_TIME_S
        last = np.minimum(np.searchsorted(self._key, begun, side="right"), self._end) - 1
        k = last[last >= self._first]
        n = np.minimum(k + 1, len(t) - 1)
        joined = (n > k) & (t.vehicle_id[n] == t.vehicle_id[k]) & (t.time_s[n] - t.time_s[k] <= LONGEST_GAP_S)
        n = np.where(joined, n, k)
        there = joined | (np.abs(t.time_s[k] - time_s) <= SAME_TIME_S)
        k, n = k[there], n[there]
        h = np.where(n > k, t.time_s[n] - t.time_s[k], 1.0)
        u = np.where(n > k, (time_s - t.time_s[k]) / h, 0.0)
        x, vx = _hermite(t.x_m[k], t.x_m[n], t.vx_mps[k], t.vx_mps[n], h, u)
        y, vy = _hermite(t.y_m[k], t.y_m[n], t.vy_mps[k], t.vy_mps[n], h, u)
        turn = (t.heading_rad[n] - t.heading_rad[k] + np.pi) % (2 * np.pi) - np.pi
        return VehicleStates(
            vehicle_id=t.vehicle_id[k],
            kind=t.kind[k],
            x_m=x,
            y_m=y,
            vx_mps=vx,
            vy_mps=vy,
            heading_rad=(t.heading_rad[k] + u * turn) % (2 * np.pi),
            length_m=t.length_m[k],
            width_m=t.width_m[k],
            height_m=typical_height_m(t.kind[k], self._share[k]),
            lane=t.lane[k],
        )


def _hermite(  # noqa: PLR0913, PLR0917 - the textbook's six values
    a: F64, b: F64, va: F64, vb: F64, h: F64, u: F64
) -> tuple[F64, F64]:
    """Return value and slope at the share u of a cubic with given ends and slopes."""
    place = (2 * u**3 - 3 * u**2 + 1) * a + (u**3 - 2 * u**2 + u) * h * va
    place += (3 * u**2 - 2 * u**3) * b + (u**3 - u**2) * h * vb
    slope = (6 * u**2 - 6 * u) * (a - b) / h + (3 * u**2 - 4 * u + 1) * va + (3 * u**2 - 2 * u) * vb
    return place, slope


SITE_COLUMNS = ("vehicle_id", "t_s", "x_m", "y_m", "vx_mps", "vy_mps", "length_m", "width_m")
SCENE_COLUMNS = ("id", "frame", "x", "y", "vx", "vy", "length", "width", "heading_deg")


def read_trajectories(path: Path) -> Trajectories:
    """Read the trajectories of a site; the heading is that of the motion. Raises InvalidInput."""
    number, kind, lanes = _read_csv(path, SITE_COLUMNS, "lane_id")
    order = np.lexsort((number[1], number[0]))
    vehicle, t, x, y, vx, vy, length, width = number[:, order]
    heading = _heading_of_motion(vehicle, vx, vy)
    return _assemble((vehicle, t, x, y, vx, vy, heading, length, width), kind[order], lanes[order])


def read_scene_truth(path: Path, rate_hz: float) -> Trajectories:
    """Read the truth of a scene; a row's time is its frame number over the rate. Raises InvalidInput."""
    number, kind, lanes = _read_csv(path, SCENE_COLUMNS, "lane")
    order = np.lexsort((number[1], number[0]))
    vehicle, frame, x, y, vx, vy, length, width, heading_deg = number[:, order]
    columns = (vehicle, frame / rate_hz, x, y, vx, vy, np.radians(heading_deg), length, width)
    return _assemble(columns, kind[order], lanes[order])


def _read_csv(path: Path, columns: tuple[str, ...], lane_column: str) -> tuple[F64, U8, NDArray[np.str_]]:
    """Return numbers (C, N), kinds (N,) and lane names (N,) of a file; raises InvalidInput."""
    try:
        with gzip.open(path, "rt", encoding="utf-8", newline="") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, EOFError, zlib.error) as error:
        raise InvalidInput(f"{path}: cannot be read: {error}") from None
    for name in (*columns, "class", lane_column):
        if not rows or rows[0].get(name) is None:
            raise InvalidInput.at(f"/{name}", f"{path} has no row with this column")
    labels = {kind.label: kind for kind in VehicleKind}
    unknown = {row["class"] for row in rows} - labels.keys()
    if unknown:
        raise InvalidInput.at("/class", f"{path}: want {', '.join(labels)}, got {', '.join(sorted(unknown))}")
    try:
        number = np.array([[float(row[name]) for row in rows] for name in columns])
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"{path}: {error}") from None
    kind = np.array([labels[row["class"]] for row in rows], dtype=np.uint8)
    return number, kind, np.array([row[lane_column] for row in rows])


def _assemble(columns: tuple[F64, ...], kind: U8, lanes: NDArray[np.str_]) -> Trajectories:
    vehicle, t, x, y, vx, vy, heading, length, width = columns
    names, lane = np.unique(lanes, return_inverse=True)
    ids = vehicle.astype(np.int64)
    return Trajectories(ids, t, x, y, vx, vy, heading, length, width, kind, lane, tuple(names.tolist()))


def _heading_of_motion(ids: F64, vx: F64, vy: F64) -> F64:
    """Return the bearing of the velocity; while standing, that of the last motion, else of the next."""
    heading = np.arctan2(vx, vy) % (2 * np.pi)
    known = np.flatnonzero(np.hypot(vx, vy) > STANDING_MPS)
    if not len(known):
        return heading
    rows = np.arange(len(ids))
    before = known[np.maximum(np.searchsorted(known, rows, side="right") - 1, 0)]
    after = known[np.minimum(np.searchsorted(known, rows), len(known) - 1)]
    source = np.where(
        (before <= rows) & (ids[before] == ids), before, np.where(ids[after] == ids, after, rows)
    )
    return np.asarray(heading[source])
