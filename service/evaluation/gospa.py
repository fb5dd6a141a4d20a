"""GOSPA and OSPA of one frame, with their parts.

Sources: Rahmathullah, Garcia-Fernandez, Svensson, "Generalized optimal sub-pattern assignment metric",
FUSION 2017 (alpha = 2); Schuhmacher, Vo, Vo, "A consistent metric for performance evaluation of multi-object
filters", IEEE Transactions on Signal Processing 56(8), 2008.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from service.tracking.model import F64


@dataclass(frozen=True, slots=True)
class Gospa:
    """GOSPA distance and its parts: distance^p = localisation + c^p / 2 * (missed + false)."""

    distance_m: float
    localisation: float  # sum over the assigned pairs of d^p, m^p
    missed: int
    false: int


@dataclass(frozen=True, slots=True)
class Ospa:
    """OSPA distance and its parts: distance^p = localisation^p + cardinality^p."""

    distance_m: float
    localisation_m: float
    cardinality_m: float


def gospa(distance_m: F64, cutoff_m: float, order: int = 2) -> Gospa:
    """Return GOSPA (alpha = 2) of the (V, T) distances between V vehicles and T tracks."""
    vehicles, tracks = distance_m.shape
    paired = _assigned(distance_m, cutoff_m, order)
    paired = paired[paired < cutoff_m]
    localisation = float(np.sum(paired**order))
    missed, false = vehicles - len(paired), tracks - len(paired)
    total = localisation + cutoff_m**order / 2 * (missed + false)
    return Gospa(total ** (1 / order), localisation, missed, false)


def ospa(distance_m: F64, cutoff_m: float, order: int = 2) -> Ospa:
    """Return OSPA of the (V, T) distances between V vehicles and T tracks."""
    vehicles, tracks = distance_m.shape
    larger = max(vehicles, tracks)
    if larger == 0:
        return Ospa(0.0, 0.0, 0.0)
    localisation = float(np.sum(_assigned(distance_m, cutoff_m, order) ** order)) / larger
    cardinality = cutoff_m**order * abs(vehicles - tracks) / larger
    root = 1 / order
    return Ospa((localisation + cardinality) ** root, localisation**root, cardinality**root)


def _assigned(distance_m: F64, cutoff_m: float, order: int) -> F64:
    """Return min(d, c) of the pairs of the assignment that minimises the sum of min(d, c)^p."""
    cut = np.minimum(distance_m, cutoff_m)
    return cut[linear_sum_assignment(cut**order)]
