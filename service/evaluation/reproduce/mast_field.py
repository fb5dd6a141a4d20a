"""Stand-ins for the two vehicles of the MAST-UKF paper's road test, whose recording is unpublished."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from service.evaluation.monte_carlo import run_filter
from service.evaluation.reproduce.form import Cell, Figure, Kind, Line, Panel, Settings, Table
from service.evaluation.reproduce.mast_study import MAKERS, rms_over_runs
from service.simulation.manoeuvres import PERIOD_S, cruise, lane_change
from service.simulation.point_radar import PointNoise, measure
from service.tracking.filters.space import ROAD_COLUMNS, plane
from service.tracking.geometry import polar_to_plan
from service.tracking.model import F64
from service.tracking.start import two_point_state, undirected_prior

NOISE = PointNoise(0.75, math.radians(0.1))  # the range resolution and the angle resolution of table 3
_ACCEL_STD_MPS2 = 4.0
_SETTLED = 40  # frames
_NAMES = ("UKF", "AST-UKF", "MAST-UKF", "AST-UKF, guarded", "MAST-UKF, safe")
PAPER: Mapping[str, Mapping[str, tuple[float, ...]]] = {  # A x, A y, B x, B y
    "Table 4": {"AST-UKF": (0.1705, 0.7218, 0.1039, 0.7052), "MAST-UKF": (0.1568, 0.4892, 0.0971, 0.5193)},
    "Table 5": {"AST-UKF": (0.1970, 1.2894, 0.1638, 1.1379), "MAST-UKF": (0.1836, 0.9372, 0.1547, 0.8836)},
}
_STATES = {"Table 4": (("x (m)", 0), ("y (m)", 2)), "Table 5": (("vx (m/s)", 1), ("vy (m/s)", 3))}


@dataclass(frozen=True, slots=True)
class Drive:
    """One vehicle: truth (K, 4), measurements (K, N, 3), estimates (K, N, 4) of each filter."""

    truth: F64
    z: F64
    mean: Mapping[str, F64]

    def squared(self, name: str) -> F64:
        """Return the squared errors (K, N, 4) of the settled filter."""
        return np.square(self.mean[name] - self.truth[:, None])[_SETTLED:]


@dataclass(frozen=True, slots=True)
class Field:
    """Both vehicles."""

    drives: Mapping[str, Drive]

    def ratio(self, name: str, other: str, states: tuple[int, int]) -> float:
        """Return the ratio of the lengths of two filters' errors in two states, over both vehicles."""
        ours, theirs = (
            sum(float(d.squared(n)[..., states].sum(axis=-1).mean()) for d in self.drives.values())
            for n in (name, other)
        )
        return math.sqrt(ours / theirs)


def study_field(settings: Settings) -> Field:
    """Return vehicle A, which changes lanes, and vehicle B, which drives straight on."""
    drives = {}
    for name, truth in (("A", lane_change()), ("B", cruise())):
        drives[name] = _drive(truth, settings.runs, (settings.seed, ord(name)))
        settings.advance(f"MAST-UKF paper: stand-in for vehicle {name}")
    return Field(drives)


def _drive(truth: F64, runs: int, seed: tuple[int, int]) -> Drive:
    many = np.broadcast_to(truth[:, None], (len(truth), runs, 6))
    z = measure(many, NOISE, np.random.default_rng(seed))
    R, columns = np.broadcast_to(NOISE.covariance(), (runs, 3, 3)), list(ROAD_COLUMNS)
    mean, cov = two_point_state(z[0], R, z[1], R, dt_s=PERIOD_S, prior=undirected_prior())
    found = {}
    for name in _NAMES:
        chosen = MAKERS[name](plane(_ACCEL_STD_MPS2, doppler=False))
        start = chosen.start(mean[:, columns], cov[:, columns][:, :, columns])
        found[name] = run_filter(chosen, z[1:, :, :2], NOISE.covariance()[:2, :2], PERIOD_S, start).mean
    return Drive(truth[1:, columns], z[1:], found)


def errors_table(number: str, field: Field) -> Table:
    """Return table 4 (positions) or table 5 (velocities)."""
    cells = []
    for name in _NAMES:
        printed = PAPER[number].get(name)
        for k, (vehicle, (column, state)) in enumerate((v, s) for v in field.drives for s in _STATES[number]):
            value = rms_over_runs(field.drives[vehicle].squared(name)[..., state])
            cells.append(Cell(name, f"{vehicle} {column}", printed[k] if printed else None, *value))
    note = (
        "A: lane change of 3.5 m in 4 s at 13.9 m/s. B: straight on at 13.9 m/s. Noise of 0.75 m and "
        "0.1 deg, the resolutions of table 3; constant velocity, sigma_a 4 m/s^2. The ratios say nothing "
        "about the road."
    )
    title = (
        "positions of two vehicles on the road"
        if number == "Table 4"
        else "velocities of two vehicles on the road"
    )
    return Table(number, title, Kind.SURROGATE, tuple(cells), note)


def paths_figure(field: Field) -> Figure:
    """Return figure 7."""
    panels = []
    for vehicle, drive in field.drives.items():
        x, y = polar_to_plan(drive.z[:, 0, 0], drive.z[:, 0, 1])
        lines = [Line("true", drive.truth[:, 0], drive.truth[:, 2]), Line("measured", x, y, dots=True)]
        lines += [
            Line(n, drive.mean[n][:, 0, 0], drive.mean[n][:, 0, 2]) for n in ("AST-UKF", "MAST-UKF, safe")
        ]
        panels.append(Panel(f"stand-in for vehicle {vehicle}", "x (m)", "y (m)", tuple(lines)))
    return Figure("Figure 7", "tracks of two vehicles", Kind.SURROGATE, tuple(panels), "The first run.")
