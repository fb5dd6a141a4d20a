"""Multipath ghosts: mirror images of vehicles in guard rails and double bounces between neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.simulation.scenery import Scenery
from service.simulation.vehicles import VehicleKind, VehicleStates
from service.tracking.model import F64, Bool

MIRROR, BOUNCE = 0, 1
MIRROR_REACH_M = 12.0  # from a vehicle to the rail
BOUNCE_REACH_M = 18.0  # between two vehicles
FARTHEST_M = 120.0  # ghosts of farther vehicles are below the noise
TALL_M = 2.5
TALL_FACTOR = 3.0  # flat high sides mirror more often
SPREAD_M = 0.4  # of the image of an extended vehicle
SPREAD_DB = 3.0
VEHICLE_DBSM: dict[VehicleKind, float] = {
    VehicleKind.CAR: 6.0,
    VehicleKind.TRUCK: 11.0,
    VehicleKind.BUS: 11.0,
    VehicleKind.MOTORCYCLE: -2.0,
}


@dataclass(frozen=True, slots=True)
class GhostParameters:
    """How often ghosts appear, how long they live and how strong they are."""

    rate_per_s: float = 0.06  # of new ghosts for each vehicle and kind of path
    life_s: float = 0.6  # mean
    loss_db: float = 15.0  # of the second bounce


@dataclass(frozen=True, slots=True)
class GhostEchoes:
    """G ghost points: apparent place, range rate and cross-section (before the radar equation)."""

    x_m: F64
    y_m: F64
    radial_velocity_mps: F64
    rcs_dbsm: F64


def step_lives(
    alive: Bool,
    vehicles: VehicleStates,
    *,
    dt_s: float,
    parameters: GhostParameters,
    rng: np.random.Generator,
) -> Bool:
    """Return which ghost paths (V, 2) are alive after `dt_s`: a two-state Markov chain for each."""
    rate = parameters.rate_per_s * np.where(vehicles.height_m > TALL_M, TALL_FACTOR, 1.0)
    u = rng.random(alive.shape)
    born = u < 1 - np.exp(-rate[:, None] * dt_s)
    lives_on = u < np.exp(-dt_s / parameters.life_s)
    return np.where(alive, lives_on, born)


def ghost_echoes(
    alive: Bool,
    vehicles: VehicleStates,
    scenery: Scenery,
    *,
    parameters: GhostParameters,
    rng: np.random.Generator,
) -> GhostEchoes:
    """Return the points of the ghosts that are alive (V, 2)."""
    rows: list[tuple[float, float, float, float]] = []
    level = np.array([VEHICLE_DBSM[k] for k in VehicleKind])[vehicles.kind] - parameters.loss_db
    near = vehicles.ground_range_m() < FARTHEST_M
    for v in np.flatnonzero(alive[:, MIRROR] & near).tolist():
        image = _mirror_image(v, vehicles, scenery)
        if image is None:
            continue
        x, y, rate = image
        for _ in range(rng.integers(1, 3)):
            dx, dy = rng.normal(0.0, SPREAD_M, 2)
            rows.append((x + dx, y + dy, rate, level[v] + rng.normal(0.0, SPREAD_DB)))
    for v in np.flatnonzero(alive[:, BOUNCE] & near).tolist():
        bounce = _double_bounce(v, vehicles)
        if bounce is not None:
            rows.append((*bounce, level[v] + rng.normal(0.0, SPREAD_DB)))
    return GhostEchoes(*np.array(rows, dtype=np.float64).reshape(-1, 4).T)


def _mirror_image(v: int, vehicles: VehicleStates, scenery: Scenery) -> tuple[float, float, float] | None:
    """Return place and range rate of the image in the nearest rail, None when none is near.

    The echo goes out straight and comes back over the rail: it appears in the image's bearing at the mean of
    the two path lengths. Range rate: the image moves along the rail as the vehicle does.
    """
    place = np.array([vehicles.x_m[v], vehicles.y_m[v]])
    nearest, foot = MIRROR_REACH_M, None
    for rail in scenery.rails:
        a, d = rail[:-1], np.diff(rail, axis=0)
        t = np.clip(((place - a) * d).sum(axis=1) / (d * d).sum(axis=1), 0.0, 1.0)
        feet = a + t[:, None] * d
        gap = np.hypot(*(feet - place).T)
        k = int(np.argmin(gap))
        if gap[k] < nearest:
            nearest, foot = float(gap[k]), feet[k]
    if foot is None:
        return None
    image = 2 * foot - place
    image_range = float(np.hypot(*image))
    apparent = image * (np.hypot(*place) + image_range) / 2 / image_range
    rate = float(vehicles.vx_mps[v] * image[0] + vehicles.vy_mps[v] * image[1]) / image_range
    return float(apparent[0]), float(apparent[1]), rate


def _double_bounce(v: int, vehicles: VehicleStates) -> tuple[float, float, float] | None:
    """Return place and range rate of the path radar, vehicle, neighbour and back; None without neighbour."""
    dx, dy = vehicles.x_m - vehicles.x_m[v], vehicles.y_m - vehicles.y_m[v]
    apart = np.hypot(dx, dy)
    apart[v] = np.inf
    n = int(np.argmin(apart))
    if apart[n] > BOUNCE_REACH_M:
        return None
    x, y, vx, vy = vehicles.x_m[v], vehicles.y_m[v], vehicles.vx_mps[v], vehicles.vy_mps[v]
    r = float(np.hypot(x, y))
    opening = ((vehicles.vx_mps[n] - vx) * dx[n] + (vehicles.vy_mps[n] - vy) * dy[n]) / apart[n]
    stretch = (r + apart[n]) / r
    return float(x * stretch), float(y * stretch), float((vx * x + vy * y) / r + opening)
