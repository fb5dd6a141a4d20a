"""Point model of a roadside FMCW MIMO radar: from the vehicles of one instant to the detections of one frame.

The chain of a frame: scattering centres (scatterers.py) -> radar equation, aspect, antenna pattern, fading ->
shadowing (shadowing.py) -> ghosts (ghosts.py) and standing scenery (scenery.py) -> resolution cells and
detection (resolution.py) -> noise that grows as the SNR falls -> false alarms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from service.simulation.ghosts import GhostParameters, ghost_echoes, step_lives
from service.simulation.resolution import (
    CLUTTER,
    FALSE_ALARM,
    GHOST,
    Echoes,
    Resolution,
    detection_probability,
    merge_cells,
)
from service.simulation.scatterers import Scatterers, draw_scatterers
from service.simulation.scenery import Scenery
from service.simulation.shadowing import ShadowParameters, shadow_loss_db
from service.simulation.vehicles import VehicleKind, VehicleStates
from service.tracking.model import F64, I64, Bool

HIDDEN_DB = -40.0  # of a face that looks away
LIT_DB = -25.0  # a face counts for the visible share down to this aspect loss
GRAZING = 1e-2  # cosine below which a face is as good as hidden
CLEAR_DB = 6.0  # and when shadows cost less than this
VIEW_MARGIN_M = 12.0  # half a long vehicle reaches into view
BEHIND_M = -5.0  # vehicles farther behind the radar are left out
STRONGEST_DB = 60.0  # no gain in accuracy above this SNR


@dataclass(frozen=True, slots=True)
class RadarParameters:
    """The radar, its mounting and its surroundings. Defaults: 60 GHz on a footbridge."""

    rate_hz: float = 20.0
    mount_height_m: float = 6.0
    scatter_height_m: float = 0.6  # of standing reflectors and ghosts
    tilt_rad: float = math.radians(4.0)  # boresight below the horizon
    elevation_width_rad: float = math.radians(16.0)  # one-way half-power widths of the antenna
    azimuth_width_rad: float = math.radians(70.0)
    range_min_m: float = 18.0
    range_max_m: float = 155.0
    azimuth_max_rad: float = math.radians(50.0)
    range_resolution_m: float = 0.75
    velocity_resolution_mps: float = 0.25
    azimuth_resolution_rad: float = math.radians(1.5)
    sidelobe_db: float = 20.0  # echoes this much under the strongest of their range-Doppler cell are lost
    reference_snr_db: float = 19.0  # of 1 m2 at 100 m on boresight
    threshold_db: float = 12.0
    threshold_slope_db: float = 0.8  # of the logistic detection probability
    detection_most: float = 0.985
    range_std_m: float = 0.15  # at `noise_snr_db`, as the next two
    velocity_std_mps: float = 0.10
    azimuth_std_rad: float = math.radians(0.30)
    range_floor: float = 0.3  # least standard deviation, shares of those at `noise_snr_db`
    velocity_floor: float = 0.5
    azimuth_floor_rad: float = math.radians(0.10)
    noise_snr_db: float = 20.0
    snr_std_db: float = 0.5
    azimuth_bias_rad: float = 0.0
    fade_db: float = 2.5  # slow fading of a whole vehicle, standard deviation
    fade_time_s: float = 0.8
    speckle_looks: float = 2.0  # chi-square with 4 degrees of freedom, for each scatterer and frame
    scenery_fade_db: float = 1.5
    scenery_doppler_mps: float = 0.03
    swaying_doppler_mps: float = 0.25
    wheel_smear: float = 0.9  # a wheel's points move between 0.1 and 1.9 times the vehicle's speed
    clutter_db: float = 0.0  # added to all standing reflectors
    false_alarms: float = 3.0  # mean number in a frame
    false_alarm_excess_db: float = 1.6  # mean SNR over the threshold
    false_alarm_speed_mps: float = 32.0
    shadow: ShadowParameters = field(default_factory=ShadowParameters)
    ghost: GhostParameters = field(default_factory=GhostParameters)
    drop_probability: float = 0.0  # of a whole frame
    jitter_s: float = 0.0  # standard deviation of a frame's time
    jitter_most_s: float = 0.020

    def resolution(self) -> Resolution:
        """Return the cell of the two FFTs and the beamformer."""
        return Resolution(
            self.range_resolution_m,
            self.velocity_resolution_mps,
            self.azimuth_resolution_rad,
            10 ** (-self.sidelobe_db / 10),
        )


@dataclass(frozen=True, slots=True)
class Observation:
    """N detections of one frame, sorted by range, and what the radar got of each of the V vehicles."""

    range_m: F64  # (N,) slant
    azimuth_rad: F64
    radial_velocity_mps: F64
    snr_db: F64
    source: I64  # (N,) vehicle id, or CLUTTER, FALSE_ALARM, GHOST
    points: I64  # (V,) detections whose strongest part came from the vehicle
    visible: F64  # (V,) share of the faces towards the radar that are not shadowed


@dataclass(slots=True)
class _Bank:
    """What the radar keeps of the vehicles in view: centres (S of all), slow fading and ghost lives."""

    vehicle_id: I64
    centres: Scatterers
    owner: I64  # (S,) index of the vehicle
    fade_db: F64  # (V,)
    ghosts: Bool  # (V, 2)


class Radar:
    """A radar that looks at one scene; `observe` is called once a frame with the vehicles of that instant."""

    def __init__(self, parameters: RadarParameters, scenery: Scenery, rng: np.random.Generator) -> None:
        self.parameters = parameters
        self.scenery = scenery
        self._rng = rng
        self._centres: dict[int, Scatterers] = {}
        self._bank = _Bank(
            np.zeros(0, np.int64),
            Scatterers.join([]),
            np.zeros(0, np.int64),
            np.zeros(0),
            np.zeros((0, 2), np.bool_),
        )
        self._scenery_db = self._snr_db(
            scenery.rcs_dbsm + parameters.clutter_db, scenery.x_m, scenery.y_m, parameters.scatter_height_m
        )

    def observe(self, vehicles: VehicleStates, dt_s: float) -> Observation:
        """Return one frame of detections; `dt_s` is the time since the last one."""
        p, rng = self.parameters, self._rng
        near = (vehicles.ground_range_m() < p.range_max_m + VIEW_MARGIN_M) & (vehicles.y_m > BEHIND_M)
        seen = vehicles.take(near)
        self._follow(seen, dt_s)
        of_vehicles, visible = self._vehicle_echoes(seen)
        echoes = [of_vehicles, self._ghost_echoes(seen), self._scenery_echoes(seen)]
        found = self._detect(_concatenate(echoes))
        found = _concatenate([found, self._draw_false_alarms()])
        order = np.argsort(found.range_m, kind="stable")
        found = found.take(order)
        points = np.zeros(len(vehicles), dtype=np.int64)
        share = np.zeros(len(vehicles))
        share[near] = visible
        by_id = np.argsort(vehicles.vehicle_id)
        mine = found.source[found.source > 0]
        np.add.at(points, by_id[np.searchsorted(vehicles.vehicle_id[by_id], mine)], 1)
        snr_db = found.snr_db + rng.normal(0.0, p.snr_std_db, len(found)) * (found.source != FALSE_ALARM)
        return Observation(
            found.range_m, found.azimuth_rad, found.radial_velocity_mps, snr_db, found.source, points, share
        )

    def _snr_db(self, rcs_dbsm: F64, x_m: F64, y_m: F64, z_m: F64 | float) -> F64:
        """Return the SNR by the radar equation with Gaussian two-way antenna patterns (24 dB = 2 * 12 dB)."""
        p = self.parameters
        below = p.mount_height_m - z_m
        ground = np.hypot(x_m, y_m)
        slant = np.hypot(ground, below)
        elevation = np.arctan2(below, ground) - p.tilt_rad
        pattern = 24 * (elevation / p.elevation_width_rad) ** 2
        pattern += 12 * (np.arctan2(x_m, y_m) / p.azimuth_width_rad) ** 2
        return np.asarray(p.reference_snr_db + rcs_dbsm - 40 * np.log10(slant / 100.0) - pattern)

    def _follow(self, seen: VehicleStates, dt_s: float) -> None:
        """Carry fading and ghosts on to this frame, for the vehicles that are in view now."""
        p, rng, bank = self.parameters, self._rng, self._bank
        if not np.array_equal(bank.vehicle_id, seen.vehicle_id):
            bank = self._bank = self._rebuild(seen)
        keep = math.exp(-dt_s / p.fade_time_s)
        bank.fade_db = keep * bank.fade_db + p.fade_db * math.sqrt(1 - keep**2) * rng.normal(size=len(seen))
        bank.ghosts = step_lives(bank.ghosts, seen, dt_s=dt_s, parameters=p.ghost, rng=rng)

    def _rebuild(self, seen: VehicleStates) -> _Bank:
        p, rng, old = self.parameters, self._rng, self._bank
        known = {int(i): k for k, i in enumerate(old.vehicle_id)}
        ids = seen.vehicle_id.tolist()
        centres = {
            i: self._centres[i]
            if i in self._centres
            else draw_scatterers(
                VehicleKind(seen.kind[k]), float(seen.length_m[k]), float(seen.width_m[k]), rng
            )
            for k, i in enumerate(ids)
        }
        self._centres = centres
        fade_db = np.array([old.fade_db[known[i]] if i in known else p.fade_db * rng.normal() for i in ids])
        ghosts = np.array(
            [old.ghosts[known[i]] if i in known else (False, False) for i in ids], dtype=np.bool_
        )
        sizes = [len(centres[i]) for i in ids]
        return _Bank(
            seen.vehicle_id.copy(),
            Scatterers.join([centres[i] for i in ids]),
            np.repeat(np.arange(len(ids)), sizes),
            fade_db,
            ghosts.reshape(-1, 2),
        )

    def _vehicle_echoes(self, seen: VehicleStates) -> tuple[Echoes, F64]:
        """Return the echoes of all vehicles before merging, and the visible share of each vehicle."""
        p, rng, bank, c = self.parameters, self._rng, self._bank, self._bank.centres
        heading = seen.heading_rad[bank.owner]
        sine, cosine = np.sin(heading), np.cos(heading)
        x = seen.x_m[bank.owner] + c.forward_m * sine + c.right_m * cosine
        y = seen.y_m[bank.owner] + c.forward_m * cosine - c.right_m * sine
        bearing = np.arctan2(x, y)
        # cosine between the outward normal and the direction to the radar
        facing = -np.cos(heading + c.normal_rad - bearing)
        aspect = np.where(facing > 0, 20 * np.log10(np.maximum(facing, GRAZING)), HIDDEN_DB)
        aspect = np.where(np.isnan(c.normal_rad), 0.0, aspect)
        snr_db = self._snr_db(c.rcs_dbsm, x, y, c.height_m) + aspect + bank.fade_db[bank.owner]
        # the shadows of what shows nothing anyway are not computed
        kept = np.flatnonzero((aspect > LIT_DB) | (snr_db > 0))
        owner, x, y, z = bank.owner[kept], x[kept], y[kept], c.height_m[kept]
        loss = shadow_loss_db(seen, x, y, z, owner, radar_height_m=p.mount_height_m, parameters=p.shadow)
        slant = np.sqrt(x**2 + y**2 + (p.mount_height_m - z) ** 2)
        rate = (seen.vx_mps[owner] * x + seen.vy_mps[owner] * y) / slant
        rate *= 1 + c.turning[kept] * rng.uniform(-p.wheel_smear, p.wheel_smear, len(x))
        speckle = rng.gamma(p.speckle_looks, 1 / p.speckle_looks, len(x))
        snr_db = snr_db[kept] - loss
        lit = aspect[kept] > LIT_DB
        faces = np.bincount(owner[lit], minlength=len(seen))
        clear = np.bincount(owner[lit & (loss < CLEAR_DB)], minlength=len(seen))
        echoes = Echoes(slant, bearing[kept], rate, 10 ** (snr_db / 10) * speckle, seen.vehicle_id[owner])
        return echoes.take(snr_db > 0), clear / np.maximum(faces, 1)

    def _ghost_echoes(self, seen: VehicleStates) -> Echoes:
        p, rng = self.parameters, self._rng
        g = ghost_echoes(self._bank.ghosts, seen, self.scenery, parameters=p.ghost, rng=rng)
        snr_db = self._snr_db(g.rcs_dbsm, g.x_m, g.y_m, p.scatter_height_m)
        speckle = rng.gamma(p.speckle_looks, 1 / p.speckle_looks, len(snr_db))
        slant = np.sqrt(g.x_m**2 + g.y_m**2 + (p.mount_height_m - p.scatter_height_m) ** 2)
        return Echoes(
            slant,
            np.arctan2(g.x_m, g.y_m),
            g.radial_velocity_mps,
            10 ** (snr_db / 10) * speckle,
            np.full(len(slant), GHOST),
        )

    def _scenery_echoes(self, seen: VehicleStates) -> Echoes:
        p, rng, s = self.parameters, self._rng, self.scenery
        height = np.full(len(s.x_m), p.scatter_height_m)
        nobody = np.full(len(s.x_m), -1)
        loss = shadow_loss_db(
            seen, s.x_m, s.y_m, height, nobody, radar_height_m=p.mount_height_m, parameters=p.shadow
        )
        snr_db = self._scenery_db - loss + rng.normal(0.0, p.scenery_fade_db, len(loss))
        spread = np.where(s.sways, p.swaying_doppler_mps, p.scenery_doppler_mps)
        return Echoes(
            np.sqrt(s.x_m**2 + s.y_m**2 + (p.mount_height_m - p.scatter_height_m) ** 2),
            np.arctan2(s.x_m, s.y_m),
            rng.normal(0.0, 1.0, len(loss)) * spread,
            10 ** (snr_db / 10),
            np.full(len(loss), CLUTTER),
        )

    def _detect(self, echoes: Echoes) -> Echoes:
        """Return the detections of the echoes in view with measurement noise; their power stays true."""
        p, rng = self.parameters, self._rng
        in_range = (echoes.range_m > p.range_min_m) & (echoes.range_m < p.range_max_m)
        in_view = in_range & (np.abs(echoes.azimuth_rad) < p.azimuth_max_rad) & (echoes.power > 1)
        cells = merge_cells(echoes.take(in_view), p.resolution())
        chance = detection_probability(
            cells.snr_db, threshold_db=p.threshold_db, slope_db=p.threshold_slope_db, most=p.detection_most
        )
        found = cells.take(rng.random(len(cells)) < chance)
        # thermal noise: the standard deviation goes with one over the root of the SNR, down to a floor
        loss = 10 ** ((p.noise_snr_db - np.minimum(found.snr_db, STRONGEST_DB)) / 20)
        range_std = p.range_std_m * np.hypot(p.range_floor, loss)
        velocity_std = p.velocity_std_mps * np.hypot(p.velocity_floor, loss)
        azimuth_std = np.hypot(p.azimuth_floor_rad, p.azimuth_std_rad * loss)
        noise = rng.normal(size=(3, len(found)))
        return Echoes(
            found.range_m + noise[0] * range_std,
            found.azimuth_rad + p.azimuth_bias_rad + noise[1] * azimuth_std,
            found.radial_velocity_mps + noise[2] * velocity_std,
            found.power,
            found.source,
        )

    def _draw_false_alarms(self) -> Echoes:
        p, rng = self.parameters, self._rng
        count = rng.poisson(p.false_alarms)
        snr_db = p.threshold_db + rng.exponential(p.false_alarm_excess_db, count)
        return Echoes(
            rng.uniform(p.range_min_m, p.range_max_m, count),
            rng.uniform(-p.azimuth_max_rad, p.azimuth_max_rad, count),
            rng.uniform(-p.false_alarm_speed_mps, p.false_alarm_speed_mps, count),
            10 ** (snr_db / 10),
            np.full(count, FALSE_ALARM),
        )


def _concatenate(parts: list[Echoes]) -> Echoes:
    return Echoes(
        np.concatenate([e.range_m for e in parts]),
        np.concatenate([e.azimuth_rad for e in parts]),
        np.concatenate([e.radial_velocity_mps for e in parts]),
        np.concatenate([e.power for e in parts]),
        np.concatenate([e.source for e in parts]),
    )
