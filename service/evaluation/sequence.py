"""Vehicles, tracks and their similarity frame by frame: what the CLEAR, identity and HOTA metrics read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.tracking.model import F64, I64


@dataclass(frozen=True, slots=True)
class LabelledSequence:
    """F frames; frame f has V_f vehicles and T_f tracks, each labelled by a small integer without gaps."""

    vehicles: tuple[I64, ...]  # (V_f,) labels
    tracks: tuple[I64, ...]  # (T_f,)
    similarity: tuple[F64, ...]  # (V_f, T_f), 1: same place, 0: at the cut-off or beyond
    vehicle_ids: int  # number of labels
    track_ids: int
    vehicle_count: int  # sum of V_f
    track_count: int  # sum of T_f


def labelled(
    vehicles: Sequence[I64], tracks: Sequence[I64], distance_m: Sequence[F64], cutoff_m: float
) -> LabelledSequence:
    """Return the sequence whose similarity is 1 - d / c, never below 0; any integers may label the inputs."""
    vehicle_labels, n_vehicles = _close_gaps(vehicles)
    track_labels, n_tracks = _close_gaps(tracks)
    return LabelledSequence(
        vehicles=vehicle_labels,
        tracks=track_labels,
        similarity=tuple(np.maximum(0.0, 1.0 - d / cutoff_m) for d in distance_m),
        vehicle_ids=n_vehicles,
        track_ids=n_tracks,
        vehicle_count=sum(len(v) for v in vehicle_labels),
        track_count=sum(len(t) for t in track_labels),
    )


def _close_gaps(labels: Sequence[I64]) -> tuple[tuple[I64, ...], int]:
    """Return the labels renumbered 0, 1, ... in their order, split as they came, and how many there are."""
    if not labels:
        return (), 0
    names, index = np.unique(np.concatenate(labels), return_inverse=True)
    ends = np.cumsum([len(part) for part in labels])
    return tuple(np.split(index.astype(np.int64), ends[:-1])), len(names)
