"""The simulated radar obeys the conventions and the physics that it claims."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from service.simulation.ghosts import GhostParameters
from service.simulation.radar import Observation, Radar, RadarParameters
from service.simulation.resolution import Echoes, Resolution, detection_probability, merge_cells
from service.simulation.roads import one_way
from service.simulation.scatterers import draw_scatterers
from service.simulation.scenery import Scenery, draw_scenery
from service.simulation.shadowing import ShadowParameters, shadow_loss_db
from service.simulation.vehicles import VehicleKind, VehicleStates

DT_S = 0.05
QUIET = RadarParameters(false_alarms=0.0, ghost=GhostParameters(rate_per_s=0.0))
SIZES = {
    VehicleKind.CAR: (4.5, 1.8, 1.6),
    VehicleKind.TRUCK: (12.0, 2.5, 3.6),
    VehicleKind.BUS: (12.0, 2.5, 3.2),
    VehicleKind.MOTORCYCLE: (2.2, 0.8, 1.5),
}

Row = tuple[VehicleKind, float, float, float]


def vehicles(*rows: Row) -> VehicleStates:
    """Return vehicles from kind, x, y and vy; all face the way they drive, or the radar when they stand."""
    kind = np.array([r[0] for r in rows], dtype=np.uint8)
    x, y, vy = np.array([r[1:] for r in rows], dtype=np.float64).T
    length, width, height = np.array([SIZES[r[0]] for r in rows]).T
    heading = np.where(vy > 0, 0.0, np.pi)
    ids = np.arange(1, len(rows) + 1)
    return VehicleStates(ids, kind, x, y, 0 * vy, vy, heading, length, width, height, 0 * ids)


def watch(
    seen: VehicleStates, frames: int, *, seed: int = 1, parameters: RadarParameters = QUIET
) -> list[Observation]:
    """Return the frames of several vehicles held where they are."""
    radar = Radar(parameters, Scenery.empty(), np.random.default_rng(seed))
    return [radar.observe(seen, DT_S) for _ in range(frames)]


def mean_points(seen: VehicleStates, *, frames: int = 5, seeds: int = 30) -> np.ndarray:
    return np.mean([[o.points for o in watch(seen, frames, seed=s)] for s in range(seeds)], axis=(0, 1))


def column(observations: list[Observation], name: str) -> np.ndarray:
    return np.concatenate([getattr(o, name) for o in observations])


def test_an_approaching_vehicle_has_a_negative_range_rate():
    seen = watch(vehicles((VehicleKind.CAR, 0.0, 60.0, -15.0)), 40)

    # wheels are smeared to between 0.1 and 1.9 times the speed
    assert np.all(column(seen, "radial_velocity_mps") < 0.0)
    assert np.median(column(seen, "radial_velocity_mps")) == pytest.approx(-15.0, abs=0.2)


def test_a_receding_vehicle_has_a_positive_range_rate():
    seen = watch(vehicles((VehicleKind.CAR, 0.0, 60.0, 15.0)), 40)

    assert np.median(column(seen, "radial_velocity_mps")) == pytest.approx(15.0, abs=0.2)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_azimuth_is_positive_to_the_right(side):
    seen = watch(vehicles((VehicleKind.CAR, side * 10.0, 60.0, -15.0)), 40)

    assert np.median(column(seen, "azimuth_rad")) == pytest.approx(side * math.atan2(10.0, 58.0), abs=0.015)


def test_range_is_slant_and_from_the_near_face():
    high = dataclasses.replace(QUIET, mount_height_m=20.0, tilt_rad=math.radians(25.0))
    seen = watch(vehicles((VehicleKind.CAR, 0.0, 40.0, -10.0)), 60, parameters=high)
    nearest = np.array([o.range_m.min() for o in seen if len(o.range_m)])

    # near face at 37.75 m on the ground, its plates at 0.55 m: sqrt(37.75^2 + 19.45^2) = 42.47 m
    assert np.median(nearest) == pytest.approx(42.47, abs=0.3)


def test_a_standing_vehicle_has_no_doppler():
    seen = watch(vehicles((VehicleKind.CAR, 2.0, 50.0, 0.0)), 60)

    assert len(column(seen, "range_m")) > 100
    assert abs(np.mean(column(seen, "radial_velocity_mps"))) < 0.02
    assert np.std(column(seen, "radial_velocity_mps")) < 0.3


def test_a_car_behind_a_truck_gives_far_fewer_points_than_alone():
    alone = mean_points(vehicles((VehicleKind.CAR, 0.0, 85.0, -15.0)))
    behind = mean_points(vehicles((VehicleKind.CAR, 0.0, 85.0, -15.0), (VehicleKind.TRUCK, 0.0, 68.0, -15.0)))

    assert behind[0] < 0.5 * alone[0]


def test_a_vehicle_in_the_next_lane_at_the_same_range_casts_no_shadow():
    alone = watch(vehicles((VehicleKind.CAR, 0.0, 85.0, -15.0)), 1)[0]
    beside = watch(vehicles((VehicleKind.CAR, 0.0, 85.0, -15.0), (VehicleKind.TRUCK, 3.5, 85.0, -15.0)), 1)[0]

    assert alone.visible[0] == beside.visible[0] == 1.0


def test_shadow_falls_only_below_the_line_over_the_roof():
    truck = vehicles((VehicleKind.TRUCK, 0.0, 50.0, -15.0))
    # the ray over the truck's far edge: 56 m away, 3.6 * 0.95 = 3.42 m high, from 6 m
    edge = (6.0 - 3.42) / (56.0 - 6 * 0.03)
    y = np.full(2, 80.0)
    z = 6.0 - edge * 80.0 + np.array([-0.3, 0.3])
    loss = shadow_loss_db(
        truck, np.zeros(2), y, z, np.full(2, -1), radar_height_m=6.0, parameters=ShadowParameters()
    )

    assert loss[0] > 6.0
    assert loss[1] == 0.0


def test_a_vehicle_does_not_shadow_itself_nor_what_is_nearer():
    truck = vehicles((VehicleKind.TRUCK, 0.0, 50.0, -15.0))
    place = {"x_m": np.zeros(2), "y_m": np.array([56.0, 30.0]), "z_m": np.full(2, 0.5)}
    loss = shadow_loss_db(
        truck, **place, owner=np.array([0, -1]), radar_height_m=6.0, parameters=ShadowParameters()
    )

    assert loss.tolist() == [0.0, 0.0]


def test_points_fall_with_range_and_with_size():
    far = [mean_points(vehicles((VehicleKind.CAR, 0.0, y, -15.0)))[0] for y in (30.0, 70.0, 140.0)]
    truck, motorcycle = (
        mean_points(vehicles((k, 0.0, 70.0, -15.0)))[0] for k in (VehicleKind.TRUCK, VehicleKind.MOTORCYCLE)
    )

    assert far[0] > far[1] > far[2]
    assert truck > far[1] > motorcycle


def test_snr_falls_with_the_fourth_power_of_range():
    radar = Radar(QUIET, Scenery.empty(), np.random.default_rng(1))
    ground = np.array([60.0, 120.0])
    slant = np.hypot(ground, 5.0)
    below = np.degrees(np.arctan2(5.0, ground)) - 4.0
    pattern = 24 * (below / 16.0) ** 2
    snr = radar._snr_db(np.zeros(2), np.zeros(2), ground, 1.0)

    assert np.diff(snr + pattern)[0] == pytest.approx(-40 * np.log10(slant[1] / slant[0]), abs=1e-9)
    assert snr[0] == pytest.approx(19.0 - 40 * np.log10(slant[0] / 100.0) - pattern[0], abs=1e-9)


def test_noise_grows_as_snr_falls():
    post = Scenery(np.zeros(1), np.array([100.0]), np.zeros(1), np.zeros(1, np.bool_))
    spread = {}
    for level in (-2.0, 20.0):
        standing = dataclasses.replace(post, rcs_dbsm=np.array([level]))
        radar = Radar(QUIET, standing, np.random.default_rng(3))
        nobody = vehicles((VehicleKind.CAR, 0.0, 400.0, -1.0))
        seen = [radar.observe(nobody, DT_S) for _ in range(400)]
        spread[level] = np.std(column(seen, "azimuth_rad"))

    # at 39 dB the floor of 0.1 deg, at 17 dB hypot(0.1, 0.3 * 10^(3 / 20)); 400 values: 3.5 % standard error
    assert np.degrees(spread[20.0]) == pytest.approx(0.105, rel=0.15)
    assert np.degrees(spread[-2.0]) == pytest.approx(0.44, rel=0.2)


def test_azimuth_bias_shifts_every_detection():
    biased = dataclasses.replace(QUIET, azimuth_bias_rad=math.radians(2.0))
    plain = column(watch(vehicles((VehicleKind.CAR, 0.0, 50.0, -10.0)), 20), "azimuth_rad")
    shifted = column(
        watch(vehicles((VehicleKind.CAR, 0.0, 50.0, -10.0)), 20, parameters=biased), "azimuth_rad"
    )

    assert np.allclose(shifted - plain, math.radians(2.0), atol=1e-12)


def test_false_alarms_come_at_the_asked_rate():
    noisy = dataclasses.replace(QUIET, false_alarms=14.0)
    seen = watch(vehicles((VehicleKind.CAR, 0.0, 400.0, -1.0)), 400, parameters=noisy)
    count = np.array([len(o.source) for o in seen])

    assert np.all(column(seen, "source") == -1)
    # 5,600 expected: four standard errors of the mean are 0.75
    assert count.mean() == pytest.approx(14.0, abs=0.75)


def test_ghosts_live_about_six_tenths_of_a_second():
    haunted = dataclasses.replace(QUIET, ghost=GhostParameters(rate_per_s=2.0))
    rng = np.random.default_rng(4)
    radar = Radar(haunted, draw_scenery(one_way(3, approaching=True), rng), rng)
    seen = vehicles(*[(VehicleKind.CAR, 0.0, 30.0 + 8.0 * i, -10.0) for i in range(12)])
    alive = []
    ghosts = 0
    for _ in range(300):
        ghosts += int(np.sum(radar.observe(seen, DT_S).source == -2))
        alive.append(radar._bank.ghosts.ravel().copy())
    states = np.array(alive)
    born = np.sum(states[1:] & ~states[:-1])

    # about 340 lives: four standard errors of the mean are 22 % of it
    assert states.sum() * DT_S / born == pytest.approx(0.6, rel=0.22)
    assert ghosts > 300


def test_sources_count_the_points_of_each_vehicle():
    seen = watch(vehicles((VehicleKind.CAR, -4.0, 40.0, -15.0), (VehicleKind.TRUCK, 4.0, 60.0, -15.0)), 20)

    for o in seen:
        assert o.points.tolist() == [np.sum(o.source == 1), np.sum(o.source == 2)]
        assert np.all(np.diff(o.range_m) >= 0)


def test_vehicles_out_of_range_or_behind_give_nothing():
    rows = [(VehicleKind.TRUCK, 0.0, y, -15.0) for y in (10.0, 200.0, -30.0)]
    seen = watch(vehicles(*rows), 30)

    assert len(column(seen, "range_m")) == 0


def echoes(*rows: tuple[float, float, float, float, int]) -> Echoes:
    r, azimuth_deg, rate, power, source = np.array(rows, dtype=np.float64).T
    return Echoes(r, np.radians(azimuth_deg), rate, power, source.astype(np.int64))


CELL = Resolution(0.75, 0.25, math.radians(1.5), 0.01)


def test_two_echoes_of_one_cell_merge_at_their_weighted_mean():
    merged = merge_cells(echoes((30.1, 1.0, 5.0, 300.0, 1), (30.3, 2.0, 5.05, 100.0, 2)), CELL)

    assert len(merged) == 1
    assert np.degrees(merged.azimuth_rad[0]) == pytest.approx(1.25)
    assert merged.range_m[0] == pytest.approx(30.15)
    assert merged.power[0] == pytest.approx(400.0)
    assert merged.source[0] == 1


@pytest.mark.parametrize("other", [(31.0, 1.0, 5.0), (30.1, 2.6, 5.0), (30.1, 1.0, 5.5)])
def test_echoes_apart_in_range_azimuth_or_doppler_stay_apart(other):
    merged = merge_cells(echoes((30.1, 1.0, 5.0, 300.0, 1), (*other, 100.0, 2)), CELL)

    assert sorted(merged.source.tolist()) == [1, 2]


def test_an_echo_under_the_side_lobes_of_its_cell_is_lost():
    rows = echoes((30.1, 1.0, 5.0, 1e5, 1), (30.1, 8.0, 5.0, 900.0, 2), (30.1, -8.0, 5.0, 1100.0, 3))

    assert sorted(merge_cells(rows, CELL).source.tolist()) == [1, 3]


def test_merging_agrees_with_a_plain_loop():
    rng = np.random.default_rng(8)
    n = 300
    rows = Echoes(
        rng.uniform(30, 36, n),
        rng.uniform(-0.3, 0.3, n),
        rng.uniform(-1, 1, n),
        rng.gamma(2.0, 50.0, n),
        rng.integers(1, 9, n),
    )
    merged = merge_cells(rows, dataclasses.replace(CELL, sidelobe=0.0))
    groups = 0
    cells: dict[tuple[float, float], list[float]] = {}
    for r, azimuth, rate in zip(rows.range_m, rows.azimuth_rad, rows.radial_velocity_mps, strict=True):
        cells.setdefault((np.floor(r / 0.75), np.rint(rate / 0.25)), []).append(azimuth)
    for azimuths in cells.values():
        start = -np.inf
        for azimuth in sorted(azimuths):
            if azimuth - start >= CELL.azimuth_rad:
                groups, start = groups + 1, azimuth

    assert len(merged) == groups
    assert merged.power.sum() == pytest.approx(rows.power.sum())


def test_detection_is_even_at_the_threshold_and_nearly_sure_far_above():
    chance = detection_probability(np.array([0.0, 12.0, 30.0]), threshold_db=12.0, slope_db=0.8, most=0.985)

    assert chance[0] < 1e-5
    assert chance[1] == pytest.approx(0.985 / 2)
    assert chance[2] == pytest.approx(0.985, abs=1e-6)


@pytest.mark.parametrize("kind", list(VehicleKind))
def test_scattering_centres_lie_on_the_box(kind):
    length, width, height = SIZES[kind]
    centres = draw_scatterers(kind, length, width, np.random.default_rng(1))

    assert np.all(np.abs(centres.forward_m) <= length / 2 + 0.4)
    assert np.all(np.abs(centres.right_m) <= width / 2 + 0.3)
    assert np.all((centres.height_m > 0) & (centres.height_m < height))
