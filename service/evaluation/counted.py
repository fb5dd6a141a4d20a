"""Decide for each frame which vehicles and which tracks count, and how far they are from each other.

A vehicle counts while it is inside the region, away from its edge, and gave a detection a short time ago. A
track on any other vehicle (long in shadow, at the edge) is neither right nor false and leaves the score.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from service.evaluation.distance import near_face_centres, segment_distances
from service.evaluation.recorded import RecordedTracks
from service.evaluation.rules import ScoringRules
from service.evaluation.truth import Scene
from service.formats.sensor import Region
from service.tracking.model import F64, I64, Bool


@dataclass(frozen=True, slots=True)
class CountedFrame:
    """The part of one frame that is scored: V vehicles, T tracks."""

    vehicles: I64  # (V,) rows of Scene.rows
    tracks: I64  # (T,) rows of RecordedTracks
    distance_m: F64  # (V, T)


@dataclass(frozen=True, slots=True)
class Counted:
    """All frames, and for each vehicle when it was first seen and first tracked (NaN: never)."""

    frames: tuple[CountedFrame, ...]
    vehicle_ids: I64  # (K,) ascending
    vehicle: I64  # (N,) index into vehicle_ids of each row of Scene.rows
    first_detected_s: F64  # (K,) first detection anywhere in view
    first_tracked_s: F64  # (K,) first track within the gate from then on


def count(scene: Scene, tracks: RecordedTracks, rules: ScoringRules) -> Counted:
    """Return what counts in each frame of the scene."""
    rows, region = scene.rows, scene.site.region
    centre = np.stack([rows.x_m, rows.y_m], axis=1)
    face = near_face_centres(rows.x_m, rows.y_m, rows.heading_rad, rows.length_m, rows.width_m)
    inside = _inside(region, rows.x_m, rows.y_m, rules.edge_m, rules.edge_deg)
    point = np.stack([tracks.x_m, tracks.y_m], axis=1)
    point_inside = _inside(region, tracks.x_m, tracks.y_m, 0.0, 0.0)
    ids, vehicle = np.unique(rows.vehicle, return_inverse=True)
    detected = np.full(len(ids), np.nan)
    tracked = np.full(len(ids), np.nan)
    last_seen = np.full(len(ids), -np.inf)
    frames: list[CountedFrame] = []
    for f, time_s in enumerate(scene.time_s):
        here = np.arange(rows.start[f], rows.start[f + 1])
        found = np.arange(tracks.start[f], tracks.start[f + 1])
        who = vehicle[here]
        seen = who[rows.detections[here] > 0]
        last_seen[seen] = time_s
        detected[seen] = np.fmin(detected[seen], time_s)
        distance = segment_distances(face[here], centre[here], point[found])
        near = who[np.any(distance <= rules.gate_m, axis=1) & ~np.isnan(detected[who])]
        tracked[near] = np.fmin(tracked[near], time_s)
        counts = inside[here] & (time_s - last_seen[who] <= rules.remember_s)
        inner = point_inside[found]
        frames.append(_frame(here, found[inner], distance[:, inner], counts, rules))
    return Counted(tuple(frames), ids, vehicle, detected, tracked)


def _frame(here: I64, found: I64, distance: F64, counts: Bool, rules: ScoringRules) -> CountedFrame:
    """Keep the vehicles that count and the tracks that are not on one of the other vehicles."""
    order = np.argsort(~counts, kind="stable")  # vehicles that count first
    counted = int(np.count_nonzero(counts))
    distance = distance[order]
    keep = np.ones(len(found), dtype=np.bool_)
    if distance.size:
        rows, columns = linear_sum_assignment(np.minimum(distance, rules.ignore_reach_m))
        ignored = (rows >= counted) & (distance[rows, columns] <= rules.gate_m)
        keep[columns[ignored]] = False
    return CountedFrame(here[order[:counted]], found[keep], distance[:counted, keep])


def _inside(region: Region, x_m: F64, y_m: F64, edge_m: float, edge_deg: float) -> Bool:
    """Tell which points are inside the region, shrunk by edge_m at both ends and edge_deg at the sides."""
    ground = np.hypot(x_m, y_m)
    azimuth = np.degrees(np.arctan2(x_m, y_m))
    return np.asarray(
        (ground >= region.range_min_m + edge_m)
        & (ground <= region.range_max_m - edge_m)
        & (np.abs(azimuth) <= region.azimuth_max_deg - edge_deg)
    )
