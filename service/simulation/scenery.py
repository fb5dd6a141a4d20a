"""What stands beside the road and echoes too: guard rail posts, poles, joints in the road surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.simulation.roads import Road
from service.tracking.model import F64, Bool

POST_SPACING_M = 4.0  # of guard rails
POST_DBSM, POST_SPREAD_DB = -9.0, 3.0
POLE_DBSM = (0.0, 9.0)
POLE_OFFSET_M = 1.5  # behind the outer rails
JOINT_DBSM, JOINT_SPREAD_DB = -8.0, 2.0
SWAYING_SHARE = 0.15  # signs and leaves in the wind
NEAR_M, FAR_M = 10.0, 170.0  # arc length over which scenery stands


@dataclass(frozen=True, slots=True)
class Scenery:
    """R standing reflectors, and the guard rails as polylines (each (N, 2)) for mirror images."""

    x_m: F64
    y_m: F64
    rcs_dbsm: F64
    sways: Bool
    rails: tuple[F64, ...] = ()

    @classmethod
    def empty(cls) -> Scenery:
        """Return a road side without any reflector."""
        return cls(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0, np.bool_))


def draw_scenery(
    road: Road, rng: np.random.Generator, *, pole_spacing_m: float = 35.0, joints: int = 3
) -> Scenery:
    """Return the scenery of a road: posts along its rails, poles behind them, joints in its lanes."""
    s = np.arange(NEAR_M, FAR_M, POST_SPACING_M)
    rails = tuple(np.stack(road.place(s, np.full(len(s), offset)), axis=1) for offset in road.rail_offsets_m)
    outer = (min(road.rail_offsets_m) - POLE_OFFSET_M, max(road.rail_offsets_m) + POLE_OFFSET_M)
    poles = [_poles(road, offset, pole_spacing_m, rng) for offset in outer]
    lane = rng.integers(0, len(road.lanes), joints)
    offset = np.array([q.offset_m for q in road.lanes])[lane]
    bumps = np.stack(road.place(rng.uniform(NEAR_M, FAR_M, joints), offset), axis=1)
    return assemble(rails, np.concatenate(poles), bumps, rng)


def assemble(rails: Sequence[F64], poles: F64, joints: F64, rng: np.random.Generator) -> Scenery:
    """Return the scenery of posts at the rails' points, poles and joints, all (N, 2), with drawn levels."""
    posts = np.concatenate([np.zeros((0, 2)), *rails])
    places = np.concatenate([posts, poles.reshape(-1, 2), joints.reshape(-1, 2)])
    rcs = np.concatenate(
        [
            rng.normal(POST_DBSM, POST_SPREAD_DB, len(posts)),
            rng.uniform(*POLE_DBSM, len(poles)),
            rng.normal(JOINT_DBSM, JOINT_SPREAD_DB, len(joints)),
        ]
    )
    return Scenery(places[:, 0], places[:, 1], rcs, rng.random(len(places)) < SWAYING_SHARE, tuple(rails))


def _poles(road: Road, offset_m: float, spacing_m: float, rng: np.random.Generator) -> F64:
    count = int((FAR_M - NEAR_M) / spacing_m)
    gaps = spacing_m * rng.uniform(0.7, 1.3, count)
    s = NEAR_M + np.cumsum(gaps) - gaps[0] * rng.random()
    return np.stack(road.place(s, np.full(count, offset_m)), axis=1)
