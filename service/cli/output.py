"""What commands print: tables for people, JSON for programs, progress on standard error."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import orjson
import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table

from service import __version__

if TYPE_CHECKING:  # the tracking core takes a second to import; most commands can do without
    from service.tracking.parameters import TrackerParameters

WIDE = 10_000  # columns of a table that is not shown on a terminal: nothing is cut


def provenance(parameters: TrackerParameters | None = None) -> dict[str, object]:
    """Return what every result carries: the version and, where there are any, the tracker's parameters."""
    if parameters is None:
        return {"version": __version__}
    return {
        "version": __version__,
        "parameters_digest": parameters.digest(),
        "profile": parameters.profile,
        "filter": parameters.filter,
    }


def print_json(value: object) -> None:
    """Print one JSON value; what is not a number becomes null."""
    typer.echo(json_text(value))


def json_text(value: object) -> str:
    """Return a value as indented JSON."""
    return orjson.dumps(value, option=orjson.OPT_INDENT_2 | orjson.OPT_SERIALIZE_NUMPY).decode()


def print_facts(title: str, facts: Mapping[str, object]) -> None:
    """Print names and values in two columns."""
    table = Table(title=title, show_header=False, title_justify="left")
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    for name, value in facts.items():
        table.add_row(name.replace("_", " "), cell(value))
    _console().print(table)


def print_rows(
    columns: Sequence[str], rows: Iterable[Mapping[str, object]], *, title: str | None = None
) -> None:
    """Print records as a table; numbers stand to the right."""
    found = list(rows)
    table = Table(title=title, title_justify="left")
    for name in columns:
        numeric = any(isinstance(row.get(name), int | float) for row in found)
        table.add_column(name.replace("_", " "), justify="right" if numeric else "left", overflow="fold")
    for row in found:
        table.add_row(*(cell(row.get(name)) for name in columns))
    _console().print(table)


def cell(value: object) -> str:
    """Return a value as people read it."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1000 else f"{value:.1f}"  # noqa: PLR2004 - more digits say nothing
    if isinstance(value, list | tuple | set | frozenset):
        return ", ".join(cell(item) for item in value) or "-"
    return str(value)


def progress(*, wanted: bool | None) -> Progress:
    """Return a progress display for standard error; None: shown on a terminal only."""
    shown = sys.stderr.isatty() if wanted is None else wanted
    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        disable=not shown,
    )


def _console() -> Console:
    return Console() if sys.stdout.isatty() else Console(width=WIDE)
