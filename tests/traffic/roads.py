"""Make paths of vehicles along roads of known lanes, with errors such as a tracker's."""

from __future__ import annotations

import numpy as np

from service.traffic.curves import along, at
from service.traffic.evidence import EvidenceParameters, add, no_evidence
from service.traffic.model import Samples, Trajectory
from tests.traffic.tracks import START_US

CORRELATION_S = 0.5  # of a track's lateral error


def straight(angle_deg: float = 0.0, length_m: float = 130.0) -> np.ndarray:
    """The middle of a road that leads away from the radar, turned clockwise."""
    s = np.arange(0.0, length_m + 1.0, 2.0)
    angle = np.radians(angle_deg)
    return np.column_stack([20 * np.sin(angle) + s * np.sin(angle), 20 * np.cos(angle) + s * np.cos(angle)])


def arc(radius_m: float, length_m: float = 130.0) -> np.ndarray:
    """The middle of a road that bends to the right."""
    turn = np.arange(0.0, length_m + 1.0, 2.0) / radius_m
    return np.column_stack([radius_m * (1 - np.cos(turn)), 20 + radius_m * np.sin(turn)])


def s_curve(radius_m: float) -> np.ndarray:
    """The middle of a road that bends to the right and then to the left."""
    heading = np.concatenate([np.linspace(0, 65 / radius_m, 33), np.linspace(65 / radius_m, 0, 33)[1:]])
    return np.column_stack([2 * np.cumsum(np.sin(heading)), 20 + 2 * np.cumsum(np.cos(heading))])


def drive(
    number, middle, right_m, rng, *, sigma_m=0.4, speed_mps=15.0, backwards=False, start_us=START_US
) -> Trajectory:
    """A path `right_m` beside the middle of a road: a number, or one for each of its points."""
    length = along(middle)
    step_s = 0.1
    s = np.arange(0.0, length[-1], speed_mps * step_s)
    keep = np.exp(-step_s / CORRELATION_S)
    error = np.empty(len(s))
    error[0] = rng.normal(0, sigma_m)
    for k in range(1, len(s)):
        error[k] = keep * error[k - 1] + rng.normal(0, sigma_m * np.sqrt(1 - keep**2))
    offset = np.interp(s, length, np.broadcast_to(right_m, len(length)))
    points = at(middle, s, offset + error)
    if backwards:
        points = points[::-1]
    velocity = np.gradient(points, axis=0) / step_s
    f = np.float32
    count = len(points)
    samples = Samples(
        number=np.full(count, number, dtype=np.int64),
        time_us=start_us + (1e6 * step_s * np.arange(count)).astype(np.int64),
        x_m=points[:, 0].astype(f),
        y_m=points[:, 1].astype(f),
        vx_mps=velocity[:, 0].astype(f),
        vy_mps=velocity[:, 1].astype(f),
        lane=np.zeros(count, dtype=np.uint8),
        across_std_m=np.full(count, 0.2, dtype=f),
    )
    return Trajectory(number, samples, 4.5, 1.9, 0.99)


def evidence_of(paths):
    """The evidence that these paths make."""
    evidence = no_evidence()
    for path in paths:
        evidence = add(evidence, path, EvidenceParameters())
    return evidence
