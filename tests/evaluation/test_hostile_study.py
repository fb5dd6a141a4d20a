"""Hostile scans and what is counted of them; `python -m benchmarks.filter_bars` runs 100,000 each."""

import dataclasses

import numpy as np
import pytest

from service.evaluation.hostile_study import endure
from service.tracking.filters.ekf import Ekf
from service.tracking.filters.registry import filter_names, make_filter


@pytest.mark.parametrize("name", filter_names())
def test_every_filter_stays_sound_under_hostile_scans(name):
    found = endure(make_filter(name), 4_000, 3)

    assert found.scans >= 4_000
    assert found.sound, found
    assert found.least_eigenvalue > 0.0


def test_a_track_that_ran_away_under_an_undamped_acceleration_stays_sound():
    # without a bound on what fading makes of a covariance, 32 of these scans lost its definiteness
    assert endure(make_filter("astekf-paper"), 12_000, 207).sound


def test_tracks_over_the_radar_keep_their_covariance_definite():
    # rounding made four of these scans indefinite (least eigenvalue of a correlation -0.0008)
    assert endure(make_filter("ekf"), 100_000, 61).sound


@dataclasses.dataclass(frozen=True)
class Broken(Ekf):
    """A filter that subtracts where it should not, now and then."""

    def update(self, prediction, z, R, beta, miss):
        state = super().update(prediction, z, R, beta, miss)
        cov, mean = state.cov.copy(), state.mean.copy()
        cov[0, 0, 0] = -1.0
        cov[1, 0, 1] += 1.0
        mean[2, 0] = np.nan
        return dataclasses.replace(state, mean=mean, cov=cov)


def test_what_breaks_is_counted():
    found = endure(Broken(), 640, 3)

    assert (found.not_finite, found.not_symmetric, found.not_definite) == (10, 10, 20)
    assert not found.sound
