"""The ISRCKF paper: figures 5-11, drives behind another car; all of its data are unpublished.

Source: Sensors 2020, square-root cubature Kalman filter with the noise estimators of Sage and Husa, and the
motion states of the vehicle ahead.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from service.evaluation.reproduce.car_study import (
    AHEAD,
    AHEAD_RATE,
    DRIVES,
    ENVIRONMENTS,
    MAKERS,
    Drives,
    drive_all,
)
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
    median_and_error,
)
from service.evaluation.reproduce.isrckf_states import STEPS as STATE_STEPS
from service.evaluation.reproduce.isrckf_states import (
    Judged,
    judge_all,
    states_figures,
    states_table,
    worst_mean,
)
from service.evaluation.reproduce.isrckf_words import CHANGED, CITATION, FAILS, HOLDS, NO_RESULTS
from service.evaluation.traffic_study import CAR_DOPPLER, NOISE_LEVELS, estimated_scales
from service.simulation.manoeuvres import FOLLOWING_PERIOD_S
from service.tracking.filters.cubature import isrckf
from service.tracking.filters.parameters import SageHusaParameters
from service.tracking.filters.space import plane
from service.tracking.model import F64

# Largest gains of the ISRCKF over the twelve drives as printed [%]: distance, speed.
PRINTED_GAIN = {"SH-EKF": (45.53, 23.53), "SRCKF": (59.15, 29.09)}
PRINTED_SECONDS = {"SH-EKF": 0.0051, "SRCKF": 0.0047, "ISRCKF": 0.0053}
SHOWN = 6  # drive of figures 5 and 6: the first on the campus
_CHANNELS = ("range", "azimuth", "range rate")
_ROUNDS, _UPDATES = 5, 200


def reproduce(settings: Settings) -> Reproduction:
    """Return figures 5-11 and tables of their numbers."""

    def advance(what: str) -> None:
        settings.advance(f"ISRCKF paper: {what}")

    drives = drive_all(settings.runs, (settings.seed, 1), advance)
    judged = judge_all(settings.runs, settings.seed)
    advance("motion states")
    scales = estimated_scales(
        isrckf(SageHusaParameters(), plane(1.0, doppler=True)), CAR_DOPPLER, settings.seed, settings.runs
    )
    advance("estimated noise")
    tables = (_gains(drives), _times(settings), states_table(judged), _each(drives), _levels(scales))
    advance("computing time")
    figures = (
        *_history(drives, settings),
        *_by_drive(drives),
        _seconds(tables[1]),
        *states_figures(judged[0]),
    )
    return Reproduction(
        "isrckf", CITATION, settings.runs, settings.seed, (*tables, *NO_RESULTS[0]),
        (*figures, *NO_RESULTS[1]), _bars(drives, np.median(scales, axis=1), judged), HOLDS, FAILS, CHANGED,
    )  # fmt: skip


def gains(drives: Drives, other: str, column: int) -> F64:
    """Return by how many percent the ISRCKF's error is below another's, in each of the twelve drives."""
    return 100.0 * (1.0 - drives.rmse("ISRCKF", column) / drives.rmse(other, column))


def gain_error(drives: Drives, other: str, column: int, of: Callable[[F64], np.floating]) -> float:
    """Return the standard error over the runs of a number made of the twelve gains, by the jackknife."""
    ours, theirs = drives.squared("ISRCKF", column), drives.squared(other, column)
    runs = ours.shape[1]
    left = []
    for k in range(runs):
        without = [np.delete(squared, k, axis=1).mean(axis=1) for squared in (ours, theirs)]
        left.append(float(of(100.0 * (1.0 - np.sqrt(without[0] / without[1])))))
    return float(np.sqrt((runs - 1) * np.var(left)))


def _gains(drives: Drives) -> Table:
    cells = []
    for other, printed in PRINTED_GAIN.items():
        for k, (what, column) in enumerate((("distance", AHEAD), ("speed", AHEAD_RATE))):
            each = gains(drives, other, column)
            remark = "the SH-EKF of the paper diverges" if other == "SH-EKF" else ""
            for kind, of, paper in (("largest", np.max, printed[k]), ("median", np.median, None)):
                error = gain_error(drives, other, column, of)
                says = remark if kind == "largest" else ""
                head = f"{kind} gain in {what} (%)"
                cells.append(Cell(f"against {other}", head, paper, float(of(each)), error, remark=says))
    note = (
        "Twelve simulated drives; in each the variances of the noise are 1, 4, 9 and 1 times the first, a "
        "quarter of the time each; in every third drive the filters believe in three times the noise."
    )
    return Table(
        "Figures 7, 8", "gain of the ISRCKF over the twelve drives", Kind.SURROGATE, tuple(cells), note
    )


def _each(drives: Drives) -> Table:
    cells = [
        Cell(
            f"{place.name}, drive {k + 1}",
            f"{name} {what}",
            None,
            float(drives.rmse(name, column)[DRIVES * p + k]),
            float(drives.rmse_error(name, column)[DRIVES * p + k]),
        )
        for p, place in enumerate(ENVIRONMENTS)
        for k in range(DRIVES)
        for name in MAKERS
        for what, column in (("distance (m)", AHEAD), ("speed (m/s)", AHEAD_RATE))
    ]
    return Table("Table A", "errors of each drive", Kind.SURROGATE, tuple(cells))


def _levels(scales: F64) -> Table:
    quarters, _, channels = scales.shape
    cells = [
        Cell(
            f"quarter {q + 1}",
            _CHANNELS[c],
            NOISE_LEVELS[q],
            *median_and_error(scales[q, :, c]),
            remark="left: the truth",
        )
        for q in range(quarters)
        for c in range(channels)
    ]
    note = (
        "Median over the runs and its bootstrap error, 0.2 s before each quarter ends; the filter knows the "
        "noise of the first."
    )
    return Table("Table B", "scale of R as the ISRCKF estimates it", Kind.OURS, tuple(cells), note)


def _times(settings: Settings) -> Table:
    """Return the seconds of one update of one track."""
    cells, updates = [], min(_UPDATES, 10 * settings.runs)
    for name, printed in PRINTED_SECONDS.items():
        chosen = MAKERS[name](plane(4.0, doppler=True))
        state = chosen.start(np.array([[0.0, 0.0, 40.0, 0.0]]), np.eye(4)[None])
        z, R = np.array([[[40.0, 0.0, 0.0]]]), CAR_DOPPLER.covariance()[None, None]
        seconds = []
        for _ in range(_ROUNDS):
            begin = time.perf_counter()
            for _ in range(updates):
                state = chosen.update(
                    chosen.predict(state, FOLLOWING_PERIOD_S), z, R, np.ones((1, 1)), np.zeros(1)
                )
            seconds.append((time.perf_counter() - begin) / updates)
        cells.append(
            Cell(
                name,
                "one update (s)",
                printed,
                *mean_and_error(seconds),
                remark="another machine and language",
            )
        )
    return Table("Figure 9 in numbers", "time of one update of one track", Kind.MEASURED, tuple(cells))


def _bars(drives: Drives, levels: F64, judged: Sequence[Judged]) -> tuple[Bar, ...]:
    off_s, off_error_s = worst_mean(judged)
    off = np.abs(levels / np.array(NOISE_LEVELS)[:, None] - 1.0).max()
    return (
        Bar(
            "speed: median gain over the SRCKF (%)",
            float(np.median(gains(drives, "SRCKF", AHEAD_RATE))),
            low=10.0,
        ),
        Bar(
            "speed: largest gain over the SRCKF (%)",
            float(gains(drives, "SRCKF", AHEAD_RATE).max()),
            low=20.0,
        ),
        Bar("estimated R off by (share)", float(off), high=0.25),
        Bar("motion states: largest error of a mean time (s)", off_s, high=0.1, error=off_error_s),
    )


# ---------------------------------------------------------------- figures


def _history(drives: Drives, settings: Settings) -> tuple[Figure, Figure]:
    """Return distance and speed of one drive over time."""
    one, t = SHOWN * settings.runs, FOLLOWING_PERIOD_S * np.arange(1.0, len(drives.truth) + 1.0)
    panels = []
    for title, unit, column, channel in (("distance", "m", AHEAD, 0), ("speed", "m/s", AHEAD_RATE, 2)):
        lines = [
            Line("true", t, drives.truth[:, one, column]),
            Line("measured", t, drives.z[:, one, channel], dots=True),
        ]
        lines += [Line(n, t, drives.mean[n][:, one, column]) for n in ("SRCKF", "SH-EKF", "ISRCKF")]
        panels.append(Panel(f"longitudinal {title}", "time (s)", unit, tuple(lines)))
    kind, note = Kind.SURROGATE, "The first campus drive."
    return (
        Figure("Figure 5", "longitudinal distance over time", kind, (panels[0],), note),
        Figure("Figure 6", "longitudinal speed over time", kind, (panels[1],), note),
    )


def _by_drive(drives: Drives) -> tuple[Figure, Figure]:
    groups = np.arange(1.0, len(ENVIRONMENTS) * DRIVES + 1.0)

    def figure(number: str, what: str, unit: str, column: int) -> Figure:
        names = [n for n in MAKERS if "literal" not in n]
        lines = tuple(Line(n, groups, drives.rmse(n, column)) for n in names)
        panel = Panel(f"RMSE of {what}", "drive", unit, lines)
        return Figure(number, f"errors of the {what} by drive", Kind.SURROGATE, (panel,))

    return figure("Figure 7", "longitudinal speed", "m/s", AHEAD_RATE), figure(
        "Figure 8", "longitudinal distance", "m", AHEAD
    )


def _seconds(times: Table) -> Figure:
    place = np.arange(float(len(times.cells)))
    ours = np.array([c.ours or 0.0 for c in times.cells])
    names = ", ".join(c.row for c in times.cells)
    panel = Panel("one update", names, "s", (Line("ours", place, ours, dots=True),))
    return Figure("Figure 9", "time of one update", Kind.MEASURED, (panel,), "In the order of the table.")


ISRCKF = Paper("isrckf", 20, 1 + len(MAKERS) + 2 + STATE_STEPS, reproduce)
