"""The way that a track was seen to creep: proof that what stands there is a vehicle."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from service.tracking import creeping
from service.tracking.boxes import M_COUNT, M_V, MEASUREMENT_COLUMNS
from service.tracking.creeping import CreepingParameters
from service.tracking.state import Tracks, no_tracks

P, DT_S = CreepingParameters(), 0.05


def crept_m(rates_mps, *, hit=True, points=1.0, expected_mps=2.0, dt_s=DT_S):
    """Return how far a track has crept after frames in which its points had these range rates."""
    blank = no_tracks(0)
    columns = (getattr(blank, field.name) for field in dataclasses.fields(blank))
    track = Tracks(*(np.zeros((1, *c.shape[1:]), c.dtype) for c in columns))
    measured = np.zeros((1, MEASUREMENT_COLUMNS))
    measured[0, M_COUNT] = points
    for rate in rates_mps:
        measured[0, M_V] = rate - expected_mps  # told beyond the expected rate
        track = creeping.watch(track, measured, np.array([hit]), np.array([expected_mps]), dt_s, P)
    assert creeping.seen(track, P)[0] == (abs(track.crept_m[0]) >= P.proof_m)
    return float(track.crept_m[0])


def test_who_brakes_to_a_stand_in_view_has_crept():
    braking = np.arange(-12.0, 0.05, 0.1)  # 2 m/s^2
    assert crept_m(braking) == pytest.approx(
        -DT_S * np.arange(0.7, 4.0, 0.1).sum(), abs=0.2
    )  # a little fades


def test_a_box_left_on_a_post_has_not():
    assert crept_m([-10.0] * 40 + [0.0] * 40) == 0.0
    assert abs(crept_m(np.random.default_rng(4).normal(0.0, 0.2, 2000))) < P.proof_m


def test_what_sways_comes_back():
    assert abs(crept_m(1.2 * np.sin(np.arange(2000) * 0.2))) < P.proof_m


def test_swaying_does_not_sum_up_to_a_vehicle():
    rng, t = np.random.default_rng(3), np.arange(12_000) * DT_S  # ten minutes
    sways = sum(
        0.15 * np.cos(2 * math.pi * f * t + rng.uniform(0, 2 * math.pi)) for f in rng.normal(0.5, 0.15, 16)
    )
    assert np.std(sways) == pytest.approx(0.4, abs=0.1)
    assert abs(crept_m(sways + rng.normal(0.0, 0.1, len(t)))) < P.proof_m


def test_proof_does_not_fade():
    assert crept_m([-2.0] * 20 + [0.0] * 2000) == pytest.approx(-1.9, abs=0.3)


def test_one_frame_after_a_gap_proves_nothing():
    assert abs(crept_m([0.8], dt_s=2.0)) < 0.1


def test_who_drives_off_again_has_to_be_seen_to_stop_again():
    away = np.arange(0.0, 12.0, 0.1)
    assert crept_m(away[:35]) > P.proof_m
    assert crept_m(away) == 0.0


def test_silence_and_points_without_a_range_rate_say_nothing():
    assert crept_m([-2.0] * 40, hit=False) == 0.0
    assert crept_m([-2.0] * 40, points=0.0) == 0.0
    assert crept_m([-2.0] * 40 + [math.nan] * 40) == pytest.approx(-4.0, abs=0.3)
