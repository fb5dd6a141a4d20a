"""Cut lanes where lanes of another direction cross them: what comes before, the way through, what goes on."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, Bool
from service.traffic.curves import along, beside, headings, resample
from service.traffic.steps import CALL_WORK, Steps


@dataclass(frozen=True, slots=True)
class JunctionParameters:
    """What a crossing is."""

    angle_deg: float = 25.0  # lanes that meet at less run along each other
    reach_m: float = 2.0  # of a lane's middle from the other's
    margin_m: float = 5.0  # that the junction reaches beyond the first and last crossing
    gap_m: float = 20.0  # crossings this near are of one junction
    shortest_m: float = 15.0  # of a piece that is kept
    turn_deg: float = 40.0  # a piece that bends more inside `turn_within_m` is a turn
    turn_within_m: float = 30.0
    step_m: float = 1.0


@dataclass(frozen=True, slots=True)
class Piece:
    """A part of a lane: from and to along it."""

    start_m: float
    end_m: float
    turn: bool


def pieces(lanes: list[F64], p: JunctionParameters) -> Steps[list[list[Piece]]]:
    """Return the pieces of each lane (P, 2); a lane that nothing crosses is one piece."""
    fine = [resample(lane, p.step_m) for lane in lanes]
    total = sum(len(lane) for lane in fine)
    found = []
    for k, lane in enumerate(fine):
        found.append(_cut(lane, _crossed(fine, k, p), p))
        yield len(lane) * total + len(fine) * CALL_WORK
    return found


def _crossed(fine: list[F64], k: int, p: JunctionParameters) -> Bool:
    """Return at which points of a lane another crosses it."""
    mine = fine[k]
    heading = headings(mine)
    crossed = np.zeros(len(mine), dtype=np.bool_)
    for other in (*fine[:k], *fine[k + 1 :]):
        place = beside(mine, other)
        across = np.abs(np.sin(heading - place.heading_rad)) > math.sin(math.radians(p.angle_deg))
        crossed |= across & ~place.beyond & (np.abs(place.right_m) < p.reach_m)
    return crossed


def _cut(lane: F64, crossed: Bool, p: JunctionParameters) -> list[Piece]:
    length = along(lane)
    total = float(length[-1])
    parts: list[tuple[float, float, bool]] = []
    done = 0.0
    for start, end in _junctions(length[crossed], p):
        parts += [(done, max(start, 0.0), False), (max(start, 0.0), min(end, total), True)]
        done = min(end, total)
    parts.append((done, total, False))
    bend = _bend(lane, p)
    return [
        Piece(start, end, inside or bool(bend[(length >= start) & (length <= end)].any()))
        for start, end, inside in parts
        if end - start >= p.shortest_m
    ]


def _junctions(where: F64, p: JunctionParameters) -> list[tuple[float, float]]:
    """Return from and to of the junctions that crossings at `where` along a lane belong to."""
    if not len(where):
        return []
    groups = np.split(where, np.flatnonzero(np.diff(where) > p.gap_m) + 1)
    return [(float(group[0]) - p.margin_m, float(group[-1]) + p.margin_m) for group in groups]


def _bend(lane: F64, p: JunctionParameters) -> Bool:
    """Return where a lane turns by much in a short way."""
    heading = headings(lane)
    reach = max(round(0.5 * p.turn_within_m / p.step_m), 1)
    index = np.arange(len(lane))
    after, before = np.minimum(index + reach, len(lane) - 1), np.maximum(index - reach, 0)
    return np.asarray(np.abs(heading[after] - heading[before]) > math.radians(p.turn_deg))
