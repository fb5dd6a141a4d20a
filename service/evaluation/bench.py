"""Measure one step of the tracker, points to tracks, under growing load.

A shared machine is never equally fast twice, so every time stands beside one numpy product of two 6 x 6
matrices measured between the same steps, and is given as a multiple of it too. The loads take turns of a few
steps, so that a slow minute slows all of them.
"""

from __future__ import annotations

import cProfile
import io
import math
import pstats
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from service.evaluation.report import Grid
from service.evaluation.steady import Load, steady_frames
from service.tracking import tracker
from service.tracking.model import Frame
from service.tracking.parameters import TrackerParameters
from service.tracking.state import TrackerState

Clock = Callable[[], float]

LOADS = (Load(30, 140), Load(60, 260), Load(120, 500))
_SEED = 1
_PRODUCTS = 100  # products for one reading of the clock, which is too coarse for one
_TURN = 20  # steps of one load before the next one has its turn
_PROFILE_LINES = 30


@dataclass(frozen=True, slots=True)
class Timing:
    """The time of one step under one load."""

    load: Load
    tracks: int  # confirmed after the last step: shows that the work was done
    median_s: float
    p99_s: float
    product_s: float  # one 6 x 6 product, median over the same run

    @property
    def products(self) -> float:
        """Return the median as a multiple of one product."""
        return self.median_s / self.product_s


def bench(
    loads: Sequence[Load] = LOADS,
    *,
    parameters: TrackerParameters | None = None,
    warm_up: int = 100,
    steps: int = 300,
    clock: Clock = time.perf_counter,
) -> list[Timing]:
    """Time `steps` steps under each load, after `warm_up` steps that do not count (compilation, births)."""
    chosen = parameters if parameters is not None else TrackerParameters()
    runs = [_Run(_frames(load, warm_up + steps, chosen), tracker.initial_state(chosen)) for load in loads]
    for begin in range(0, warm_up + steps, _TURN):
        for run in runs:
            run.advance(begin, begin + _TURN, chosen, clock)
    return [run.timing(load, warm_up) for run, load in zip(runs, loads, strict=True)]


@dataclass(slots=True)
class _Run:
    """The tracker under one load, and the readings taken so far."""

    frames: list[Frame]
    state: TrackerState
    tracks: int = 0
    step_s: list[float] = field(default_factory=list)
    product_s: list[float] = field(default_factory=list)

    def advance(self, begin: int, end: int, parameters: TrackerParameters, clock: Clock) -> None:
        """Take the steps of the frames begin:end."""
        matrix = np.eye(6) + 0.01
        for frame in self.frames[begin:end]:
            before = clock()
            self.state, estimates, _ = tracker.step(self.state, frame, parameters)
            after = clock()
            for _ in range(_PRODUCTS):
                _ = matrix @ matrix
            self.product_s.append((clock() - after) / _PRODUCTS)
            self.step_s.append(after - before)
            self.tracks = len(estimates)

    def timing(self, load: Load, warm_up: int) -> Timing:
        """Return the result of the steps after `warm_up`."""
        counted = np.array(self.step_s[warm_up:])
        return Timing(
            load=load,
            tracks=self.tracks,
            median_s=float(np.median(counted)),
            p99_s=float(np.percentile(counted, 99)),
            product_s=float(np.median(self.product_s[warm_up:])),
        )


def _frames(load: Load, count: int, parameters: TrackerParameters) -> list[Frame]:
    return steady_frames(load, count, parameters.sensor, np.random.default_rng(_SEED))


def growth(timings: Sequence[Timing]) -> list[float]:
    """Return the power of the number of vehicles with which the median grows from each load to the next."""
    return [
        math.log(after.median_s / before.median_s) / math.log(after.load.vehicles / before.load.vehicles)
        for before, after in pairwise(timings)
    ]


def grid(timings: Sequence[Timing]) -> Grid:
    """Return the timings as a table, a row for each load."""
    heads = ("vehicles", "points", "tracks", "median ms", "p99 ms", "6x6 us", "median in 6x6", "growth")
    powers = ["", *(f"n^{power:.2f}" for power in growth(timings))]
    rows = tuple(
        (
            str(t.load.vehicles),
            str(t.load.points),
            str(t.tracks),
            f"{1e3 * t.median_s:.2f}",
            f"{1e3 * t.p99_s:.2f}",
            f"{1e6 * t.product_s:.2f}",
            f"{t.products:.0f}",
            power,
        )
        for t, power in zip(timings, powers, strict=True)
    )
    return Grid(heads, rows)


def profile(
    load: Load, *, parameters: TrackerParameters | None = None, warm_up: int = 100, steps: int = 100
) -> str:
    """Return where the time of the steps goes: the functions with the largest own time."""
    chosen = parameters if parameters is not None else TrackerParameters()
    frames = _frames(load, warm_up + steps, chosen)
    state = tracker.initial_state(chosen)
    for frame in frames[:warm_up]:
        state, _, _ = tracker.step(state, frame, chosen)
    profiler = cProfile.Profile()
    profiler.enable()
    for frame in frames[warm_up:]:
        state, _, _ = tracker.step(state, frame, chosen)
    profiler.disable()
    text = io.StringIO()
    pstats.Stats(profiler, stream=text).sort_stats("tottime").print_stats(_PROFILE_LINES)
    return text.getvalue()
