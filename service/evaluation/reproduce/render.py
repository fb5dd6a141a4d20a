"""Turn a reproduction into grids for a terminal, Markdown, and plain values for JSON."""

from __future__ import annotations

import math

from service.evaluation.report import Grid, markdown
from service.evaluation.reproduce.form import Bar, Cell, Figure, Panel, Reproduction, Table

_DIGITS = 4
_NOTHING = "-"


def grid(table: Table) -> Grid:
    """Return a table: a row for each cell of the paper's, with ours beside it."""
    optional = [
        (head, name) for head, name in _OPTIONAL if any(getattr(c, name) is not None for c in table.cells)
    ]
    remarks = any(c.remark for c in table.cells)
    heads = (
        "",
        "",
        "paper",
        "ours",
        "std error",
        "ratio",
        *(head for head, _ in optional),
        *(["remark"] * remarks),
    )
    return Grid(heads, tuple(_row(c, [name for _, name in optional], remarks=remarks) for c in table.cells))


_OPTIONAL = (("literal reading", "literal"), ("its std error", "literal_error"), ("bound", "bound"))


def _row(cell: Cell, optional: list[str], *, remarks: bool) -> tuple[str, ...]:
    error = f"none: {cell.exact}" if cell.exact else number(cell.error)
    more = (number(getattr(cell, name)) for name in optional)
    shown = (number(cell.paper), number(cell.ours), error, number(cell.ratio), *more)
    return (cell.row, cell.column, *shown, *([cell.remark] * remarks))


def bars_grid(bars: tuple[Bar, ...]) -> Grid:
    """Return our bars and whether they hold."""
    rows = tuple(
        (b.name, number(b.value), number(b.error), _interval(b), "yes" if b.holds else "no") for b in bars
    )
    return Grid(("bar", "value", "std error", "wanted", "holds"), rows)


def _interval(bar: Bar) -> str:
    if math.isinf(bar.low):
        return f"<= {bar.high:g}"
    return f">= {bar.low:g}" if math.isinf(bar.high) else f"{bar.low:g} to {bar.high:g}"


def number(value: float | None) -> str:
    """Return a number with four digits, or a dash."""
    if value is None or not math.isfinite(value):
        return _NOTHING
    return f"{value:.{_DIGITS}g}" if abs(value) < 10 ** (_DIGITS - 1) else f"{value:.0f}"


def text(result: Reproduction, plots: dict[str, str] | None = None) -> str:
    """Return the whole reproduction as Markdown; plots: file name of each figure's number."""
    parts = [f"# {result.paper}\n\n{result.citation}\n\n{result.runs} runs, seed {result.seed}.\n"]
    for head, sentences in (
        ("What holds", result.holds),
        ("What does not", result.fails),
        ("What we changed", result.changed),
    ):
        parts.append(f"\n## {head}\n\n" + "".join(f"* {sentence}\n" for sentence in sentences))
    if result.bars:
        parts.append("\n## Bars\n\n" + markdown(bars_grid(result.bars)))
    for table in result.tables:
        parts.append(f"\n## {table.number}: {table.title}\n\n{_about(table)}")
        parts.append(markdown(grid(table)) if table.cells else "")
    for figure in result.figures:
        parts.append(f"\n## {figure.number}: {figure.title}\n\n{_about(figure)}")
        if plots and figure.number in plots:
            parts.append(f"![{figure.title}]({plots[figure.number]})\n")
    return "".join(parts)


def _about(entry: Table | Figure) -> str:
    return f"{entry.kind.value[0].upper()}{entry.kind.value[1:]}. {entry.note}".rstrip() + "\n\n"


def plain(result: Reproduction, *, curves: bool = True) -> dict[str, object]:
    """Return the reproduction as plain values for JSON; numbers rounded to six digits.

    curves: with the points of every line of the figures.
    """
    return {
        "paper": result.paper,
        "citation": result.citation,
        "runs": result.runs,
        "seed": result.seed,
        "holds": list(result.holds),
        "fails": list(result.fails),
        "changed": list(result.changed),
        "bars": [
            {
                "name": b.name,
                "value": _round(b.value),
                "std_error": _round(b.error),
                "low": _round(b.low),
                "high": _round(b.high),
                "holds": b.holds,
            }
            for b in result.bars
        ],
        "tables": [_plain_table(t) for t in result.tables],
        "figures": [_plain_figure(f, curves=curves) for f in result.figures],
    }


def _plain_table(table: Table) -> dict[str, object]:
    cells = []
    for c in table.cells:
        numbers = {
            "paper": c.paper, "ours": c.ours, "std_error": c.error, "ratio": c.ratio, "literal": c.literal,
            "literal_std_error": c.literal_error, "bound": c.bound,
        }  # fmt: skip
        known = {name: _round(value) for name, value in numbers.items()}
        cell: dict[str, object] = {"row": c.row, "column": c.column, **known}
        cells.append(
            cell | {name: word for name, word in (("remark", c.remark), ("no_error", c.exact)) if word}
        )
    return {
        "number": table.number,
        "title": table.title,
        "kind": table.kind.value,
        "note": table.note,
        "cells": cells,
    }


def _plain_figure(figure: Figure, *, curves: bool) -> dict[str, object]:
    about: dict[str, object] = {"number": figure.number, "title": figure.title, "kind": figure.kind.value}
    about |= {"note": figure.note}
    return about | ({"panels": [_plain_panel(panel) for panel in figure.panels]} if curves else {})


def _plain_panel(panel: Panel) -> dict[str, object]:
    lines = [
        {"name": line.name, "x": list(map(_round, line.x.tolist())), "y": list(map(_round, line.y.tolist()))}
        for line in panel.lines
    ]
    return {"title": panel.title, "x_label": panel.x_label, "y_label": panel.y_label, "lines": lines}


def _round(value: float | None) -> float | None:
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.6g}")
