from __future__ import annotations

import dataclasses

import numpy as np

from service.traffic.evidence import EvidenceParameters, add, latest, no_evidence, smooth_path
from tests.traffic.roads import drive, straight


def in_lane(path, lane):
    lanes = np.full(len(path.samples.lane), lane, dtype=np.uint8)
    return dataclasses.replace(path, samples=dataclasses.replace(path.samples, lane=lanes))


def test_the_oldest_path_of_the_fullest_lane_goes_first(rng):
    p = EvidenceParameters(paths=6)
    evidence = no_evidence()
    for number, lane in enumerate([1, 2, 1, 1, 1, 1, 1, 1], start=1):
        evidence = add(evidence, in_lane(drive(number, straight(), 0.0, rng), lane), p)

    assert evidence.paths.tolist() == [2, 4, 5, 6, 7, 8]  # the lonely path of lane 2 is kept
    assert set(evidence.path.tolist()) == {2, 4, 5, 6, 7, 8}
    assert latest(evidence, 2).paths.tolist() == [7, 8]


def test_points_stand_in_equal_steps_whatever_the_speed(rng):
    slow = smooth_path(drive(1, straight(), 0.0, rng, speed_mps=4), EvidenceParameters())
    fast = smooth_path(drive(2, straight(), 0.0, rng, speed_mps=30), EvidenceParameters())

    for points in (slow, fast):
        steps = np.hypot(*np.diff(points, axis=0).T)
        assert steps.min() > 1.8
        assert steps.max() < 2.2


def test_short_paths_tell_nothing(rng):
    path = drive(1, straight(length_m=15.0), 0.0, rng)

    assert len(add(no_evidence(), path, EvidenceParameters()).paths) == 0
