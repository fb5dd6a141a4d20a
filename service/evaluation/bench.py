"""Measure one step of the tracker, points to tracks, and each of its stages, under growing load.

A shared machine is never equally fast twice, so every time stands beside one numpy product of two 6 x 6
matrices measured between the same steps, and is given as a multiple of it too. The loads take turns of a few
steps, so that a slow minute slows all of them. The tracker is timed alone; a second run through the fold,
which is what happens live and offline, tells what that adds: order, rows, traffic (the stage "fold"; the
stage "traffic" is that part of it, taken once more).
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
from typing import Protocol

import numpy as np

from service.evaluation.report import Grid
from service.evaluation.steady import Load, steady_frames
from service.tracking import tracker
from service.tracking.model import Frame, StepReport, TrackEstimates
from service.tracking.parameters import TrackerParameters
from service.tracking.state import TrackerState

Clock = Callable[[], float]

LOADS = (Load(30, 140), Load(60, 260), Load(120, 500))
STAGES = (*tracker.STAGES, "fold", "traffic")  # the last two only where a fold is given
_SEED = 1
_PRODUCTS = 100  # products for one reading of the clock, which is too coarse for one
_TURN = 20  # steps of one load before the next one has its turn
_PROFILE_LINES = 30


class Folding(Protocol):
    """What carries frames through the whole fold and notes what each step took beside the tracker's."""

    @property
    def added_s(self) -> list[float]:
        """Return the seconds beside the tracker's, by step."""
        ...

    @property
    def traffic_s(self) -> list[float]:
        """Return the seconds of traffic analysis among them, by step."""
        ...

    def advance(self, begin: int, end: int) -> None:
        """Take the steps of the frames begin:end."""
        ...


MakeFolding = Callable[[list[Frame], TrackerParameters, Clock], Folding]


@dataclass(frozen=True, slots=True)
class StageTiming:
    """The time of one stage in one step."""

    name: str
    median_s: float
    p99_s: float


@dataclass(frozen=True, slots=True)
class Timing:
    """The time of one step under one load."""

    load: Load
    tracks: int  # confirmed after the last step: shows that the work was done
    median_s: float  # of the tracker's step, points to tracks
    p99_s: float
    product_s: float  # one 6 x 6 product, median over the same run
    stages: tuple[StageTiming, ...] = ()

    @property
    def products(self) -> float:
        """Return the median as a multiple of one product."""
        return self.median_s / self.product_s


def bench(  # noqa: PLR0913 - five that all have defaults
    loads: Sequence[Load] = LOADS,
    *,
    parameters: TrackerParameters | None = None,
    warm_up: int = 100,
    steps: int = 300,
    clock: Clock = time.perf_counter,
    fold: MakeFolding | None = None,
) -> list[Timing]:
    """Time `steps` steps under each load, after `warm_up` steps that do not count (compilation, births)."""
    chosen = parameters if parameters is not None else TrackerParameters()
    frames = [steady(load, warm_up + steps, chosen) for load in loads]
    alone = [Run(each, chosen, clock) for each in frames]
    folded = [None if fold is None else fold(each, chosen, clock) for each in frames]
    for begin in range(0, warm_up + steps, _TURN):
        for run in alone:
            run.advance(begin, begin + _TURN)
    for begin in range(0, warm_up + steps, _TURN):
        for whole in folded:
            if whole is not None:
                whole.advance(begin, begin + _TURN)
    runs = zip(loads, alone, folded, strict=True)
    return [run.timing(load, warm_up, whole) for load, run, whole in runs]


def bench_frames(
    frames: list[Frame],
    parameters: TrackerParameters,
    *,
    warm_up: int,
    clock: Clock = time.perf_counter,
    fold: MakeFolding | None = None,
) -> Timing:
    """Time the steps of recorded frames after `warm_up`; the load is the median of what was there."""
    run, tracks = Run(frames, parameters, clock), []
    folded = None if fold is None else fold(frames, parameters, clock)
    for place in range(len(frames)):
        run.advance(place, place + 1)
        tracks.append(run.tracks)
    if folded is not None:
        folded.advance(0, len(frames))
    points = [len(frame) for frame in frames[warm_up:]]
    return run.timing(Load(int(np.median(tracks[warm_up:])), int(np.median(points))), warm_up, folded)


@dataclass(slots=True)
class Watched:
    """The tracker, with the time of each of its stages in the newest step."""

    clock: Clock
    spent_s: dict[str, float] = field(default_factory=dict)

    def initial_state(self, parameters: TrackerParameters | None = None) -> TrackerState:
        """Return the state before the first frame."""
        return tracker.initial_state(parameters)

    def step(
        self, state: TrackerState, frame: Frame, parameters: TrackerParameters
    ) -> tuple[TrackerState, TrackEstimates, StepReport]:
        """Take a step and note when each stage is done."""
        marks: list[tuple[str, float]] = [("", self.clock())]

        def watch(stage: str) -> None:
            marks.append((stage, self.clock()))

        result = tracker.step(state, frame, parameters, watch=watch)
        self.spent_s = dict.fromkeys(tracker.STAGES, 0.0)
        for (_, before), (stage, after) in pairwise(marks):
            self.spent_s[stage] += after - before
        return result

    def coast(
        self, state: TrackerState, time_us: int, parameters: TrackerParameters
    ) -> tuple[TrackerState, TrackEstimates, StepReport]:
        """Let time pass without a frame."""
        return tracker.coast(state, time_us, parameters)


class Run:
    """The tracker under one load, and the readings taken so far."""

    def __init__(self, frames: list[Frame], parameters: TrackerParameters, clock: Clock) -> None:
        self._frames = frames
        self._parameters = parameters
        self._engine = Watched(clock)
        self._state = tracker.initial_state(parameters)
        self._product_s: list[float] = []
        self._stage_s: list[list[float]] = []  # by step, in the order of the tracker's stages
        self.tracks = 0  # confirmed after the newest step

    def advance(self, begin: int, end: int) -> None:
        """Take the steps of the frames begin:end."""
        matrix, clock = np.eye(6) + 0.01, self._engine.clock
        for frame in self._frames[begin:end]:
            self._state, estimates, _ = self._engine.step(self._state, frame, self._parameters)
            before = clock()
            for _ in range(_PRODUCTS):
                _ = matrix @ matrix
            self._product_s.append((clock() - before) / _PRODUCTS)
            self._stage_s.append([self._engine.spent_s[name] for name in tracker.STAGES])
            self.tracks = len(estimates)

    def timing(self, load: Load, warm_up: int, folded: Folding | None) -> Timing:
        """Return the result of the steps after `warm_up`, with what the fold adds."""
        stages = np.array(self._stage_s[warm_up:])
        steps = stages.sum(axis=1)
        columns = list(stages.T)
        if folded is not None:
            columns += [np.array(seconds[warm_up:]) for seconds in (folded.added_s, folded.traffic_s)]
        return Timing(
            load=load,
            tracks=self.tracks,
            median_s=float(np.median(steps)),
            p99_s=float(np.percentile(steps, 99)),
            product_s=float(np.median(self._product_s[warm_up:])),
            stages=tuple(
                StageTiming(name, float(np.median(column)), float(np.percentile(column, 99)))
                for name, column in zip(STAGES, columns, strict=False)
            ),
        )


def steady(load: Load, count: int, parameters: TrackerParameters) -> list[Frame]:
    """Return frames of a load, the same ones every time."""
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


def stage_grid(timings: Sequence[Timing]) -> Grid:
    """Return the stages as a table, a row for each; median and p99 under each load, and in products."""
    heads = ["stage"]
    for t in timings:
        heads += [f"{t.load.vehicles} vehicles, us", "p99 us", "6x6"]
    rows = []
    for place, first in enumerate(timings[0].stages):
        row = [first.name]
        for t in timings:
            stage = t.stages[place]
            row += [
                f"{1e6 * stage.median_s:.0f}", f"{1e6 * stage.p99_s:.0f}",
                f"{stage.median_s / t.product_s:.0f}",
            ]  # fmt: skip
        rows.append(tuple(row))
    return Grid(tuple(heads), tuple(rows))


def profile(
    load: Load, *, parameters: TrackerParameters | None = None, warm_up: int = 100, steps: int = 100
) -> str:
    """Return where the time of the steps goes: the functions with the largest own time."""
    chosen = parameters if parameters is not None else TrackerParameters()
    frames = steady(load, warm_up + steps, chosen)
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
