"""The motion states of the ISRCKF paper's section 5: parked, reversing, stopped, forward, stopped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.evaluation.reproduce.form import Cell, Figure, Kind, Line, Panel, Table, mean_and_error
from service.tracking.model import F64, MotionState, TrackEstimates, TrackStatus
from service.traffic.assignment import chart_of
from service.traffic.measured import measured_of
from service.traffic.model import NO_MAP, Moment
from service.traffic.motion_state import MotionParameters, classify
from service.traffic.vehicles import aligned, no_vehicles

STEPS = 1
RATE_HZ = 25.0
_NOISE_MPS = 0.05
_ALIKE = 0.9  # share of the drives that must have the paper's changes
# The curve of figure 10 is not published as numbers: pieces of 1 m/s^2 that pass 0.5 m/s just before the
# paper's times.
_CORNERS_S = (0.0, 1.7, 5.7, 10.9, 14.9, 18.8, 22.8, 24.8, 28.8, 30.0)
_SPEEDS_MPS = (0.0, 0.0, -4.0, -4.0, 0.0, 0.0, 4.0, 4.0, 0.0, 0.0)
PRINTED_S = (
    ("ONCOMING", 2.3), ("START_STOP", 14.5), ("STATIONARY", 16.5), ("MOVING", 19.4), ("START_STOP", 28.4),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Judged:
    """The measured speed and the state of each frame, and when the state changed."""

    time_s: F64
    speed_mps: F64
    state: F64
    changes: tuple[tuple[str, float], ...]

    @property
    def worst_s(self) -> float:
        """Return the largest error of a time, infinite when the states are not the paper's."""
        ours = self.changes[-len(PRINTED_S) :]
        if [name for name, _ in ours] != [name for name, _ in PRINTED_S]:
            return float("inf")
        return max(abs(t - wanted) for (_, t), (_, wanted) in zip(ours, PRINTED_S, strict=True))


def judge_all(runs: int, seed: int) -> list[Judged]:
    """Return the states of `runs` drives, which differ in the noise of the speed."""
    return [judge(seed, run) for run in range(runs)]


def judge(seed: int, run: int = 0) -> Judged:
    """Return the states of one drive."""
    t = np.arange(0.0, 30.0, 1.0 / RATE_HZ)
    speed = np.interp(t, _CORNERS_S, _SPEEDS_MPS)
    speed = speed + np.random.default_rng((seed, 500, run)).normal(0.0, _NOISE_MPS, len(t))
    vehicles, nowhere, states = no_vehicles(), chart_of(NO_MAP), []
    for k, v in enumerate(speed):
        now = _one_vehicle(float(v))
        measured = measured_of(now)
        vehicles = aligned(vehicles, now.number)
        moment = Moment(round(1e6 * k / RATE_HZ), k, tick=False)
        states.append(int(classify(vehicles, moment, measured, nowhere, 0.0, MotionParameters())[0]))
    changes = [
        (MotionState(b).name, float(s)) for a, b, s in zip(states, states[1:], t[1:], strict=False) if a != b
    ]
    return Judged(t, speed, np.array(states, np.float64), tuple(changes))


def _one_vehicle(speed_mps: float) -> TrackEstimates:
    """Return the estimate of a vehicle at (0, 60) m that drives along y."""

    def column(value: float) -> np.ndarray[tuple[int], np.dtype[np.float32]]:
        return np.full(1, value, np.float32)

    return TrackEstimates(
        number=np.ones(1, np.int64), x_m=column(0.0), y_m=column(60.0), vx_mps=column(0.0),
        vy_mps=column(speed_mps), std_x_m=column(0.2), std_y_m=column(0.2), cov_xy_m2=column(0.0),
        heading_rad=column(0.0), length_m=column(4.5), width_m=column(1.9), existence=column(0.99),
        status=np.full(1, TrackStatus.CONFIRMED, np.uint8), lane=np.zeros(1, np.uint8),
        motion=np.zeros(1, np.uint8), hits=np.full(1, 50), born_us=np.zeros(1, np.int64),
    )  # fmt: skip


def alike(judged: Sequence[Judged]) -> list[Judged]:
    """Return the drives that have the paper's changes."""
    return [j for j in judged if np.isfinite(j.worst_s)]


def worst_mean(judged: Sequence[Judged]) -> tuple[float, float]:
    """Return the largest error of a mean time over the drives [s], and its standard error.

    Infinite when less than nine drives in ten have the paper's changes.
    """
    if len(alike(judged)) < _ALIKE * len(judged):
        return float("inf"), float("nan")
    cells = states_table(judged).cells
    return max((abs((c.ours or 0.0) - (c.paper or 0.0)), c.error or 0.0) for c in cells)


def states_table(judged: Sequence[Judged]) -> Table:
    """Return the mean times of the changes of state over the drives that have the paper's changes."""
    ours = [j.changes[-len(PRINTED_S) :] for j in alike(judged)]
    cells = [
        Cell(
            f"{k + 1}: {name.lower().replace('_', '-')}",
            "time (s)",
            wanted,
            *mean_and_error([changes[k][1] for changes in ours]),
        )
        for k, (name, wanted) in enumerate(PRINTED_S)
        if ours
    ]
    off = [
        abs(t - wanted) for changes in ours for (_, t), (_, wanted) in zip(changes, PRINTED_S, strict=True)
    ]
    note = (
        f"Mean over drives that differ in the noise of the speed; {len(ours)} of {len(judged)} have the "
        f"paper's changes. Single times are off by {max(off, default=0.0):.2f} s at most. The speed curve is "
        "put together so that it passes 0.5 m/s just before the printed times."
    )
    return Table(
        "Figures 10, 11 in numbers", "changes of the motion state", Kind.SURROGATE, tuple(cells), note
    )


def states_figures(judged: Judged) -> tuple[Figure, Figure]:
    """Return figures 10 and 11."""
    speed = Panel("absolute speed", "time (s)", "m/s", (Line("measured", judged.time_s, judged.speed_mps),))
    names = ", ".join(f"{state.value} {state.name.lower()}" for state in MotionState)
    state = Panel("motion state", "time (s)", names, (Line("state", judged.time_s, judged.state),))
    return (
        Figure("Figure 10", "absolute speed of the vehicle ahead", Kind.SURROGATE, (speed,)),
        Figure("Figure 11", "its motion state", Kind.SURROGATE, (state,)),
    )
