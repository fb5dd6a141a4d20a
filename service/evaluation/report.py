"""Turn scores into tables, notes that name the worst first, and JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rich.table import Table

from service.evaluation.measures import MEASURES, Measure, Value, with_rates

_NOTHING = "-"
_PERCENT = 100


@dataclass(frozen=True, slots=True)
class Grid:
    """A table as text: heads and rows of cells, the first column the names."""

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class Verdict:
    """One score held against its bar."""

    scene: str
    measure: Measure
    value: float

    @property
    def excess(self) -> float:
        """Return by which share the value misses its floor; negative or zero: it holds."""
        floor = self.measure.floor or math.nan
        miss = floor - self.value if self.measure.higher_is_better else self.value - floor
        return miss / abs(floor)

    @property
    def holds(self) -> bool:
        """Tell whether the floor is reached."""
        return self.excess <= 0

    @property
    def reaches_aim(self) -> bool:
        """Tell whether the aim is reached."""
        aim = self.measure.aim
        if aim is None:
            return False
        return self.value >= aim if self.measure.higher_is_better else self.value <= aim

    def sentence(self) -> str:
        """Return the verdict in words."""
        value, floor = _number(self.value, self.measure.decimals), self.measure.floor
        head = f"{self.scene}: {self.measure.title} {value}"
        if not self.holds:
            return f"{head} misses the floor of {floor:g} by {self.excess * _PERCENT:.0f} %"
        if self.reaches_aim:
            return f"{head} reaches the aim of {self.measure.aim:g}"
        return f"{head} keeps the floor of {floor:g}, not the aim of {self.measure.aim:g}"


def by_scene(results: Sequence[Mapping[str, Value]], measures: Sequence[Measure]) -> Grid:
    """Return one row for each result and one narrow column for each measure."""
    full = [with_rates(result) for result in results]
    rows = tuple(
        (str(result.get("scene", _NOTHING)), *(_cell(result, measure) for measure in measures))
        for result in full
    )
    return Grid(("scene", *(measure.short for measure in measures)), rows)


def cells(result: Mapping[str, Value], measures: Sequence[Measure]) -> tuple[str, ...]:
    """Return the values of a result as they stand in a table."""
    full = with_rates(result)
    return tuple(_cell(full, measure) for measure in measures)


def by_measure(results: Sequence[Mapping[str, Value]], measures: Sequence[Measure] = MEASURES) -> Grid:
    """Return one row for each measure that any result has, its bars, and one column for each result."""
    full = [with_rates(result) for result in results]
    heads = ("measure", *(str(result.get("scene", _NOTHING)) for result in full), "floor", "aim")
    rows = tuple(
        (measure.title, *(_cell(result, measure) for result in full), _bar(measure.floor), _bar(measure.aim))
        for measure in measures
        if any(measure.key in result for result in full)
    )
    return Grid(heads, rows)


def verdicts(results: Sequence[Mapping[str, Value]]) -> list[Verdict]:
    """Return every score that has a bar, the worst miss first; what was not measured is left out."""
    out: list[Verdict] = []
    for result in map(with_rates, results):
        for measure in MEASURES:
            value = result.get(measure.key)
            if measure.floor is None or not isinstance(value, int | float) or math.isnan(value):
                continue
            out.append(Verdict(str(result.get("scene", _NOTHING)), measure, float(value)))
    return sorted(out, key=lambda verdict: -verdict.excess)


def notes(results: Sequence[Mapping[str, Value]]) -> list[str]:
    """Return a sentence for each missed floor, the worst first."""
    return [verdict.sentence() for verdict in verdicts(results) if not verdict.holds]


def rich_table(grid: Grid, title: str | None = None) -> Table:
    """Return the grid for a terminal, numbers to the right."""
    table = Table(title=title)
    for place, head in enumerate(grid.heads):
        table.add_column(head, justify="left" if place == 0 else "right", no_wrap=True)
    for row in grid.rows:
        table.add_row(*row)
    return table


def markdown(grid: Grid) -> str:
    """Return the grid as a Markdown table, columns aligned, with a line break at the end."""
    lines = [grid.heads, *grid.rows]
    widths = [max(len(line[k]) for line in lines) for k in range(len(grid.heads))]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    aligned = [
        [cell.ljust(width) if k == 0 else cell.rjust(width) for k, (cell, width) in enumerate(pairs)]
        for pairs in (list(zip(line, widths, strict=True)) for line in lines)
    ]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in [aligned[0], rule, *aligned[1:]])


def to_json(results: Sequence[Mapping[str, Value]]) -> str:
    """Return all scores and the verdicts as JSON; what was not measured is null."""
    content = {
        "results": [{key: _finite(value) for key, value in with_rates(result).items()} for result in results],
        "bars": [
            {
                "scene": verdict.scene,
                "measure": verdict.measure.key,
                "value": verdict.value,
                "floor": verdict.measure.floor,
                "aim": verdict.measure.aim,
                "holds": verdict.holds,
                "reaches_aim": verdict.reaches_aim,
            }
            for verdict in verdicts(results)
        ],
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def _finite(value: Value) -> Value | None:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _cell(result: Mapping[str, Value], measure: Measure) -> str:
    value = result.get(measure.key)
    if value is None or isinstance(value, str):
        return value or _NOTHING
    return _number(float(value), measure.decimals)


def _number(value: float, decimals: int) -> str:
    if math.isnan(value):
        return _NOTHING
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if float(text) == 0 else text


def _bar(value: float | None) -> str:
    return "" if value is None else f"{value:g}"
