"""Match tracks to vehicles frame by frame and measure errors, latency, false tracks and fragments.

The partner of the frame before is kept while it is inside the gate; else the nearest pairs are matched.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from service.evaluation.counted import Counted, CountedFrame
from service.evaluation.recorded import RecordedTracks
from service.evaluation.rules import ScoringRules
from service.evaluation.truth import Scene
from service.tracking.model import F64, I64

_NEVER, _HELD, _LOST = 0, 1, 2  # what became of a vehicle so far
_OUTSIDE_M = 1000.0  # cost of a pair beyond the gate
_KEEP_M = 500.0  # bonus of the last partner
_LATE_PERCENTILE = 90


@dataclass(frozen=True, slots=True)
class Matches:
    """All M matched pairs of a sequence, in the order of time."""

    frame: I64  # (M,) index of the frame
    row: I64  # (M,) row of Scene.rows
    state: I64  # (M,) row of RecordedTracks
    distance_m: F64  # (M,)
    fragmentations: int  # vehicles that were matched, then not, then matched again


def match(counted: Counted, tracks: RecordedTracks, rules: ScoringRules) -> Matches:
    """Return the pairs of every frame."""
    partner = np.full(len(counted.vehicle_ids), -1)
    life = np.full(len(counted.vehicle_ids), _NEVER)
    fragmentations = 0
    index: list[I64] = []
    rows: list[I64] = []
    states: list[I64] = []
    distances: list[F64] = []
    for f, frame in enumerate(counted.frames):
        who = counted.vehicle[frame.vehicles]
        a, b = _pairs(frame, partner[who], tracks.track[frame.tracks], rules.gate_m)
        matched = who[a]
        fragmentations += int(np.count_nonzero(life[matched] == _LOST))
        life[who[life[who] == _HELD]] = _LOST
        life[matched] = _HELD
        partner[matched] = tracks.track[frame.tracks[b]]
        index.append(np.full(len(a), f, dtype=np.int64))
        rows.append(frame.vehicles[a])
        states.append(frame.tracks[b])
        distances.append(frame.distance_m[a, b])
    return Matches(
        np.concatenate(index),
        np.concatenate(rows),
        np.concatenate(states),
        np.concatenate(distances),
        fragmentations,
    )


def _pairs(frame: CountedFrame, partner: I64, track: I64, gate_m: float) -> tuple[I64, I64]:
    """Return vehicles and tracks (places in the frame) that are matched."""
    if not frame.distance_m.size:
        none = np.empty(0, dtype=np.int64)
        return none, none
    near = frame.distance_m <= gate_m
    cost = np.where(near, frame.distance_m, _OUTSIDE_M)
    cost[near & (partner[:, None] == track[None, :])] -= _KEEP_M
    a, b = linear_sum_assignment(cost)
    good = near[a, b]
    return a[good], b[good]


def errors(scene: Scene, tracks: RecordedTracks, matches: Matches) -> dict[str, float]:
    """Return position, velocity, speed and length errors of the matched pairs (NaN when there are none)."""
    rows, r, s = scene.rows, matches.row, matches.state
    dx, dy = tracks.x_m[s] - rows.x_m[r], tracks.y_m[s] - rows.y_m[r]
    sin, cos = np.sin(rows.heading_rad[r]), np.cos(rows.heading_rad[r])
    along = dx * sin + dy * cos
    velocity = np.hypot(tracks.vx_mps[s] - rows.vx_mps[r], tracks.vy_mps[s] - rows.vy_mps[r])
    length = np.abs(tracks.length_m[s] - rows.length_m[r])
    speed = np.hypot(tracks.vx_mps[s], tracks.vy_mps[s]) - np.hypot(rows.vx_mps[r], rows.vy_mps[r])
    return {
        "pos_rmse_m": _rms(matches.distance_m),
        "centre_rmse_m": _rms(np.hypot(dx, dy)),
        "lateral_rmse_m": _rms(dx * cos - dy * sin),
        "along_bias_m": mean(along),
        "along_std_m": float(np.std(along)) if len(along) else math.nan,
        "vel_rmse_mps": _rms(velocity),
        "speed_mae_mps": mean(np.abs(speed)),
        "length_mae_m": mean(length[~np.isnan(length)]),
    }


def identities(
    scene: Scene, tracks: RecordedTracks, counted: Counted, matches: Matches, rules: ScoringRules
) -> dict[str, float | int]:
    """Return false tracks, fragments and vehicles without a track."""
    kept = np.concatenate([tracks.track[frame.tracks] for frame in counted.frames])
    life = np.bincount(kept, minlength=len(tracks.ids))
    hits = np.bincount(tracks.track[matches.state], minlength=len(tracks.ids))
    false = int(np.count_nonzero((life >= rules.false_frames) & (hits < rules.false_share * life)))
    vehicle = counted.vehicle[matches.row]
    tracked = len(np.unique(vehicle))
    pairs = len(np.unique(vehicle * max(1, len(tracks.ids)) + tracks.track[matches.state]))
    vehicles = len(counted_vehicles(counted))
    return {
        "fragmentations": matches.fragmentations,
        "false_tracks_per_min": false / minutes(scene),
        "false_tracks": false,
        "track_ids": int(np.count_nonzero(life)),
        "vehicles": vehicles,
        "never_tracked": vehicles - tracked,
        "ids_per_vehicle": pairs / tracked if tracked else math.nan,
    }


def latency(scene: Scene, counted: Counted, rules: ScoringRules) -> dict[str, float]:
    """Return median and 90th percentile of first detection to first track, of vehicles that came later."""
    who = counted_vehicles(counted)
    born, met = counted.first_detected_s[who], counted.first_tracked_s[who]
    delay = (met - born)[born > scene.time_s[0] + rules.latency_skip_s]
    delay = delay[~np.isnan(delay)]
    late = np.percentile(delay, _LATE_PERCENTILE) if len(delay) else math.nan
    return {
        "latency_median_s": float(np.median(delay)) if len(delay) else math.nan,
        "latency_p90_s": float(late),
    }


def counted_vehicles(counted: Counted) -> I64:
    """Return the vehicles (indices into vehicle_ids) that count in at least one frame."""
    rows = np.concatenate([frame.vehicles for frame in counted.frames])
    return np.unique(counted.vehicle[rows])


def minutes(scene: Scene) -> float:
    """Return the length of the scene in minutes, never zero."""
    return float(scene.time_s[-1] - scene.time_s[0]) / 60 + 1e-9


def mean(values: F64) -> float:
    """Return the mean, NaN of nothing."""
    return float(np.mean(values)) if len(values) else math.nan


def _rms(values: F64) -> float:
    return math.sqrt(float(np.mean(np.square(values)))) if len(values) else math.nan
