"""The common form of a reproduced paper: its tables and figures beside ours, bars, and plain statements."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from service.tracking.model import F64


class Kind(Enum):
    """Where our side of a table or figure comes from."""

    SIMULATED = "simulated, as in the paper"
    SURROGATE = "simulated surrogate: the paper's field data are unpublished"
    MEASURED = "measured on this machine"
    UNPUBLISHED = "not reproducible: data unpublished"
    NO_RESULT = "shows no result"
    OURS = "ours, not in the paper"


@dataclass(frozen=True, slots=True)
class Cell:
    """One number of a table: the paper's and ours."""

    row: str
    column: str
    paper: float | None
    ours: float | None
    error: float | None = None  # Monte-Carlo standard error of ours; None: not sampled, as `exact` says
    literal: float | None = None  # under the literal reading, where that is another one
    literal_error: float | None = None  # its standard error
    bound: float | None = None  # posterior Cramer-Rao bound under the printed settings
    remark: str = ""  # why it cannot be matched
    exact: str = ""  # why ours has no standard error

    @property
    def ratio(self) -> float | None:
        """Return ours over the paper's, None where either is missing."""
        if self.paper is None or self.ours is None or self.paper == 0.0:
            return None
        return self.ours / self.paper


@dataclass(frozen=True, slots=True)
class Table:
    """One table of the paper, or one of ours."""

    number: str
    title: str
    kind: Kind
    cells: tuple[Cell, ...] = ()
    note: str = ""


@dataclass(frozen=True, slots=True)
class Line:
    """One curve."""

    name: str
    x: F64
    y: F64
    dots: bool = False


@dataclass(frozen=True, slots=True)
class Panel:
    """One pair of axes."""

    title: str
    x_label: str
    y_label: str
    lines: tuple[Line, ...]


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure of the paper."""

    number: str
    title: str
    kind: Kind
    panels: tuple[Panel, ...] = ()
    note: str = ""


@dataclass(frozen=True, slots=True)
class Bar:
    """One of our numbers and the interval in which it must lie."""

    name: str
    value: float
    low: float = -math.inf
    high: float = math.inf
    error: float | None = None  # Monte-Carlo standard error of the value, where no cell has it

    @property
    def holds(self) -> bool:
        """Tell whether the value lies in the interval; NaN does not."""
        return self.low <= self.value <= self.high


@dataclass(frozen=True, slots=True)
class Reproduction:
    """A paper's results beside ours."""

    paper: str  # name on the command line
    citation: str
    runs: int
    seed: int
    tables: tuple[Table, ...]
    figures: tuple[Figure, ...]
    bars: tuple[Bar, ...]
    holds: tuple[str, ...]  # statements
    fails: tuple[str, ...]
    changed: tuple[str, ...]


_RESAMPLES = 1000  # of a bootstrap
Advance = Callable[[str], None]  # called after each step of the work, with what it was


@dataclass(frozen=True, slots=True)
class Settings:
    """How much work a reproduction is."""

    runs: int
    seed: int = 1
    advance: Advance = lambda _: None


@dataclass(frozen=True, slots=True)
class Paper:
    """One paper that can be reproduced."""

    name: str
    default_runs: int
    steps: int  # calls of `advance` in one reproduction
    reproduce: Callable[[Settings], Reproduction]


def sentences(text: str) -> tuple[str, ...]:
    """Return the paragraphs of a text, each on one line."""
    return tuple(" ".join(paragraph.split()) for paragraph in text.strip().split("\n\n"))


def mean_and_error(samples: F64 | Sequence[float]) -> tuple[float, float]:
    """Return the mean and its standard error of independent runs."""
    values = np.asarray(samples, np.float64)
    return float(values.mean()), float(
        values.std(ddof=1) / math.sqrt(values.size)
    ) if values.size > 1 else math.nan


def median_and_error(samples: F64 | Sequence[float]) -> tuple[float, float]:
    """Return the median of independent runs and its standard error, by the bootstrap (Efron 1979)."""
    values = np.asarray(samples, np.float64)
    drawn = np.random.default_rng(0).choice(values, (_RESAMPLES, values.size))
    error = float(np.median(drawn, axis=1).std(ddof=1)) if values.size > 1 else math.nan
    return float(np.median(values)), error


def ratio_of_rms(ours: F64, theirs: F64) -> tuple[float, float]:
    """Return the root of the ratio of two means of squares (N,) of the same runs, and its standard error.

    Both filters see the same noise, so the error is that of the differences, to first order.
    """
    ratio = float(np.sqrt(ours.mean() / theirs.mean()))
    return ratio, ratio / 2.0 * mean_and_error(ours / ours.mean() - theirs / theirs.mean())[1]


def rms_over_time(squared: F64) -> tuple[float, float]:
    """Return the time mean of the RMSE over runs, and its standard error; squared errors (K, N).

    The error is that of the jackknife over the runs, whose errors are correlated in time.
    """
    runs = squared.shape[1]
    value = float(np.sqrt(squared.mean(axis=1)).mean())
    if runs < 2:  # noqa: PLR2004 - one run has no spread
        return value, math.nan
    without = (squared.sum(axis=1, keepdims=True) - squared) / (runs - 1)
    left_out = np.sqrt(np.maximum(without, 0.0)).mean(axis=0)
    return value, float(np.sqrt((runs - 1) / runs * np.sum((left_out - left_out.mean()) ** 2)))
