"""Fit the parameters that stand for the radar to the noise that its owner states.

The defaults are those of a radar with 0.15 m, 0.3 deg and 0.10 m/s. Where a value is a number of standard
deviations of that radar, a coarser radar's is as many of its own; what stands for vehicles and roads stays.
A finer radar keeps the defaults: smaller ones gained nothing, because posts and vehicles have sizes of their
own.
"""

from __future__ import annotations

import math
from dataclasses import replace

from service.tracking.parameters import SensorModel, TrackerParameters

MOST = 3.0  # times the default


def fit_to_sensor(p: TrackerParameters) -> TrackerParameters:
    """Return the parameters for the noise of `p.sensor`; with the default's or less nothing changes."""
    known, here = SensorModel(), p.sensor
    in_range = _times(here.range_std_m, known.range_std_m)
    in_azimuth = _times(
        math.hypot(here.azimuth_std_rad, here.azimuth_floor_rad),
        math.hypot(known.azimuth_std_rad, known.azimuth_floor_rad),
    )
    in_rate = _times(here.velocity_std_mps, known.velocity_std_mps)
    if in_range == in_azimuth == in_rate == 1.0:
        return p
    return replace(
        p,
        clutter=replace(
            p.clutter,
            cell_range_m=p.clutter.cell_range_m * in_range,
            cell_azimuth_rad=p.clutter.cell_azimuth_rad * in_azimuth,
            standing_mps=p.clutter.standing_mps * in_rate,
        ),
        boxes=replace(p.boxes, doppler_margin_mps=p.boxes.doppler_margin_mps * in_rate),
        extent=replace(p.extent, still_range_rate_mps=p.extent.still_range_rate_mps * in_rate),
        stood=replace(p.stood, along_m=p.stood.along_m * in_range),
        creeping=replace(p.creeping, from_mps=p.creeping.from_mps * in_rate),
        birth=replace(
            p.birth,
            keep_out_like_mps=p.birth.keep_out_like_mps * in_rate,
            radial_std_mps=p.birth.radial_std_mps * in_rate,
            rows=replace(p.birth.rows, leak_range_m=p.birth.rows.leak_range_m / in_azimuth),
        ),
        merging=replace(
            p.merging,
            same_speed_mps=p.merging.same_speed_mps * in_rate,
            piece_dv_mps=p.merging.piece_dv_mps * in_rate,
        ),
        tandem=replace(p.tandem, like_mps=p.tandem.like_mps * in_rate),
    )


def _times(here: float, known: float) -> float:
    return min(max(here / known, 1.0), MOST)
