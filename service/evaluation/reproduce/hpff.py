"""The HPFF paper: tables 2-6 and figures 4-7, one vehicle ahead in clutter.

Source: Pak 2021, "Hybrid PDA/FIR Filtering for Preceding Vehicle Tracking Using Automotive Radars".
"""

from __future__ import annotations

import numpy as np

from service.evaluation.reproduce import hpff_targets
from service.evaluation.reproduce.clutter_study import Case, Drives, Summary, drive, summarise
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
)
from service.evaluation.reproduce.hpff_words import CHANGED, CITATION, FAILS, HOLDS, NO_RESULTS
from service.simulation.preceding_vehicle import MOTIONS, PERIOD_S, Clutter, times_s
from service.tracking.filters.converted import planar_step
from service.tracking.filters.fir import FirWindow, fir_gains, fit_window
from service.tracking.filters.single_target import SingleTargetParameters
from service.tracking.model import F64

FITTED_MISSES = 1.0 / 3.0  # of the nominal 1 - P_D: fitted to tables 2-4, stated nowhere
PAPER_ACCEL_MPS2 = 0.2  # sigma_w, not stated: at 1 m/s^2 the PDAF would keep M8, of which it loses 99.8 %
MODERATE, HEAVY = 1e-2, 1e-1
P_D = (0.95, 0.90, 0.85, 0.80, 0.75, 0.70)
ROWS = ("position error (m)", "velocity error (m/s)", "lost tracks (%)")

# Position, velocity, lost of the PDAF and of the HPFF as the paper prints them.
Printed = tuple[tuple[float, float, float], tuple[float, float, float]]
PAPER: dict[tuple[str, float, float], Printed] = {
    ("M1", MODERATE, 0.95): ((0.56, 0.17, 0.6), (0.52, 0.29, 0.0)),
    ("M2", MODERATE, 0.95): ((0.57, 0.17, 0.6), (0.52, 0.28, 0.0)),
    ("M3", MODERATE, 0.95): ((0.59, 0.17, 0.7), (0.53, 0.29, 0.0)),
    ("M4", MODERATE, 0.95): ((3.23, 0.73, 3.2), (0.90, 0.68, 0.0)),
    ("M5", MODERATE, 0.95): ((3.34, 0.74, 3.1), (0.90, 0.67, 0.0)),
    ("M6", MODERATE, 0.95): ((3.33, 0.74, 3.2), (0.91, 0.68, 0.0)),
    ("M1", HEAVY, 0.95): ((1.39, 0.27, 5.7), (0.70, 0.31, 2.2)),
    ("M2", HEAVY, 0.95): ((1.48, 0.28, 6.1), (0.70, 0.31, 2.3)),
    ("M3", HEAVY, 0.95): ((1.38, 0.27, 5.9), (0.71, 0.31, 2.3)),
    ("M4", HEAVY, 0.95): ((3.08, 0.81, 18.0), (1.68, 0.91, 3.5)),
    ("M5", HEAVY, 0.95): ((2.71, 0.76, 17.4), (1.64, 0.89, 3.1)),
    ("M6", HEAVY, 0.95): ((2.96, 0.79, 18.1), (1.68, 0.91, 3.1)),
    ("M5", MODERATE, 0.90): ((3.96, 0.82, 4.1), (1.04, 0.83, 0.0)),
    ("M5", MODERATE, 0.85): ((4.02, 0.86, 4.3), (1.17, 0.97, 0.0)),
    ("M5", MODERATE, 0.80): ((4.24, 0.90, 5.3), (1.32, 1.12, 0.0)),
    ("M5", MODERATE, 0.75): ((4.45, 0.95, 5.6), (1.46, 1.25, 0.0)),
    ("M5", MODERATE, 0.70): ((4.73, 1.01, 6.8), (1.62, 1.39, 0.0)),
    ("M7", MODERATE, 0.95): ((3.35, 0.66, 35.6), (0.67, 0.85, 0.0)),
    ("M8", MODERATE, 0.95): ((24.97, 3.61, 99.8), (2.21, 2.04, 1.2)),
    ("M7", HEAVY, 0.95): ((3.87, 0.87, 40.5), (1.47, 1.42, 4.4)),
    ("M8", HEAVY, 0.95): ((19.32, 3.22, 99.8), (4.69, 2.53, 41.2)),
}
JUDGED_HEAVY = tuple((motion, HEAVY, P_D[0]) for motion in ("M4", "M5", "M6"))
MOTION_NAMES = tuple(MOTIONS)
_SWEEP = ((0.2, "M4"), (0.2, "M8"), (1.0, "M4"), (1.0, "M8"), (2.0, "M4"), (2.0, "M8"))
_COVARIANCE_ACCEL_MPS2 = (0.2, 2.0, 5.0)
_COVARIANCE_WINDOWS = 20_000
Studied = dict[str, Drives]


def reproduce(settings: Settings) -> Reproduction:
    """Return tables 2-6, figures 4-7, our additions and the bars."""
    fitted, literal = {}, {}
    examples: dict[str, Studied] = {}
    for place, case in enumerate(PAPER):
        studied = _study(case, FITTED_MISSES, settings, place)
        fitted[case] = {name: summarise(drives, MOTIONS[case[0]]) for name, drives in studied.items()}
        if case[1:] == (MODERATE, 0.95):
            examples[case[0]] = studied
        settings.advance(f"HPFF paper: {case[0]}, clutter {case[1]:g}, P_D {case[2]:g}")
        literal[case] = {
            n: summarise(d, MOTIONS[case[0]]) for n, d in _study(case, 1.0, settings, place).items()
        }
        settings.advance("the same with every miss")
    corrected = _corrected(settings)
    sweep = _sweep(settings)
    covariance = _covariance_table(settings)
    settings.advance("covariance of the FIR filter")
    several = hpff_targets.study(settings)
    tables = (
        *_paper_tables(fitted, literal),
        _rivals(fitted),
        sweep,
        covariance,
        hpff_targets.table(several),
        _likelihoods(corrected, fitted),
    )
    bars = (*_bars(fitted, corrected, covariance), *hpff_targets.bars(several))
    return Reproduction(
        "hpff", CITATION, settings.runs, settings.seed, (*tables, NO_RESULTS[0]),
        (*NO_RESULTS[1:], *_figures(examples)), bars, HOLDS, FAILS, CHANGED,
    )  # fmt: skip


def _study(
    case: tuple[str, float, float], misses: float, settings: Settings, place: int, *, printed: bool = True
) -> Studied:
    motion, density, p_d = case
    rivals = ("nnsf", "mvff") if p_d == P_D[0] and misses != 1.0 and printed else ()
    parameters = SingleTargetParameters(
        accel_std_mps2=PAPER_ACCEL_MPS2, detection_probability=p_d, printed_likelihood=printed
    )
    clutter = Clutter(per_m2=density, miss_share=misses * (1.0 - p_d))
    names = ("pdaf", "hpff", *rivals)
    return drive(names, Case(MOTIONS[motion], clutter, parameters), settings.runs, (settings.seed, place))


Summaries = dict[tuple[str, float, float], dict[str, Summary]]


def _corrected(settings: Settings) -> Summaries:
    """Return M4 to M6 in heavy clutter with |S| in eq. 15, on the drives of table 3."""
    out: Summaries = {}
    for place, case in enumerate(PAPER):
        if case in JUDGED_HEAVY:
            studied = _study(case, FITTED_MISSES, settings, place, printed=False)
            out[case] = {name: summarise(drives, MOTIONS[case[0]]) for name, drives in studied.items()}
            settings.advance(f"HPFF paper: {case[0]}, clutter {case[1]:g}, |S| in eq. 15")
    return out


def _likelihoods(corrected: Summaries, printed: Summaries) -> Table:
    cells = [
        Cell(f"{case[0]} {name.upper()}", row, PAPER[case][which][k], *ours, *literal)
        for case in JUDGED_HEAVY
        for which, name in enumerate(("pdaf", "hpff"))
        for k, (row, ours, literal) in enumerate(
            zip(ROWS, _rows(corrected[case][name]), _rows(printed[case][name]), strict=True)
        )
    ]
    note = (
        "Ours: the determinant of S, which the likelihood of an innovation has; the default in Python. "
        "Literal: |R|, as eq. 15 is printed; so are tables 2 to 6. The same drives, fitted misses."
    )
    return Table("Table E", "heavy clutter with both readings of eq. 15", Kind.OURS, tuple(cells), note)


def _paper_tables(fitted: Summaries, literal: Summaries) -> tuple[Table, ...]:
    constant, changing = MOTION_NAMES[:6], MOTION_NAMES[6:]
    wanted = (
        ("Table 2", "constant velocity, moderate clutter", [(m, MODERATE, 0.95) for m in constant]),
        ("Table 3", "constant velocity, heavy clutter", [(m, HEAVY, 0.95) for m in constant]),
        (
            "Table 4",
            "M5 in moderate clutter over the detection probability",
            [("M5", MODERATE, p) for p in P_D],
        ),
        ("Table 5", "abrupt changes, moderate clutter", [(m, MODERATE, 0.95) for m in changing]),
        ("Table 6", "abrupt changes, heavy clutter", [(m, HEAVY, 0.95) for m in changing]),
    )
    note = "Fitted reading: a third of the nominal misses. Literal reading: all of them."
    tables = []
    for number, title, cases in wanted:
        by_p = number == "Table 4"
        cells = [
            cell
            for case in cases
            for which, name in enumerate(("pdaf", "hpff"))
            for cell in _cells(
                case,
                which,
                fitted[case][name],
                literal[case][name],
                f"P_D {case[2]:.2f}" if by_p else case[0],
            )
        ]
        tables.append(Table(number, title, Kind.SIMULATED, tuple(cells), note))
    return tuple(tables)


def _cells(
    case: tuple[str, float, float], which: int, ours: Summary, literal: Summary, head: str
) -> list[Cell]:
    filter_name = ("PDAF", "HPFF")[which]
    remark = ""
    if case[0] == "M7":
        remark = "shape and speed of the lane change are not stated"
    elif case[:2] == ("M8", MODERATE) and which == 1:
        remark = "sigma_w is not stated"
    return [
        Cell(f"{head} {filter_name}", row, PAPER[case][which][k], *value, *full, remark=remark)
        for k, (row, value, full) in enumerate(zip(ROWS, _rows(ours), _rows(literal), strict=True))
    ]


def _summary_cells(head: str, s: Summary) -> list[Cell]:
    return [Cell(head, row, None, *value) for row, value in zip(ROWS, _rows(s), strict=True)]


def _rows(s: Summary) -> tuple[tuple[float, float], ...]:
    """Return the values of `ROWS` and their standard errors."""
    return (
        (s.position_m, s.position_se_m),
        (s.velocity_mps, s.velocity_se_mps),
        (s.lost_percent, s.lost_se_percent),
    )


def _rivals(fitted: Summaries) -> Table:
    cells = [
        cell
        for case in fitted
        for name in ("nnsf", "mvff")
        if name in fitted[case]
        for cell in _summary_cells(
            f"{case[0]} {'heavy' if case[1] == HEAVY else 'moderate'} {name.upper()}", fitted[case][name]
        )
    ]
    return Table("Table A", "the two other filters that the paper names", Kind.OURS, tuple(cells))


def _sweep(settings: Settings) -> Table:
    cells: list[Cell] = []
    for accel, motion in _SWEEP:
        p = SingleTargetParameters(accel_std_mps2=accel)
        studied = drive(
            ("pdaf", "hpff"), Case(MOTIONS[motion], Clutter(), p), settings.runs, (settings.seed, 100)
        )
        for name in ("pdaf", "hpff"):
            cells += _summary_cells(
                f"sigma_w {accel:g}, {motion} {name.upper()}", summarise(studied[name], MOTIONS[motion])
            )
        settings.advance(f"HPFF paper: sigma_w {accel:g} m/s^2, {motion}")
    note = "Nominal misses, determinant of S in eq. 15: at a sensible sigma_w the PDAF keeps most targets."
    return Table("Table B", "the gain over the process noise", Kind.OURS, tuple(cells), note)


def _covariance_table(settings: Settings) -> Table:
    """Return sampled over claimed trace of position and velocity covariance of the FIR filter."""
    rng = np.random.default_rng((settings.seed, 200))
    R = np.diag([0.5, 1.0])
    cells: list[Cell] = []
    for accel in _COVARIANCE_ACCEL_MPS2:
        x, window = _sampled_windows(accel, R, rng)
        error = fit_window(window, PERIOD_S, accel).mean - x
        _, claimed, printed = fir_gains(window.R[0], PERIOD_S, accel)
        for part, name in ((slice(0, 2), "position"), (slice(2, 4), "velocity")):
            squared = np.sum(error[:, part] ** 2, axis=1)
            head = f"sigma_w {accel:g}, {name}"
            for what, cov in (("J M^-1 J'", claimed), ("as printed", printed)):
                share = mean_and_error(squared / np.trace(cov[part, part]))
                cells.append(Cell(head, f"sampled / {what}", None, *share))
    note = f"{_COVARIANCE_WINDOWS} windows of four scans, R = diag(0.5, 1.0) m^2. 1 is right."
    return Table("Table C", "the covariance of the FIR filter (eq. 26)", Kind.OURS, tuple(cells), note)


def _sampled_windows(accel_std_mps2: float, R: F64, rng: np.random.Generator) -> tuple[F64, FirWindow]:
    """Return true states one step after windows of four scans, and the windows."""
    n, scans = _COVARIANCE_WINDOWS, SingleTargetParameters().horizon
    A, _ = planar_step(PERIOD_S, accel_std_mps2)
    G = np.vstack([np.eye(2) * PERIOD_S**2 / 2, np.eye(2) * PERIOD_S])
    x = np.tile([5.0, 60.0, 0.0, -4.0], (n, 1))
    z = np.empty((n, scans, 2))
    for k in range(scans):
        z[:, k] = x[:, :2] + rng.standard_normal((n, 2)) @ np.sqrt(R)
        x = x @ A.T + accel_std_mps2 * rng.standard_normal((n, 2)) @ G.T
    return x, FirWindow(z, np.broadcast_to(R, (n, scans, 2, 2)), np.ones((n, scans), np.bool_))


def _heavy_bar(summaries: Summaries, name: str, reading: str, low: float, high: float) -> Bar:
    """Return the bar of the lost tracks in heavy clutter.

    M4 to M6 are one motion in three lanes, and thrice the runs halve the error of a few per cent.
    """
    each = [summaries[case][name] for case in JUDGED_HEAVY]
    error = float(np.sqrt(sum(s.lost_se_percent**2 for s in each))) / len(each)
    value = float(np.mean([s.lost_percent for s in each]))
    return Bar(f"M4-M6 heavy: {name.upper()} lost (%), eq. 15 {reading}", value, low, high, error)


def _bars(fitted: Summaries, corrected: Summaries, covariance: Table) -> tuple[Bar, ...]:
    m4, m8 = fitted["M4", MODERATE, 0.95], fitted["M8", MODERATE, 0.95]
    ratios = [c for c in covariance.cells if c.column.endswith("J'")]
    return (
        Bar("M4 moderate: HPFF lost (%)", m4["hpff"].lost_percent, high=0.3),
        Bar("M4 moderate: HPFF position (m)", m4["hpff"].position_m, high=1.0),
        Bar("M4 moderate: PDAF lost (%)", m4["pdaf"].lost_percent, 2.0, 4.5),
        Bar("M8 moderate: HPFF lost (%)", m8["hpff"].lost_percent, high=1.5),
        Bar("M8 moderate: PDAF lost (%)", m8["pdaf"].lost_percent, low=98.0),
        *(
            _heavy_bar(summaries, name, reading, low, high)
            for name, low, high in (("hpff", -np.inf, 4.0), ("pdaf", 10.0, 20.0))
            for reading, summaries in (("as printed, |R|", fitted), ("as corrected, |S|", corrected))
        ),
        *(Bar(f"FIR sampled / claimed, {c.row}", c.ours or 0.0, 0.9, 1.1) for c in ratios),
    )


def _figures(examples: dict[str, Studied]) -> tuple[Figure, ...]:
    wanted = (
        ("Figure 4", "M5, a drive that the PDAF keeps", "M5", False),
        ("Figure 5", "M6, a drive that the PDAF loses and the FIR filter saves", "M6", True),
        ("Figure 6", "M7, two lanes aside", "M7", True),
        ("Figure 7", "M8, the gap closes and stays", "M8", True),
    )
    return tuple(
        _example(number, title, motion, examples[motion], rescued=rescued)
        for number, title, motion, rescued in wanted
    )


def _example(number: str, title: str, motion: str, studied: Studied, *, rescued: bool) -> Figure:
    """Return the first drive of the kind that the figure shows."""
    resets = studied["hpff"].reset.sum(axis=0)
    held = {name: drives.held[-20:].any(axis=0) for name, drives in studied.items()}
    fits = (~held["pdaf"] & held["hpff"] & (resets > 0)) if rescued else (held["pdaf"] & (resets == 0))
    if not fits.any():
        return Figure(number, title, Kind.SIMULATED, note="No drive of this kind among so few runs.")
    one, t, truth = int(fits.argmax()), times_s(), MOTIONS[motion]
    paths = [Line("true", truth[:, 1], truth[:, 0])]
    errors: tuple[list[Line], list[Line]] = ([], [])
    for name in ("pdaf", "hpff"):
        mean = studied[name].mean[:, one]
        paths.append(Line(name.upper(), mean[:, 1], mean[:, 0]))
        for k, lines in enumerate(errors):
            gap = (mean - truth)[:, 2 * k : 2 * k + 2]
            lines.append(Line(name.upper(), t, np.hypot(gap[:, 0], gap[:, 1])))
    reset = Line("reset", t, studied["hpff"].reset[:, one].astype(np.float64))
    panels = (
        Panel("(a) true and estimated positions", "ahead (m)", "aside (m)", tuple(paths)),
        Panel("(b) position error", "time (s)", "m", tuple(errors[0])),
        Panel("(c) velocity error", "time (s)", "m/s", tuple(errors[1])),
        Panel("(d) reset timing", "time (s)", "", (reset,)),
    )
    return Figure(number, title, Kind.SIMULATED, panels, f"Run {one}, {int(resets[one])} resets.")


HPFF = Paper(
    "hpff", 1000, 2 * len(PAPER) + len(JUDGED_HEAVY) + len(_SWEEP) + 1 + hpff_targets.STEPS, reproduce
)
