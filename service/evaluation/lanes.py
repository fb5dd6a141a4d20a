"""Score learned lanes against the true centre lines, and found lane changes against the true manoeuvres."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from service.evaluation.kinematics import Matches
from service.evaluation.polyline import feet, unit
from service.evaluation.recorded import FoundChange, FoundLane, RecordedTracks, TrackId
from service.evaluation.rules import ScoringRules
from service.evaluation.truth import Scene, TruthChange
from service.tracking.model import F64

_FAR_M = 50.0  # cost of a pair of lanes that do not go together


@dataclass(frozen=True, slots=True)
class Fit:
    """How a found lane lies beside a true one."""

    mean_m: float
    max_m: float
    coverage: float


def score_lanes(
    scene: Scene, found: Sequence[FoundLane], rules: ScoringRules
) -> tuple[dict[str, float | int], dict[TrackId, str]]:
    """Return the lane scores, and the true lane of each found lane that is one."""
    true = scored_lanes(scene, rules)
    names = list(true)
    fits = {
        (a, b): fit
        for a, name in enumerate(names)
        for b, lane in enumerate(found)
        if (fit := _fit(true[name], lane.points, rules)) is not None
    }
    offset = np.full((len(names), len(found)), _FAR_M)
    for place, fit in fits.items():
        offset[place] = min(fit.mean_m, _FAR_M)
    rows, columns = linear_sum_assignment(offset)
    near = offset[rows, columns] < rules.lane_offset_m
    pairs = [(int(a), int(b)) for a, b in zip(rows[near], columns[near], strict=True)]
    right = [fits[pair] for pair in pairs]
    partner: dict[TrackId, str] = {found[b].lane_id: names[a] for a, b in pairs}
    spare = _pair_unscored(scene, found, true, partner, rules)
    scores: dict[str, float | int] = {
        "lanes_true": len(names),
        "lanes_found": len(found),
        "lanes_right": len(right),
        "lanes_extra": len(found) - len(right) - spare,
        "lane_count_exact": len(names) == len(right) == len(found) - spare,
        "lane_offset_mean_m": float(np.mean([fit.mean_m for fit in right])) if right else math.nan,
        "lane_offset_max_m": max((fit.max_m for fit in right), default=math.nan),
        "lane_coverage": float(np.mean([fit.coverage for fit in right])) if right else math.nan,
    }
    return scores, partner


def scored_lanes(scene: Scene, rules: ScoringRules) -> dict[str, F64]:
    """Return the part in view of each true lane that is long enough there and used by enough vehicles."""
    out: dict[str, F64] = {}
    for lane in scene.lanes:
        ground = np.hypot(lane.points[:, 0], lane.points[:, 1])
        part = lane.points[(ground > rules.lane_near_m) & (ground < rules.lane_far_m)]
        if len(part) > rules.lane_points and scene.lane_users[lane.lane_id] >= rules.lane_vehicles:
            out[lane.lane_id] = part
    return out


def _fit(true: F64, found: F64, rules: ScoringRules) -> Fit | None:
    """Return how the found line lies along the true one; None where it covers too little or runs across."""
    foot = feet(found, true)
    beside = ~foot.beyond
    coverage = float(np.mean(beside))
    if coverage < rules.lane_coverage or not beside.any():
        return None
    heading = unit(np.gradient(true, axis=0))
    alignment = float(np.mean(np.sum(foot.direction * heading, axis=1)[beside]))
    if abs(alignment) < rules.lane_alignment:
        return None
    distance = foot.distance_m[beside]
    return Fit(float(distance.mean()), float(distance.max()), coverage)


def _pair_unscored(
    scene: Scene,
    found: Sequence[FoundLane],
    true: dict[str, F64],
    partner: dict[TrackId, str],
    rules: ScoringRules,
) -> int:
    """Give the true lanes that are not scored a found lane each, if one lies on them; return how many."""
    spare = 0
    for lane in scene.lanes:
        if lane.lane_id in true:
            continue
        for candidate in found:
            if candidate.lane_id in partner:
                continue
            if feet(lane.points, candidate.points).distance_m.mean() < rules.lane_offset_m:
                partner[candidate.lane_id] = lane.lane_id
                spare += 1
                break
    return spare


def score_changes(
    scene: Scene,
    found: Sequence[FoundChange],
    tracks: RecordedTracks,
    matches: Matches,
    rules: ScoringRules,
) -> dict[str, float | int]:
    """Return recall and precision of the lane changes: the same vehicle, near the manoeuvre in time."""
    vehicle_at = {
        (int(f), tracks.ids[tracks.track[s]]): int(scene.rows.vehicle[r])
        for f, r, s in zip(matches.frame, matches.row, matches.state, strict=True)
    }
    since = scene.time_s - scene.origin_s
    free = list(scene.changes)
    hits = 0
    for change in found:
        nearest = int(np.argmin(np.abs(since - change.t_s)))
        vehicle = _vehicle_near(vehicle_at, nearest, change.track_id, rules.change_search_frames)
        fitting = [true for true in free if true.vehicle == vehicle and _near(true, change.t_s, rules)]
        if fitting:
            hits += 1
            free.remove(min(fitting, key=lambda true: abs(true.t_s - change.t_s)))
    return {
        "changes_true": len(scene.changes),
        "changes_found": len(found),
        "changes_recall": hits / max(len(scene.changes), 1),
        "changes_precision": hits / max(len(found), 1),
    }


def _near(true: TruthChange, t_s: float, rules: ScoringRules) -> bool:
    first, last = min(true.t_s, true.start_s), max(true.t_s, true.end_s)
    return first - rules.change_tolerance_s <= t_s <= last + rules.change_tolerance_s


def _vehicle_near(
    vehicle_at: dict[tuple[int, TrackId], int], frame: int, track_id: TrackId, reach: int
) -> int | None:
    """Return the vehicle that the track was on in the nearest frame in reach, the earlier of two."""
    for away in range(reach + 1):
        for candidate in (frame - away, frame + away):
            if (candidate, track_id) in vehicle_at:
                return vehicle_at[candidate, track_id]
    return None
