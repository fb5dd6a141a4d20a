"""The MAST-UKF paper: tables 2 and 4-6, figures 2, 3 and 7.

Source: Appl. Sci. 2025, 15, 3276, "Vehicle Target Tracking Algorithm Based on Improved Strong Tracking
Unscented Kalman Filter".
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

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
    mean_and_error,
    ratio_of_rms,
)
from service.evaluation.reproduce.mast_field import Field, errors_table, paths_figure, study_field
from service.evaluation.reproduce.mast_study import (
    MAKERS,
    Flight,
    Reading,
    fly,
    least_errors,
    rms_of_mean,
    rms_over_runs,
)
from service.evaluation.reproduce.mast_words import CHANGED, CITATION, FAILS, HOLDS, NO_RESULTS
from service.simulation.turning_target import PERIOD_S
from service.tracking.filters.space import plane
from service.tracking.geometry import polar_to_plan
from service.tracking.model import F64

COLUMNS = {"x (m)": 0, "y (m)": 2, "vx (m/s)": 1, "vy (m/s)": 3}  # of table 2 -> of the state
TABLE_2: Mapping[str, tuple[float, ...]] = MappingProxyType({
    "UKF": (2.3216, 1.3404, 1.2297, 0.7064),
    "ST-UKF": (2.1833, 1.2605, 1.1925, 0.6924),
    "AST-UKF": (2.0679, 1.1939, 1.1066, 0.6396),
    "MAST-UKF": (1.7485, 1.0057, 0.7704, 0.4456),
})  # fmt: skip
TABLE_6 = {
    "AST-UKF": (44.222, 43.572, 44.171, 43.865, 43.686),
    "MAST-UKF": (48.285, 48.398, 48.438, 48.438, 47.876),
}
PRINTED = Reading(50.0, 0.1, 1.0)
READINGS: Mapping[str, tuple[str, str, Reading]] = MappingProxyType({
    "printed": ("Table 2", "as printed: 50 m, IMM of straight and both circles", PRINTED),
    "single": ("Table A", "table 2 with one straight model", Reading(50.0, 0.1, 5.0, many_models=False)),
    "variance": ("Table B", "table 2 with 50 m^2 for 50 m", Reading(50.0**0.5, 0.1, 1.0)),
    "outliers": ("Table C", "table 2 with 5 m and 5 % outliers", Reading(5.0, 0.1, 3.0, outliers=0.05)),
    "sharp": ("Table D", "table 2, 2 m, 0.05 deg, 5 % outliers", Reading(2.0, 0.05, 3.0, outliers=0.05)),
})  # fmt: skip
_ROUNDS, _UPDATES = 5, 1000
_DRAWN = ("UKF", "ST-UKF", "AST-UKF", "MAST-UKF")


def reproduce(settings: Settings) -> Reproduction:
    """Return tables 2 and 4-6, figures 2, 3 and 7, our readings and the bars."""
    flights: dict[str, Flight] = {}
    for place, (key, (_, title, reading)) in enumerate(READINGS.items()):
        names = list(MAKERS) if key == "printed" else [n for n in MAKERS if "guarded" not in n]
        flights[key] = fly(reading, names, settings.runs, (settings.seed, place))
        settings.advance(f"MAST-UKF paper: {title}")
    field = study_field(settings)
    readings = [_table(key, flights[key]) for key in READINGS]
    tables = (
        readings[0], errors_table("Table 4", field), errors_table("Table 5", field), _times(settings),
        *readings[1:], _averaged(flights["printed"]),
    )  # fmt: skip
    figures = (_tracks(flights["printed"]), _curves(flights["printed"]), paths_figure(field))
    return Reproduction(
        "mast-ukf", CITATION, settings.runs, settings.seed, (*tables, *NO_RESULTS[0]),
        (*figures, *NO_RESULTS[1]), _bars(flights["outliers"], field), HOLDS, FAILS, CHANGED,
    )  # fmt: skip


def _table(key: str, flight: Flight) -> Table:
    number, title, reading = READINGS[key]
    bounds, cells = least_errors(reading), []
    for name in flight.mean:
        squared = flight.squared(name)
        for k, (column, state) in enumerate(COLUMNS.items()):
            paper, bound = TABLE_2[name][k] if name in TABLE_2 else None, float(bounds[state])
            known = None if reading.outliers else bound
            remark = "the paper's number is below the bound" if paper and known and paper < known else ""
            cells.append(
                Cell(name, column, paper, *rms_over_runs(squared[..., state]), bound=known, remark=remark)
            )
    cells += [
        Cell(f"{name} / UKF", what, printed, *ratio)
        for name in ("ST-UKF", "AST-UKF", "MAST-UKF", "MAST-UKF, safe")
        for what, printed, ratio in _against_ukf(flight, name)
    ]
    note = (
        f"RMSE from second 10 on, sigma_a {reading.accel_std_mps2:g} m/s^2. The bound knows every motion and "
        "has no process noise."
    )
    return Table(number, title, Kind.SIMULATED if key == "printed" else Kind.OURS, tuple(cells), note)


def _against_ukf(flight: Flight, name: str) -> list[tuple[str, float | None, tuple[float, float]]]:
    """Return what, the paper's ratio of the lengths of the errors to the UKF's, ours and its error."""
    out = []
    for what, states, columns in (("position", (0, 2), (0, 1)), ("velocity", (1, 3), (2, 3))):
        ours, plain = (flight.squared(n)[..., states].sum(axis=-1).mean(axis=0) for n in (name, "UKF"))
        printed = None
        if name in TABLE_2:
            a, b = columns
            theirs = (math.hypot(TABLE_2[n][a], TABLE_2[n][b]) for n in (name, "UKF"))
            printed = next(theirs) / next(theirs)
        out.append((what, printed, ratio_of_rms(ours, plain)))
    return out


def _averaged(flight: Flight) -> Table:
    """Return the errors of the mean of all estimated tracks."""
    cells = []
    for name in _DRAWN:
        root, spread = rms_of_mean(flight.mean[name] - flight.truth[:, None])
        cells += [
            Cell(name, c, TABLE_2[name][k], float(root[s]), float(spread[s]))
            for k, (c, s) in enumerate(COLUMNS.items())
        ]
    note = (
        "The noise averages out and the bias stays: numbers of the printed size come so too. Errors by the "
        "jackknife over the runs."
    )
    return Table(
        "Table E", "table 2 if the runs are averaged before the error is taken", Kind.OURS, tuple(cells), note
    )


def _times(settings: Settings) -> Table:
    """Return the seconds for a thousand updates of one track, from fewer where there are few runs."""
    cells, updates = [], min(_UPDATES, 10 * settings.runs)
    for name, printed in TABLE_6.items():
        chosen = MAKERS[name](plane(1.0, doppler=False))
        seconds: list[tuple[float, float]] = []
        for _ in range(_ROUNDS):
            state = chosen.start(np.array([[300.0, 70.0, 200.0, 0.0]]), 100.0 * np.eye(4)[None])
            z = np.array([[[360.0, 0.98]]])
            each = np.empty(updates)
            for k in range(updates):
                begin = time.perf_counter()
                prediction = chosen.predict(state, PERIOD_S)
                chosen.update(
                    prediction, z, np.diag([2500.0, 3e-6])[None, None], np.ones((1, 1)), np.zeros(1)
                )
                each[k] = time.perf_counter() - begin
            value, error = mean_and_error(each)
            seconds.append((_UPDATES * value, _UPDATES * error))
        cells += [
            Cell(name, f"round {k + 1} (s)", printed[k], *seconds[k], remark="another machine and language")
            for k in range(_ROUNDS)
        ]
        mean = mean_and_error([took for took, _ in seconds])
        cells.append(Cell(name, "mean (s)", float(np.mean(printed)), *mean))
    settings.advance("MAST-UKF paper: computing time")
    note = (
        "One track in numpy; a bank of 64 costs hardly more. Errors: of a round over its updates, of the "
        "mean over the rounds. The paper's text exchanges its two filters and cites 48.444 s, which is not "
        "in its table."
    )
    return Table("Table 6", "time of 1000 updates", Kind.MEASURED, tuple(cells), note)


def _bars(outliers: Flight, field: Field) -> tuple[Bar, ...]:
    ratios = {what: ratio for what, _, (ratio, _) in _against_ukf(outliers, "MAST-UKF")}
    return (
        Bar("outliers: MAST-UKF / UKF, position", ratios["position"], 0.6, 0.85),
        Bar("outliers: MAST-UKF / UKF, velocity", ratios["velocity"], 0.5, 0.80),
        Bar("stand-ins: safe MAST-UKF / guarded AST-UKF, position", _on_the_road(field, (0, 2)), high=1.0),
        Bar("stand-ins: safe MAST-UKF / guarded AST-UKF, velocity", _on_the_road(field, (1, 3)), high=1.0),
    )


def _on_the_road(field: Field, states: tuple[int, int]) -> float:
    return field.ratio("MAST-UKF, safe", "AST-UKF, guarded", states)


# ---------------------------------------------------------------- figures


def _tracks(flight: Flight) -> Figure:
    x, y = polar_to_plan(flight.z[:, 0, 0], flight.z[:, 0, 1])
    lines = [Line("true", flight.truth[:, 0], flight.truth[:, 2]), Line("measured", x, y, dots=True)]
    lines += [Line(n, flight.mean[n][:, 0, 0], flight.mean[n][:, 0, 2]) for n in _DRAWN]
    panel = Panel("tracks", "x (m)", "y (m)", tuple(lines))
    return Figure("Figure 2", "tracks of the filters", Kind.SIMULATED, (panel,), "The first run, as printed.")


def _curves(flight: Flight) -> Figure:
    t = PERIOD_S * np.arange(1.0, len(flight.truth) + 1.0)

    def line(name: str, states: tuple[int, int]) -> Line:
        squared: F64 = np.square(flight.mean[name] - flight.truth[:, None])[..., states].sum(axis=-1)
        return Line(name, t, np.sqrt(squared.mean(axis=1)))

    panels = tuple(
        Panel(title, "time (s)", unit, tuple(line(name, states) for name in _DRAWN))
        for title, unit, states in (
            ("(a) RMSE of position", "m", (0, 2)),
            ("(b) RMSE of velocity", "m/s", (1, 3)),
        )
    )
    return Figure("Figure 3", "errors over time", Kind.SIMULATED, panels, "As printed.")


MAST_UKF = Paper("mast-ukf", 200, len(READINGS) + 3, reproduce)
