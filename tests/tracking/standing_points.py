"""Points of vehicles that stand, as a second of frames shows them."""

from __future__ import annotations

import numpy as np

from service.tracking.boxes import PG, POINT_COLUMNS, PX, PY

FRAMES = 20


def points_of(*vehicles, noise_m=0.4, depth_m=0.15, rate=4.0, seed=3):
    """Return the points of FRAMES frames of vehicles (x, y, length) that stand across the view.

    Three quarters lie on the near side, the others up to 1.9 m behind it; noise_m: of azimuth, in metres.
    """
    rng, rows = np.random.default_rng(seed), []
    for x, y, length in vehicles:
        n = rng.poisson(rate * FRAMES * length / 4.4)
        u = x + rng.uniform(-0.5 * length, 0.5 * length, n) + rng.normal(0.0, noise_m, n)
        behind = np.where(rng.random(n) < 0.75, 0.0, rng.uniform(0.0, 1.9, n))
        rows.append(np.column_stack([u, y - 0.95 + behind + rng.normal(0.0, depth_m, n)]))
    places = np.concatenate(rows) if rows else np.zeros((0, 2))
    points = np.zeros((len(places), POINT_COLUMNS))
    points[:, [PX, PY]], points[:, PG] = places, np.hypot(*places.T)
    return points


def turned(points, angle_rad):
    """Return the points with the whole scene turned clockwise about the radar."""
    out, (x, y) = points.copy(), points[:, [PX, PY]].T
    s, c = np.sin(angle_rad), np.cos(angle_rad)
    out[:, PX], out[:, PY] = c * x + s * y, c * y - s * x
    return out


def end_on(points):
    """Return the points with every vehicle turned a quarter of a circle: y and x - 80 m change places."""
    out = points.copy()
    out[:, PX], out[:, PY] = points[:, PY] - 80.0, 80.0 + points[:, PX]
    out[:, PG] = np.hypot(out[:, PX], out[:, PY])
    return out


def queue_of(*vehicles, rate=5.0, seed=3, azimuth_std_rad=0.005, width_m=1.8):
    """Return the points of FRAMES frames of vehicles (x, y, length) that face the radar, in lanes along y.

    Two fifths lie on the face, the others all along the roof and the sides.
    """
    rng, rows = np.random.default_rng(seed), []
    for x, y, length in vehicles:
        n = rng.poisson(rate * FRAMES * length / 4.4)
        along = np.where(rng.random(n) < 0.4, 0.0, np.linspace(0.0, length, n))
        across = rng.uniform(-0.5 * width_m, 0.5 * width_m, n) + rng.normal(0.0, azimuth_std_rad * y, n)
        rows.append(np.column_stack([x + across, y - 0.5 * length + along + rng.normal(0.0, 0.1, n)]))
    places = np.concatenate(rows)
    points = np.zeros((len(places), POINT_COLUMNS))
    points[:, [PX, PY]], points[:, PG] = places, np.hypot(*places.T)
    return points
