"""`wayside compare`: several filters on recordings with truth, side by side."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from service.cli import options
from service.cli.edge import one_sentence, say
from service.cli.output import WIDE, json_text, print_json, progress, provenance
from service.cli.results import written_together

if TYPE_CHECKING:
    from service.evaluation.measures import Value

TABLE, PLOT, SUMMARY = "compare.md", "compare.svg", "compare.json"  # the summary is the last to be written


@one_sentence()
def compare(
    recordings: Annotated[
        list[Path],
        typer.Argument(metavar="DIR...", help="Recordings with truth, as `wayside simulate` writes."),
    ],
    *,
    filters: Annotated[
        str | None,
        typer.Option("--filters", metavar="NAME,...", help="Such as astekf,ekf,imm. [default: every filter]"),
    ] = None,
    until_s: Annotated[
        float | None,
        typer.Option("--until", min=0.1, metavar="SECONDS", help="Only the first seconds of each."),
    ] = None,
    settings: options.Set = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for Markdown, JSON and the plot.")
    ] = None,
    force: options.Force = False,
    show: options.ShowProgress = None,
    as_json: options.Json = False,
) -> None:
    """Compare filters on recordings with truth: accuracy, consistency, lost tracks, time."""
    from service.cli.site_file import setting
    from service.evaluation import compare as comparison
    from service.evaluation import report
    from service.tracking.filters.registry import filter_names

    names = filter_names() if filters is None else [name.strip() for name in filters.split(",")]
    with progress(wanted=show) as bar:
        task = bar.add_task("compare", total=len(names) * len(recordings))
        results = comparison.compare(
            recordings,
            names,
            settings=dict(setting(text) for text in settings or ()),
            until=until_s,
            clock=time.process_time,
            advance=lambda what: bar.update(task, advance=1, description=what),
        )
    grid = comparison.grid(results)
    if out is not None:
        _write(out, report.markdown(grid), results, force=force)
    if as_json:
        print_json(_plain(results))
        return
    console = Console() if sys.stdout.isatty() else Console(width=WIDE)
    console.print(report.rich_table(grid))


def _plain(results: list[dict[str, Value]]) -> dict[str, object]:
    return provenance() | {"results": results}


def _write(out: Path, table: str, results: list[dict[str, Value]], *, force: bool) -> None:
    from service.evaluation.compare_plot import draw
    from service.evaluation.reproduce.plots import can_draw

    names = [TABLE, *([PLOT] if can_draw() else []), SUMMARY]
    if not can_draw():
        say("no plot: matplotlib is not installed (pip install 'wayside[plots]')")
    with written_together(out, names, force=force) as folder:
        (folder / TABLE).write_text(table)
        if can_draw():
            draw(results, folder / PLOT)
        (folder / SUMMARY).write_text(json_text(_plain(results)) + "\n")
