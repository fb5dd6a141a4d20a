"""Boxes that hold two vehicles side by side."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from service.tracking import births, extent, splitting
from service.tracking.boxes import (
    M_COUNT,
    M_SCATTER,
    M_VAR_W,
    MEASUREMENT_COLUMNS,
    PG,
    POINT_COLUMNS,
    PV,
    PVAR_AZ,
    PX,
    PY,
)
from service.tracking.extent import ExtentParameters
from service.tracking.model import TrackStatus
from service.tracking.splitting import SplittingParameters
from service.tracking.state import Tracks, Window, no_tracks

SPEED_MPS, NOW_US = 15.0, 1_000_000


def cars(*x_m, scatter=2.5, hits=60):
    """Return confirmed receding cars at y = 120 m."""
    n, empty = len(x_m), no_tracks(0)
    columns = (getattr(empty, field.name) for field in dataclasses.fields(empty))
    blank = Tracks(*(np.zeros((n, *column.shape[1:]), column.dtype) for column in columns))
    mean = np.zeros((n, 6))
    mean[:, 0], mean[:, 3], mean[:, 4] = x_m, 120.0, SPEED_MPS
    return blank.but(
        mean=mean, cov=np.tile(0.1 * np.eye(6), (n, 1, 1)), scatter=np.full(n, scatter),
        hits=np.full(n, hits),
        status=np.full(n, TrackStatus.CONFIRMED, np.uint8), length_m=np.full(n, 4.4), width_m=np.full(n, 1.9),
    )  # fmt: skip


def window_of(*x_m, points=6, noise_m=1.0, rate_mps=SPEED_MPS, seed=4):
    """Return four frames with points of receding cars at x_m, whose rears are at y = 118 m now."""
    rng, frames = np.random.default_rng(seed), 4
    q, times = [], []
    for k in range(frames):
        age_s = 0.05 * (frames - 1 - k)
        for x in x_m:
            for _ in range(points // 2):
                row = np.zeros(POINT_COLUMNS)
                row[PX], row[PY] = x + rng.normal(0.0, noise_m), 118.0 - SPEED_MPS * age_s
                row[PG], row[PV], row[PVAR_AZ] = np.hypot(row[PX], row[PY]), rate_mps, (noise_m / 118.0) ** 2
                q.append(row)
                times.append(NOW_US - round(age_s * 1e6))
    flags = np.zeros(len(q), dtype=np.bool_)
    return Window(np.array(q), np.array(times), flags, flags)


def test_a_box_between_two_vehicles_becomes_two():
    tracks = cars(0.0)

    apart, rows = splitting.part(tracks, window_of(-1.8, 1.8), NOW_US, SplittingParameters(), length_m=4.4)
    born = births.gather(rows)

    assert sorted([apart.x_m[0], born.x_m[0]]) == pytest.approx([-1.8, 1.8], abs=0.6)
    assert born.y_m[0] == pytest.approx(120.0, abs=0.1)
    assert (born.vx_mps[0], born.vy_mps[0]) == (0.0, SPEED_MPS)
    assert apart.scatter[0] == 1.0  # the doubt is settled
    assert apart.cov[0, 0, 0] > tracks.cov[0, 0, 0]
    np.linalg.cholesky(apart.cov[0])


@pytest.mark.parametrize(
    ("tracks", "window"),
    [
        (cars(0.0), window_of(0.0, 0.0)),  # one vehicle
        (cars(0.0, scatter=1.0), window_of(-1.8, 1.8)),  # no doubt has arisen
        (cars(0.0, hits=59), window_of(-1.8, 1.8)),  # it is looked at each half second
        (cars(0.0, hits=5), window_of(-1.8, 1.8)),  # nor has it had time to
        (cars(-1.8), window_of(-1.8, 1.8)),  # the box is one vehicle's, the other is beside it
        (cars(0.0), window_of(-1.8, 1.8, rate_mps=SPEED_MPS - 2.0)),  # they are others
    ],
)
def test_other_boxes_stay_whole(tracks, window):
    apart, rows = splitting.part(tracks, window, NOW_US, SplittingParameters(), length_m=4.4)

    assert apart is tracks
    assert rows == []


def test_a_box_leaves_a_vehicle_that_has_a_track_of_its_own():
    tracks = cars(0.0, 2.2)

    apart, rows = splitting.part(
        tracks, window_of(-1.8, -1.8, 1.8), NOW_US, SplittingParameters(), length_m=4.4
    )

    assert rows == []
    assert apart.x_m[0] == pytest.approx(-1.8, abs=0.6)


def test_scatter_across_is_remembered():
    track, measured = cars(0.0, scatter=1.0), np.zeros((1, MEASUREMENT_COLUMNS))
    measured[0, [M_COUNT, M_VAR_W, M_SCATTER]] = 1.0, 1.0, 2.6
    yes, no = np.array([True]), np.array([False])

    for _ in range(40):
        track = extent.learn(track, measured, yes, no, np.zeros(1), 0.003, 0.05, ExtentParameters())
    after = extent.learn(track, 0.0 * measured, no, no, np.zeros(1), 0.003, 0.05, ExtentParameters())

    assert track.scatter[0] == pytest.approx(2.6 - 1.6 * 0.95**40)
    assert after.scatter[0] == track.scatter[0]
