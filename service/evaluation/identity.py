"""Identity metrics: how much of each vehicle one single track follows.

Source: Ristani, Solera, Zou, Cucchiara, Tomasi, "Performance measures and a data set for multi-target,
multi-camera tracking", ECCV Workshops 2016. The pairing of vehicles and tracks that minimises wrong
identities also maximises the frames in which the paired ones are together, so one assignment on those counts
gives IDTP.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from service.evaluation.sequence import LabelledSequence


@dataclass(frozen=True, slots=True)
class Identity:
    """IDF1 with its precision and recall."""

    idf1: float
    precision: float
    recall: float


def identity(sequence: LabelledSequence, threshold: float) -> Identity:
    """Return the identity metrics with matches from similarity `threshold` upwards."""
    if sequence.vehicle_count == 0 or sequence.track_count == 0:
        return Identity(0.0, 0.0, 0.0)
    together = np.zeros((sequence.vehicle_ids, sequence.track_ids))
    for vehicles, tracks, similarity in zip(
        sequence.vehicles, sequence.tracks, sequence.similarity, strict=True
    ):
        rows, columns = np.nonzero(similarity >= threshold)
        together[vehicles[rows], tracks[columns]] += 1
    frames = float(together[linear_sum_assignment(together, maximize=True)].sum())
    return Identity(
        idf1=2 * frames / (sequence.vehicle_count + sequence.track_count),
        precision=frames / sequence.track_count,
        recall=frames / sequence.vehicle_count,
    )
