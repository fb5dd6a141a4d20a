"""Scattering centres of a vehicle: where on its box the echoes come from and how strong they are.

A vehicle at millimetre waves is a few dozen bright points: plates and lamps of the faces, corners, panels and
door gaps of the sides, wheel houses, turning wheels, mirrors and roof edges (Schuler, Becker, Wiesbeck 2008,
"Extraction of virtual scattering centers of vehicles by ray-tracing simulations", IEEE Trans. Antennas
Propag. 56). Levels are set so that the points per vehicle and their gaps agree with reference scenes
(benchmarks/simulator_statistics.py).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from service.simulation.vehicles import VehicleKind
from service.tracking.model import F64

OMNIDIRECTIONAL = np.nan  # normal of a scatterer that is seen from all sides
CORNER_INSET = 0.96  # of half the length and half the width
FACE_HEIGHT_M, CORNER_HEIGHT_M, SIDE_HEIGHT_M = 0.55, 0.6, 0.7
WHEEL_HEIGHT_M, BODY_HEIGHT_M, RIDER_HEIGHT_M = 0.35, 1.3, 0.7
PLATE_STD_M, PANEL_STD_M = 0.06, 0.1  # of the places across a face and along a side
END_SHARE = 0.8  # of the length over which roof and underbody points are spread


@dataclass(frozen=True, slots=True)
class Profile:
    """Scattering centres of one kind of vehicle: numbers, places and mean cross-sections [dBsm]."""

    face_points: int  # on front and rear each
    face_dbsm: float
    corner_dbsm: float
    side_spacing_m: float
    side_dbsm: float
    axles: tuple[float, ...]  # along the vehicle, in lengths from its centre
    wheel_house_dbsm: float
    wheel_dbsm: float
    body_spacing_m: float  # roof, mirrors, underbody
    body_dbsm: float
    spread_db: float = 2.5  # standard deviation between the centres of one vehicle and between vehicles


CAR = Profile(3, 1.5, -1.0, 0.8, 3.0, (-0.32, 0.32), -12.0, -18.0, 1.0, -7.0, 2.8)
LORRY = Profile(4, 4.5, 2.0, 1.1, 8.0, (-0.38, -0.28, 0.36), -12.0, -18.0, 1.5, -3.0)
RIDER_DBSM, RIDER_SPREAD_DB = -4.0, 2.0
RIDER_PLACES = (-0.4, 0.0, 0.4)  # rear wheel and plate, engine and rider, fork and lamp; in lengths
PROFILES: dict[VehicleKind, Profile] = {
    VehicleKind.CAR: CAR,
    VehicleKind.TRUCK: LORRY,
    VehicleKind.BUS: LORRY,
}


@dataclass(frozen=True, slots=True)
class Scatterers:
    """S scattering centres in the vehicle's own axes, from the centre of the box on the road."""

    forward_m: F64
    right_m: F64
    height_m: F64
    normal_rad: F64  # bearing of the outward normal from the vehicle's heading; NaN: seen from all sides
    rcs_dbsm: F64
    turning: F64  # 1 for a turning wheel, whose Doppler is smeared; else 0

    def __len__(self) -> int:
        return len(self.forward_m)

    @classmethod
    def join(cls, parts: Sequence[Scatterers]) -> Scatterers:
        """Return all scatterers of several vehicles as one."""
        if not parts:
            return cls(*[np.zeros(0)] * len(dataclasses.fields(cls)))
        names = [f.name for f in dataclasses.fields(cls)]
        return cls(**{n: np.concatenate([getattr(part, n) for part in parts]) for n in names})


Row = tuple[float, float, float, float, float, float]


def draw_scatterers(
    kind: VehicleKind, length_m: float, width_m: float, rng: np.random.Generator
) -> Scatterers:
    """Return the scattering centres of one vehicle, drawn once for its life."""
    profile = PROFILES.get(kind)
    rows = list(_rider(length_m)) if profile is None else list(_box(profile, length_m, width_m, rng))
    table = np.array(rows, dtype=np.float64).T
    spread = RIDER_SPREAD_DB if profile is None else profile.spread_db
    table[4] += rng.normal(0.0, spread, table.shape[1])
    return Scatterers(*table)


def _rider(length_m: float) -> Iterator[Row]:
    for place in RIDER_PLACES:
        yield place * length_m, 0.0, RIDER_HEIGHT_M, OMNIDIRECTIONAL, RIDER_DBSM, 0.0


def _box(p: Profile, length_m: float, width_m: float, rng: np.random.Generator) -> Iterator[Row]:
    half_length, half_width = length_m / 2, width_m / 2
    places = np.arange(p.face_points) - (p.face_points - 1) / 2
    for end, bearing, corner in ((1, 0.0, np.pi / 4), (-1, np.pi, 3 * np.pi / 4)):
        for place in places:
            right = place / p.face_points * width_m + rng.normal(0.0, PLATE_STD_M)
            yield end * half_length, right, FACE_HEIGHT_M, bearing, p.face_dbsm, 0.0
        for side in (-1, 1):
            forward, right = end * half_length * CORNER_INSET, side * half_width * CORNER_INSET
            yield forward, right, CORNER_HEIGHT_M, side * corner, p.corner_dbsm, 0.0
    for side in (-1, 1):
        out = side * np.pi / 2
        for along in np.arange(-half_length + p.side_spacing_m / 2, half_length, p.side_spacing_m):
            yield (
                along + rng.normal(0.0, PANEL_STD_M),
                side * half_width,
                SIDE_HEIGHT_M,
                out,
                p.side_dbsm,
                0.0,
            )
        for axle in p.axles:
            hub = (axle * length_m, side * half_width * CORNER_INSET, WHEEL_HEIGHT_M, out)
            yield *hub, p.wheel_house_dbsm, 0.0
            yield *hub, p.wheel_dbsm, 1.0
    span = END_SHARE * half_length
    for along in np.linspace(-span, span, max(int(length_m / p.body_spacing_m), 2)):
        right = rng.uniform(-END_SHARE, END_SHARE) * half_width
        yield along, right, BODY_HEIGHT_M, OMNIDIRECTIONAL, p.body_dbsm, 0.0
