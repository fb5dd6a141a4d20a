"""Score a tracker's output on a scene with truth: one dictionary of named numbers.

Keys are stable; values are numbers, except `scene`, `flow_source` (text) and `lane_count_exact` (a truth
value). A number that could not be measured is NaN.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from service.errors import InvalidInput
from service.evaluation import kinematics
from service.evaluation.clear import clear
from service.evaluation.counted import Counted, count
from service.evaluation.crossings import crossings_of, score_crossings
from service.evaluation.gospa import gospa, ospa
from service.evaluation.hota import hota
from service.evaluation.identity import identity
from service.evaluation.lanes import score_changes, score_lanes
from service.evaluation.recorded import (
    FoundChange,
    FoundCrossing,
    FoundLane,
    RecordedTracks,
    TrackId,
    read_changes,
    read_crossings,
    read_lanes,
    read_tracks,
)
from service.evaluation.rules import RULES, ScoringRules
from service.evaluation.sequence import labelled
from service.evaluation.truth import Scene, read_scene

Scores = dict[str, float | int | str]


def evaluate(tracks_dir: Path, truth_dir: Path, until: float | None = None) -> Scores:
    """Score a directory that `wayside track` wrote; raises InvalidInput.

    Read are tracks.jsonl and, where present, track_summaries.jsonl (lengths), crossings.jsonl, lanes.json and
    changes.jsonl, each also as .gz.
    """
    tracks = _present(tracks_dir, "tracks.jsonl")
    if tracks is None:
        raise InvalidInput(f"{tracks_dir}: there is no tracks.jsonl or tracks.jsonl.gz")
    return score_scene(
        truth_dir,
        tracks,
        summaries=_present(tracks_dir, "track_summaries.jsonl"),
        flow=_present(tracks_dir, "crossings.jsonl"),
        lanes=_present(tracks_dir, "lanes.json"),
        changes=_present(tracks_dir, "changes.jsonl"),
        until=until,
    )


def score_scene(  # noqa: PLR0913 - one optional file a keyword
    scene_dir: Path,
    tracks: Path,
    *,
    summaries: Path | None = None,
    flow: Path | None = None,
    lanes: Path | None = None,
    changes: Path | None = None,
    until: float | None = None,
) -> Scores:
    """Score files against a scene's directory, or only its first `until` seconds; raises InvalidInput."""
    scene = read_scene(scene_dir)
    if until is not None:
        scene = scene.until(until)
    return score(
        scene,
        read_tracks(tracks, scene, summaries),
        crossings=None if flow is None else read_crossings(flow, scene),
        lanes=None if lanes is None else read_lanes(lanes),
        changes=None if changes is None else read_changes(changes, scene),
    )


def score(  # noqa: PLR0913 - one optional output a keyword
    scene: Scene,
    tracks: RecordedTracks,
    *,
    crossings: Sequence[FoundCrossing] | None = None,
    lanes: Sequence[FoundLane] | None = None,
    changes: Sequence[FoundChange] | None = None,
    rules: ScoringRules = RULES,
) -> Scores:
    """Score tracks, and the other outputs where given. Without crossings they are derived from the tracks."""
    counted = count(scene, tracks, rules)
    matches = kinematics.match(counted, tracks, rules)
    scores: Scores = {"frames": len(counted.frames), "minutes": kinematics.minutes(scene)}
    scores |= _set_distances(counted, rules)
    scores |= _label_metrics(scene, tracks, counted, rules)
    scores |= kinematics.identities(scene, tracks, counted, matches, rules)
    scores |= kinematics.errors(scene, tracks, matches)
    scores |= kinematics.latency(scene, counted, rules)
    scores["scene"] = scene.name
    partner: dict[TrackId, str] = {}
    if lanes is not None:
        lane_scores, partner = score_lanes(scene, lanes, rules)
        scores |= lane_scores
    scores["flow_source"] = "tracker" if crossings is not None else "derived from the tracks"
    found = crossings if crossings is not None else crossings_of(scene, tracks, rules)
    scores |= score_crossings(scene, found, partner, rules)
    if changes is not None:
        scores |= score_changes(scene, changes, tracks, matches, rules)
    return scores


def _set_distances(counted: Counted, rules: ScoringRules) -> Scores:
    """Return GOSPA and OSPA, averaged over the frames."""
    parts = [gospa(frame.distance_m, rules.cutoff_m, rules.order) for frame in counted.frames]
    ospas = [ospa(frame.distance_m, rules.cutoff_m, rules.order) for frame in counted.frames]
    return {
        "gospa": float(np.mean([part.distance_m for part in parts])),
        "gospa_loc": float(np.mean([part.localisation ** (1 / rules.order) for part in parts])),
        "gospa_missed": float(np.mean([part.missed for part in parts])),
        "gospa_false": float(np.mean([part.false for part in parts])),
        "ospa": float(np.mean([part.distance_m for part in ospas])),
        "truth_per_frame": float(np.mean([len(frame.vehicles) for frame in counted.frames])),
        "tracks_per_frame": float(np.mean([len(frame.tracks) for frame in counted.frames])),
    }


def _label_metrics(scene: Scene, tracks: RecordedTracks, counted: Counted, rules: ScoringRules) -> Scores:
    """Return CLEAR MOT, IDF1 and HOTA; `motp_m` in metres, the cut-off when nothing matched."""
    sequence = labelled(
        [scene.rows.vehicle[frame.vehicles] for frame in counted.frames],
        [tracks.track[frame.tracks] for frame in counted.frames],
        [frame.distance_m for frame in counted.frames],
        rules.cutoff_m,
    )
    threshold = 1 - rules.gate_m / rules.cutoff_m
    mot = clear(sequence, threshold)
    higher = hota(sequence)
    return {
        "mota": mot.mota,
        "motp_m": (1 - mot.motp) * rules.cutoff_m,
        "recall": mot.recall,
        "precision": mot.precision,
        "id_switches": mot.id_switches,
        "mostly_tracked": mot.mostly_tracked,
        "mostly_lost": mot.mostly_lost,
        "idf1": identity(sequence, threshold).idf1,
        "hota": float(np.mean(higher.hota)),
        "deta": float(np.mean(higher.deta)),
        "assa": float(np.mean(higher.assa)),
    }


def _present(directory: Path, name: str) -> Path | None:
    return next((p for p in (directory / name, directory / f"{name}.gz") if p.is_file()), None)
