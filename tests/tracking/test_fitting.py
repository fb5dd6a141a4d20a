"""Parameters that follow from the noise that the owner of a radar states."""

from __future__ import annotations

import dataclasses

import pytest

from service.formats.sensor import NoiseStd, SensorConfig
from service.tracking.fitting import fit_to_sensor
from service.tracking.parameters import SensorModel, TrackerParameters


def fitted(**noise):
    return SensorConfig(noise_std=NoiseStd(**noise)).tracker_parameters()


def test_the_noise_of_the_default_or_less_changes_nothing():
    default = TrackerParameters()

    assert fit_to_sensor(default) is default
    fine = fitted(range_m=0.05, azimuth_deg=0.1, azimuth_floor_deg=0.05, velocity_mps=0.03)
    assert dataclasses.replace(fine, sensor=SensorModel()) == default


def test_what_stands_for_the_radar_grows_with_its_noise_and_vehicles_do_not():
    p, default = fitted(range_m=0.3, velocity_mps=0.2), TrackerParameters()

    assert p.clutter.cell_range_m == pytest.approx(2.0 * default.clutter.cell_range_m)
    assert p.clutter.cell_azimuth_rad == default.clutter.cell_azimuth_rad
    assert p.clutter.standing_mps == pytest.approx(2.0 * default.clutter.standing_mps)
    assert p.stood.along_m == pytest.approx(2.0 * default.stood.along_m)
    assert (p.stood.across_m, p.stood.speed_mps) == (default.stood.across_m, default.stood.speed_mps)
    assert p.boxes.doppler_margin_mps == pytest.approx(2.0 * default.boxes.doppler_margin_mps)
    assert p.merging.same_speed_mps == pytest.approx(2.0 * default.merging.same_speed_mps)
    assert (p.birth.length_m, p.clustering) == (default.birth.length_m, default.clustering)
    assert fitted(velocity_mps=5.0).clutter.standing_mps == pytest.approx(3.0 * default.clutter.standing_mps)


def test_a_blurred_gap_is_filled_nearer_to_the_radar():
    rows = TrackerParameters().birth.rows

    assert fitted(azimuth_deg=0.6, azimuth_floor_deg=0.2).birth.rows.leak_range_m == pytest.approx(
        0.5 * rows.leak_range_m
    )


def test_a_setting_of_ones_own_goes_on_top():
    config = SensorConfig(noise_std=NoiseStd(velocity_mps=0.2), parameters={"clutter.standing_mps": "0.6"})

    assert config.tracker_parameters().clutter.standing_mps == 0.6
