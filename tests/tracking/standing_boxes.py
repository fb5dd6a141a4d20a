"""Boxes of tracks that stand, and what becomes of them on given points."""

from __future__ import annotations

import dataclasses

import numpy as np

from service.tracking import births
from service.tracking.births import BirthParameters
from service.tracking.model import TrackStatus
from service.tracking.moved_boxes import RearrangingParameters
from service.tracking.rearranging import rearrange
from service.tracking.state import Tracks, no_tracks
from tests.tracking.standing_points import FRAMES

ACROSS_RAD = np.pi / 2


def boxes(*places, heading_rad=ACROSS_RAD, length_m=4.4, **columns):
    """Return confirmed tracks that have stood at places (x, y) since they were born, numbered from 5."""
    n, empty = len(places), no_tracks(0)
    blank = Tracks(
        *(
            np.zeros((n, *column.shape[1:]), column.dtype)
            for column in (getattr(empty, field.name) for field in dataclasses.fields(empty))
        )
    )
    x, y = np.array(places, dtype=np.float64).reshape(-1, 2).T.copy()
    mean = np.zeros((n, 6))
    mean[:, 0], mean[:, 3] = x, y
    given = {
        "mean": mean, "cov": np.tile(0.1 * np.eye(6), (n, 1, 1)), "number": 5 + np.arange(n),
        "hits": np.full(n, 100), "status": np.full(n, TrackStatus.CONFIRMED, np.uint8),
        "heading_rad": np.full(n, heading_rad), "length_m": np.full(n, length_m),
        "width_m": np.full(n, 1.9), "born_x_m": x, "born_y_m": y, "extent_m": np.full((n, 30), 5.0),
    }  # fmt: skip
    return blank.but(**(given | columns))


def put_right(tracks, points, parameters=None):
    nowhere, p = np.zeros(len(points), np.bool_), parameters or RearrangingParameters()
    after, rows = rearrange(tracks, points, FRAMES, nowhere, np.zeros(len(points)), BirthParameters(), p)
    return after, births.gather(rows)
