"""Queues of vehicles as the association sees them: gated log likelihood ratios of tracks and measurements."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

SPACING_M = (3.5, 6.5)  # across and along the road
INNOVATION_STD_M = (1.3, 1.2)
GATE = 9.21  # chi-square, 2 dimensions, 99 %
MARGIN_M = 3.0  # clutter also falls around the vehicles
TIGHTEN = 0.95


def queue(  # noqa: PLR0913 - a scene has many sides
    rng: np.random.Generator,
    tracks: int,
    *,
    detection: float = 0.9,
    clutter_per_m2: float = 2e-3,
    lanes: int = 3,
    spacing_m: tuple[float, float] = SPACING_M,
) -> tuple[F64, F64]:
    """Return log_weight (T, M) and log_miss (T,) of a queue, tightened until its gates form one component."""
    place = np.column_stack([np.arange(tracks) % lanes, np.arange(tracks) // lanes]) * 1.0
    place += rng.uniform(-0.15, 0.15, place.shape)
    std = np.array(INNOVATION_STD_M)
    seen = rng.random(tracks) < detection
    error = rng.normal(size=(int(seen.sum()), 2)) * std
    scale = 1.0
    while True:
        centre = place * np.array(spacing_m) * scale
        low, high = centre.min(axis=0) - MARGIN_M, centre.max(axis=0) + MARGIN_M
        false = rng.uniform(low, high, (rng.poisson(clutter_per_m2 * np.prod(high - low)), 2))
        measured = np.vstack([centre[seen] + error, false])
        distance2 = (((measured[None] - centre[:, None]) / std) ** 2).sum(axis=2)
        log_weight = np.log(detection / (2 * np.pi * std.prod() * clutter_per_m2)) - 0.5 * distance2
        log_weight[distance2 > GATE] = -np.inf
        if connected(np.isfinite(log_weight)):
            return log_weight, np.full(tracks, np.log(1.0 - detection * 0.99))
        scale *= TIGHTEN


def dense(rng: np.random.Generator, tracks: int) -> tuple[F64, F64]:
    """Return the stress case: four lanes, 3 m by 3 m, poor detection, thick clutter."""
    return queue(rng, tracks, detection=0.7, clutter_per_m2=2e-2, lanes=4, spacing_m=(3.0, 3.0))


def connected(gate: NDArray[np.bool_]) -> bool:
    """Return whether all tracks hang together by the measurements that they share."""
    neighbours = gate @ gate.T
    reached = np.zeros(len(gate), bool)
    reached[0] = True
    while True:
        further = reached | neighbours[reached].any(axis=0)
        if (further == reached).all():
            return bool(reached.all())
        reached = further
