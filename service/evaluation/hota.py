"""HOTA: detection and association accuracy at nineteen similarity thresholds.

Source: Luiten, Osep, Dendorfer, Torr, Geiger, Leal-Taixe, Leibe, "HOTA: a higher order metric for evaluating
multi-object tracking", IJCV 129, 2021. One matching per frame serves all thresholds; it favours the pairs
that are aligned over the whole sequence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from service.evaluation.sequence import LabelledSequence
from service.tracking.model import F64, I64

ALPHAS: F64 = np.arange(0.05, 0.99, 0.05)
_EPSILON = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, slots=True)
class Hota:
    """HOTA, detection and association accuracy for each of ALPHAS, (19,) each."""

    hota: F64
    deta: F64
    assa: F64


def hota(sequence: LabelledSequence) -> Hota:
    """Return HOTA = sqrt(DetA AssA) for each threshold."""
    if sequence.vehicle_count == 0 or sequence.track_count == 0:
        zero = np.zeros(len(ALPHAS))
        return Hota(zero, zero.copy(), zero.copy())
    in_frames = _counts(sequence.vehicles, sequence.vehicle_ids)[:, None] + _counts(
        sequence.tracks, sequence.track_ids
    )
    pair, similarity = _match(sequence, _alignment(sequence, in_frames))
    deta, assa = np.empty(len(ALPHAS)), np.empty(len(ALPHAS))
    for a, alpha in enumerate(ALPHAS):
        together = np.bincount(pair[similarity >= alpha - _EPSILON], minlength=in_frames.size)
        hits = int(together.sum())
        deta[a] = hits / (sequence.vehicle_count + sequence.track_count - hits)
        either = np.maximum(1, in_frames.ravel() - together)
        assa[a] = np.sum(together * (together / either)) / max(1, hits)
    return Hota(np.sqrt(deta * assa), deta, assa)


def _counts(labels: tuple[I64, ...], ids: int) -> I64:
    """Return in how many frames each id is present."""
    return np.bincount(np.concatenate(labels), minlength=ids)


def _alignment(sequence: LabelledSequence, in_frames: I64) -> F64:
    """Return the soft Jaccard index of each vehicle with each track over the whole sequence, (V, T)."""
    together = np.zeros(in_frames.shape)
    for vehicles, tracks, similarity in zip(
        sequence.vehicles, sequence.tracks, sequence.similarity, strict=True
    ):
        either = similarity.sum(axis=0)[None, :] + similarity.sum(axis=1)[:, None] - similarity
        share = np.divide(similarity, either, out=np.zeros_like(similarity), where=either > _EPSILON)
        together[vehicles[:, None], tracks[None, :]] += share
    return np.asarray(together / (in_frames - together), dtype=np.float64)


def _match(sequence: LabelledSequence, alignment: F64) -> tuple[I64, F64]:
    """Return the pairs of all frames, as flat indices of (V, T), and their similarities."""
    pairs: list[I64] = [np.empty(0, dtype=np.int64)]
    values: list[F64] = [np.empty(0)]
    for vehicles, tracks, similarity in zip(
        sequence.vehicles, sequence.tracks, sequence.similarity, strict=True
    ):
        if not len(vehicles) or not len(tracks):
            continue
        score = alignment[vehicles[:, None], tracks[None, :]] * similarity
        rows, columns = linear_sum_assignment(-score)
        pairs.append(vehicles[rows] * sequence.track_ids + tracks[columns])
        values.append(similarity[rows, columns])
    return np.concatenate(pairs), np.concatenate(values)
