"""The ASTEKF paper: tables 2-4 and figures 3-5, 10 and 11, one vehicle before a roadside radar.

Source: Electronics 2024, 13, 652, "Target Tracking Algorithm Based on Adaptive Strong Tracking Extended
Kalman Filter".
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from service.evaluation.bound import posterior_bound
from service.evaluation.monte_carlo import Runs, run_filter
from service.evaluation.reproduce.astekf_words import CHANGED, CITATION, FAILS, HOLDS, NO_RESULTS
from service.evaluation.reproduce.form import (
    Bar,
    Cell,
    Figure,
    Kind,
    Line,
    Panel,
    Paper,
    Reproduction,
    Settings,
    Table,
    rms_over_time,
)
from service.simulation.manoeuvres import PERIOD_S, lane_change, motion_1, motion_2
from service.simulation.manoeuvres import cruise as straight_on
from service.simulation.point_radar import PointNoise, measure
from service.tracking.filters.base import Filter, FilterState
from service.tracking.filters.ekf import Ekf
from service.tracking.filters.parameters import PAPER_ASTEKF, PAPER_EKF, PAPER_STEKF, EkfParameters
from service.tracking.filters.strong_tracking import Astekf
from service.tracking.filters.strong_tracking_paper import AstekfPaper, Stekf
from service.tracking.geometry import polar_to_plan
from service.tracking.measurement import AZIMUTH, RANGE
from service.tracking.model import F64
from service.tracking.motion import constant_acceleration

COLUMNS = {"x (m)": 0, "y (m)": 3, "vx (m/s)": 1, "vy (m/s)": 4}  # of the tables -> of the state
P0 = np.diag([1.0, 0.1, 0.01, 1.0, 0.1, 0.01])
PRINTED_AZIMUTH_DEG, INFERRED_AZIMUTH_DEG = 0.5, 0.05

Numbers = tuple[float, float, float, float]
TABLE_2: Mapping[str, Numbers] = MappingProxyType({
    "EKF": (0.1294, 0.7022, 0.2042, 1.2914),
    "STEKF": (0.0398, 0.3620, 0.2073, 1.2972),
    "ASTEKF": (0.0301, 0.2561, 0.0924, 0.7783),
})  # fmt: skip
TABLE_3: Mapping[str, Numbers] = MappingProxyType({
    "EKF": (0.2118, 0.8949, 0.3301, 1.6137),
    "STEKF": (0.0491, 0.3574, 0.2185, 1.3128),
    "ASTEKF": (0.0425, 0.2628, 0.1375, 0.8474),
})  # fmt: skip
TABLE_4: Mapping[str, Numbers] = MappingProxyType({  # A vx, A vy, B vx, B vy
    "EKF": (0.4332, 1.7487, 0.2328, 1.4424),
    "ASTEKF": (0.2864, 1.1259, 0.1654, 0.9534),
})  # fmt: skip
FILTERS: Mapping[str, Filter] = MappingProxyType(
    {"EKF": Ekf(PAPER_EKF), "STEKF": Stekf(PAPER_STEKF), "ASTEKF": AstekfPaper(PAPER_ASTEKF)}
)
_FIXED_SOFTENING = (1.0, 2.0, 4.0, 6.0)
_FIELD_FRAMES = {"A": 216, "B": 180}  # frames 90 to 305 and 81 to 260


@dataclass(frozen=True, slots=True)
class Experiment:
    """The runs of several filters over the same measurements of one motion."""

    truth: F64  # (K, 6)
    z: F64  # (K, N, 3)
    runs: Mapping[str, Runs]

    def squared(self, name: str, column: str) -> F64:
        """Return the squared errors (K, N) of a filter in a column of the tables."""
        state = COLUMNS[column]
        return np.square(self.runs[name].mean[..., state] - self.truth[:, None, state])


def reproduce(settings: Settings) -> Reproduction:
    """Return tables 2-4, the figures, our additions and the bars."""
    printed = [_motion(k, PRINTED_AZIMUTH_DEG, settings) for k in (1, 2)]
    inferred = [_motion(k, INFERRED_AZIMUTH_DEG, settings) for k in (1, 2)]
    field = {name: _field(name, settings) for name in _FIELD_FRAMES}
    tables = [_table(f"Table {2 + k}", f"motion {1 + k}", k, printed[k], PRINTED_AZIMUTH_DEG) for k in (0, 1)]
    tables.append(_field_table(field))
    tables += [
        _table(
            f"Table {'AB'[k]}",
            f"table {2 + k} with a tenth of the azimuth noise",
            k,
            inferred[k],
            INFERRED_AZIMUTH_DEG,
        )
        for k in (0, 1)
    ]
    tables += [_softening(settings), _right_start(settings)]
    curves = (_curves("Figure 4", 1, printed[0]), _curves("Figure 5", 2, printed[1]))
    figures = (_paths(printed), *curves, _field_paths(field), _field_errors(field))
    return Reproduction(
        "astekf", CITATION, settings.runs, settings.seed, (*tables, *NO_RESULTS[0]),
        (*figures, *NO_RESULTS[1]), _bars(printed), HOLDS, FAILS, CHANGED,
    )  # fmt: skip


def noise_of(azimuth_deg: float) -> PointNoise:
    """Return the paper's noise with another standard deviation of the azimuth."""
    return PointNoise(azimuth_std_rad=math.radians(azimuth_deg))


def cold_start(chosen: Filter, z: F64) -> FilterState:
    """Return tracks at the first measurement (N, 3): its position, no velocity, the printed P0.

    The paper does not state its start; only this one gives its EKF rows.
    """
    mean = np.zeros((len(z), 6))
    mean[:, 0], mean[:, 3] = polar_to_plan(z[:, RANGE], z[:, AZIMUTH])
    return chosen.start(mean, np.broadcast_to(P0, (len(z), 6, 6)))


def experiment(
    truth: F64, noise: PointNoise, filters: Mapping[str, Filter], runs: int, seed: tuple[int, ...]
) -> Experiment:
    """Return what filters with a cold start make of `runs` measurements of one truth (K, 6)."""
    many = np.broadcast_to(truth[:, None], (len(truth), runs, 6))
    z = measure(many, noise, np.random.default_rng(seed))
    found = {
        n: run_filter(f, z, noise.covariance(), PERIOD_S, cold_start(f, z[0])) for n, f in filters.items()
    }
    return Experiment(truth, z, found)


def _motion(which: int, azimuth_deg: float, settings: Settings) -> Experiment:
    truth = (motion_1, motion_2)[which - 1]()
    seed = (settings.seed, which, round(100 * azimuth_deg))
    found = experiment(truth, noise_of(azimuth_deg), FILTERS, settings.runs, seed)
    settings.advance(f"ASTEKF paper: motion {which}, azimuth {azimuth_deg:g} deg")
    return found


def _bounds(truth: F64, azimuth_deg: float) -> dict[str, float]:
    """Return the time mean of the bound on each column, without process noise and with the printed P0."""
    R = noise_of(azimuth_deg).covariance()[:2, :2]
    F = constant_acceleration(PERIOD_S, 0.0).F
    bound = posterior_bound(truth, R, F, np.zeros((6, 6)), P0)
    return {name: float(np.sqrt(bound[:, i, i]).mean()) for name, i in COLUMNS.items()}


def _table(number: str, title: str, which: int, e: Experiment, azimuth_deg: float) -> Table:
    printed = (TABLE_2, TABLE_3)[which]
    kind = Kind.SIMULATED if azimuth_deg == PRINTED_AZIMUTH_DEG else Kind.OURS
    bounds, cells = _bounds(e.truth, azimuth_deg), []
    for name in FILTERS:
        for k, column in enumerate(COLUMNS):
            value, error = rms_over_time(e.squared(name, column))
            paper, bound = printed[name][k], bounds[column]
            remark = "the paper's number is below the bound" if paper < bound else ""
            cells.append(Cell(name, column, paper, value, error, bound=bound, remark=remark))
    note = (
        f"Azimuth noise {azimuth_deg:g} deg, range noise 0.75 m, time mean of the RMSE. The bound is for the "
        "truth drawn from the printed P0, without process noise."
    )
    return Table(number, title, kind, tuple(cells), note)


def _field(name: str, settings: Settings) -> Experiment:
    """Return a stand-in for vehicle A (changes lanes) or B (drives straight on) of the field test."""
    truth = (lane_change() if name == "A" else straight_on())[: _FIELD_FRAMES[name]]
    filters = {"EKF": FILTERS["EKF"], "ASTEKF": FILTERS["ASTEKF"], "ASTEKF, recommended": Astekf()}
    found = experiment(truth, PointNoise(), filters, settings.runs, (settings.seed, ord(name)))
    settings.advance(f"ASTEKF paper: stand-in for vehicle {name}")
    return found


def _field_table(field: Mapping[str, Experiment]) -> Table:
    cells = []
    for name in ("EKF", "ASTEKF", "ASTEKF, recommended"):
        for k, (vehicle, column) in enumerate((v, c) for v in field for c in ("vx (m/s)", "vy (m/s)")):
            value, error = rms_over_time(field[vehicle].squared(name, column))
            paper = TABLE_4[name][k] if name in TABLE_4 else None
            cells.append(Cell(name, f"{vehicle} {column}", paper, value, error))
    note = (
        "A: lane change of 3.5 m in 4 s at 13.9 m/s, 10.8 s. B: straight on at 13.9 m/s, 9 s. Noise as in "
        "the simulation, cold start. The ratios say nothing about the drives on the road."
    )
    return Table("Table 4", "two vehicles on the road", Kind.SURROGATE, tuple(cells), note)


def _softening(settings: Settings) -> Table:
    choices = {f"beta {b:g}": replace(PAPER_ASTEKF, softening_fixed=b) for b in _FIXED_SOFTENING}
    choices["beta adaptive"] = PAPER_ASTEKF
    filters: dict[str, Filter] = {name: AstekfPaper(p) for name, p in choices.items()}
    e = experiment(motion_1(), PointNoise(), filters, settings.runs, (settings.seed, 1, 50))
    cells = [
        Cell(name, column, None, *rms_over_time(e.squared(name, column)))
        for name in filters
        for column in ("y (m)", "vy (m/s)")
    ]
    settings.advance("ASTEKF paper: softening factors")
    note = (
        "Motion 1, 0.5 deg: the adaptive factor finds the useful region by itself, far from the usual 1 to 2."
    )
    return Table("Table C", "the softening factor, fixed and adaptive", Kind.OURS, tuple(cells), note)


def _right_start(settings: Settings) -> Table:
    """Return an EKF whose start is drawn from P0 about the truth: what there is to gain on motion 1."""
    truth, noise = motion_1(), PointNoise()
    rng = np.random.default_rng((settings.seed, 300))
    z = measure(np.broadcast_to(truth[:, None], (len(truth), settings.runs, 6)), noise, rng)
    mean = truth[0] + np.sqrt(np.diag(P0)) * rng.standard_normal((settings.runs, 6))
    ekf = Ekf(EkfParameters(accel_std_mps2=0.002, accel_tau_s=None, robust_gate=None))
    start = ekf.start(mean, np.broadcast_to(P0, (settings.runs, 6, 6)))
    e = Experiment(truth, z, {"EKF": run_filter(ekf, z, noise.covariance(), PERIOD_S, start)})
    bounds = _bounds(truth, PRINTED_AZIMUTH_DEG)
    cells = [
        Cell("EKF, q 0.002", c, None, *rms_over_time(e.squared("EKF", c)), bound=bounds[c]) for c in COLUMNS
    ]
    settings.advance("ASTEKF paper: right start")
    note = (
        "With a right start and little process noise the EKF is at the bound: no filter can do better there."
    )
    return Table("Table D", "motion 1 from a right start", Kind.OURS, tuple(cells), note)


def _bars(printed: list[Experiment]) -> tuple[Bar, ...]:
    def value(k: int, name: str, column: str) -> float:
        return rms_over_time(printed[k].squared(name, column))[0]

    def against(k: int, other: str, column: str) -> float:
        return value(k, "ASTEKF", column) / value(k, other, column)

    return (
        Bar("motion 1: ASTEKF y (m)", value(0, "ASTEKF", "y (m)"), 0.25, 0.31),
        Bar("motion 1: ASTEKF vy (m/s)", value(0, "ASTEKF", "vy (m/s)"), 0.70, 0.90),
        Bar("motion 1: y against STEKF", against(0, "STEKF", "y (m)"), high=0.75),
        Bar("motion 1: vy against STEKF", against(0, "STEKF", "vy (m/s)"), high=0.65),
        Bar("motion 1: y against EKF", against(0, "EKF", "y (m)"), high=0.45),
        Bar("motion 1: vy against EKF", against(0, "EKF", "vy (m/s)"), high=0.70),
        Bar("motion 2: ASTEKF y (m)", value(1, "ASTEKF", "y (m)"), high=0.39),
        Bar("motion 2: ASTEKF vy (m/s)", value(1, "ASTEKF", "vy (m/s)"), high=1.10),
        Bar("motion 2: y against STEKF", against(1, "STEKF", "y (m)"), high=0.93),
        Bar("motion 2: vy against STEKF", against(1, "STEKF", "vy (m/s)"), high=0.80),
        Bar("motion 2: vy against EKF", against(1, "EKF", "vy (m/s)"), high=0.73),
    )


# ---------------------------------------------------------------- figures


def _times(e: Experiment) -> F64:
    return PERIOD_S * np.arange(len(e.truth), dtype=np.float64)


def _path_panel(title: str, e: Experiment) -> Panel:
    x, y = polar_to_plan(e.z[:, 0, RANGE], e.z[:, 0, AZIMUTH])
    lines = [Line("true", e.truth[:, 0], e.truth[:, 3]), Line("measured", x, y, dots=True)]
    lines += [Line(name, r.mean[:, 0, 0], r.mean[:, 0, 3]) for name, r in e.runs.items()]
    return Panel(title, "x (m)", "y (m)", tuple(lines))


def _paths(printed: list[Experiment]) -> Figure:
    panels = tuple(_path_panel(f"({'ab'[k]}) motion {k + 1}", e) for k, e in enumerate(printed))
    return Figure("Figure 3", "tracks of the three filters", Kind.SIMULATED, panels, "The first run.")


def _curves(number: str, which: int, e: Experiment) -> Figure:
    panels = tuple(
        Panel(
            f"({'abcd'[k]}) RMSE of {column}", "time (s)", column.split("(")[1].rstrip(")"),
            tuple(Line(n, _times(e), np.sqrt(e.squared(n, column).mean(axis=1))) for n in e.runs),
        )
        for k, column in enumerate(COLUMNS)
    )  # fmt: skip
    return Figure(number, f"errors over time, motion {which}", Kind.SIMULATED, panels)


def _field_paths(field: Mapping[str, Experiment]) -> Figure:
    panels = tuple(_path_panel(f"stand-in for vehicle {name}", e) for name, e in field.items())
    return Figure("Figure 10", "tracks of two vehicles", Kind.SURROGATE, panels, "The first run.")


def _field_errors(field: Mapping[str, Experiment]) -> Figure:
    """Return the error along the line of sight over time."""
    panels = []
    for vehicle, e in field.items():
        u = e.truth[:, [0, 3]] / np.hypot(e.truth[:, 0], e.truth[:, 3])[:, None]
        lines = []
        for name, r in e.runs.items():
            error = (r.mean[:, :, [1, 4]] - e.truth[:, None, [1, 4]]) @ u[:, :, None]
            lines.append(Line(name, _times(e), np.sqrt(np.square(error[..., 0]).mean(axis=1))))
        panels.append(Panel(f"stand-in for vehicle {vehicle}", "time (s)", "m/s", tuple(lines)))
    return Figure("Figure 11", "error of the radial velocity", Kind.SURROGATE, tuple(panels))


ASTEKF = Paper("astekf", 200, 8, reproduce)
