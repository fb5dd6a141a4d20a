"""CLEAR MOT: accuracy, precision and identity switches of a sequence.

Source: Bernardin, Stiefelhagen, "Evaluating multiple object tracking performance: the CLEAR MOT metrics",
EURASIP JIVP 2008. A track keeps its vehicle of the frame before while it stays inside the gate, and only then
similarity decides; a switch is counted against the last track a vehicle had, however long ago.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from service.evaluation.sequence import LabelledSequence
from service.tracking.model import F64, I64

_KEEP = 1000.0  # weight of yesterday's partner: more than all similarities of a frame together
_EPSILON = float(np.finfo(np.float64).eps)
_MOSTLY_TRACKED = 0.8  # of a vehicle's frames, more than
_MOSTLY_LOST = 0.2  # of a vehicle's frames, less than


@dataclass(frozen=True, slots=True)
class Clear:
    """CLEAR MOT counts and ratios; `motp` is the mean similarity of the matched pairs."""

    mota: float
    motp: float
    recall: float
    precision: float
    matches: int
    missed: int
    false: int
    id_switches: int
    mostly_tracked: float  # share of the vehicles
    mostly_lost: float


def clear(sequence: LabelledSequence, threshold: float) -> Clear:
    """Return the CLEAR MOT metrics with matches from similarity `threshold` upwards."""
    if sequence.vehicle_count == 0 or sequence.track_count == 0:
        return Clear(0.0, 0.0, 0.0, 0.0, 0, sequence.vehicle_count, sequence.track_count, 0, 0.0, 1.0)
    matched, switches, similarity = _match(sequence, threshold)
    present = np.bincount(np.concatenate(sequence.vehicles), minlength=sequence.vehicle_ids)
    share = matched / present
    hits = int(matched.sum())
    return Clear(
        mota=(hits - (sequence.track_count - hits) - switches) / sequence.vehicle_count,
        motp=similarity / max(1, hits),
        recall=hits / sequence.vehicle_count,
        precision=hits / sequence.track_count,
        matches=hits,
        missed=sequence.vehicle_count - hits,
        false=sequence.track_count - hits,
        id_switches=switches,
        mostly_tracked=float(np.mean(share > _MOSTLY_TRACKED)),
        mostly_lost=float(np.mean(share < _MOSTLY_LOST)),
    )


def _match(sequence: LabelledSequence, threshold: float) -> tuple[I64, int, float]:
    """Return the matched frames of each vehicle, the number of switches and the sum of the similarities."""
    last = np.full(sequence.vehicle_ids, -1)  # the track a vehicle had last, at any time
    before = np.full(sequence.vehicle_ids, -1)  # ... and in the last frame that had both kinds
    matched = np.zeros(sequence.vehicle_ids, dtype=np.int64)
    switches, total = 0, 0.0
    for vehicles, tracks, similarity in zip(
        sequence.vehicles, sequence.tracks, sequence.similarity, strict=True
    ):
        if not len(vehicles) or not len(tracks):
            continue
        rows, columns = keep_partners(before[vehicles], tracks, similarity, threshold)
        v, t = vehicles[rows], tracks[columns]
        switches += int(np.count_nonzero((last[v] >= 0) & (last[v] != t)))
        last[v] = t
        before[:] = -1
        before[v] = t
        matched[v] += 1
        total += float(similarity[rows, columns].sum())
    return matched, switches, total


def keep_partners(before: I64, tracks: I64, similarity: F64, threshold: float) -> tuple[I64, I64]:
    """Return rows and columns of the pairs that keep most partners, and then are most similar."""
    score = _KEEP * (before[:, None] == tracks[None, :]) + similarity
    score[similarity < threshold - _EPSILON] = 0.0
    rows, columns = linear_sum_assignment(-score)
    good = score[rows, columns] > _EPSILON
    return rows[good], columns[good]
