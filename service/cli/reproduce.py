"""`wayside reproduce`: the tables and figures of the four papers beside ours."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import orjson
import typer
from rich.console import Console
from rich.progress import Progress

from service.cli import options
from service.cli.edge import one_sentence, say
from service.cli.output import WIDE, json_text, print_json, progress, provenance
from service.cli.results import written_together
from service.errors import InvalidInput

if TYPE_CHECKING:
    from service.evaluation.reproduce.form import Paper, Reproduction

SUMMARY = "reproduce.json"  # the last file to be written


@one_sentence()
def reproduce(
    papers: Annotated[
        list[str] | None,
        typer.Argument(metavar="PAPER...", help="astekf, mast-ukf, isrckf, hpff; none: all four."),
    ] = None,
    *,
    runs: Annotated[
        int | None, typer.Option(min=2, help="Monte-Carlo runs. [default: by paper, 20 to 1000]")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Equal seeds give equal numbers.")] = 1,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for Markdown, JSON and plots.")
    ] = None,
    plots: Annotated[
        bool | None,
        typer.Option(
            "--plots/--no-plots", help="Draw the figures into --out. [default: if matplotlib is installed]"
        ),
    ] = None,
    force: options.Force = False,
    as_json: options.Json = False,
    show_progress: options.ShowProgress = None,
) -> None:
    """Repeat the experiments of the papers behind the filters: every table and figure, theirs beside ours."""
    from service.evaluation.reproduce.papers import find_papers

    chosen = find_papers(papers or ())
    drawing = _drawing(out, plots)
    with progress(wanted=show_progress) as bar:
        results = [_one(paper, runs, seed, bar) for paper in chosen]
    if out is not None:
        _write(out, results, drawing=drawing, force=force)
    if as_json:
        print_json(_plain(results))
    else:
        _print(results)


def _drawing(out: Path | None, wanted: bool | None) -> bool:  # noqa: FBT001 - three-valued option
    from service.evaluation.reproduce.plots import can_draw

    if wanted and out is None:
        raise InvalidInput.at("/plots", "plots are files: name a folder with --out")
    if wanted and not can_draw():
        raise InvalidInput.at("/plots", "drawing needs matplotlib: pip install 'wayside[plots]'")
    if out is not None and wanted is None and not can_draw():
        say("no plots: matplotlib is not installed (pip install 'wayside[plots]')")
    return out is not None and wanted is not False and can_draw()


def _one(paper: Paper, runs: int | None, seed: int, bar: Progress) -> Reproduction:
    from service.evaluation.reproduce.form import Settings

    task = bar.add_task(paper.name, total=paper.steps)

    def advance(what: str) -> None:
        bar.update(task, advance=1, description=f"{paper.name}: {what}")

    result = paper.reproduce(Settings(runs or paper.default_runs, seed, advance))
    bar.update(task, description=paper.name)
    return result


def _plain(results: list[Reproduction]) -> dict[str, object]:
    from service.evaluation.reproduce.render import plain

    return provenance() | {"papers": [plain(result) for result in results]}


def _write(out: Path, results: list[Reproduction], *, drawing: bool, force: bool) -> None:
    from service.evaluation.reproduce import plots, render

    drawn = {r.paper: plots.file_names(r) if drawing else {} for r in results}
    texts = {f"reproduce-{r.paper}.md": render.text(r, drawn[r.paper]) for r in results}
    values = {f"reproduce-{r.paper}.json": provenance() | render.plain(r, curves=False) for r in results}
    curves = {f"curves-{r.paper}.json": {"figures": render.plain(r)["figures"]} for r in results}
    pictures = [name for names in drawn.values() for name in names.values()]
    with written_together(out, [*pictures, *texts, *curves, *values, SUMMARY], force=force) as folder:
        if drawing:
            for result in results:
                plots.draw(result, folder)
        for name, text in texts.items():
            (folder / name).write_text(text)
        for name, value in values.items():
            (folder / name).write_text(json_text(value) + "\n")
        for (
            name,
            value,
        ) in curves.items():  # tens of thousands of numbers: a line of its own for each is no help
            (folder / name).write_bytes(orjson.dumps(value))
        (folder / SUMMARY).write_bytes(orjson.dumps({"papers": [r.paper for r in results]} | provenance()))


def _print(results: list[Reproduction]) -> None:
    from service.evaluation.report import rich_table
    from service.evaluation.reproduce import render

    console = Console() if sys.stdout.isatty() else Console(width=WIDE)
    for r in results:
        console.print(f"{r.paper}: {r.citation}", markup=False)
        console.print(f"{r.runs} runs, seed {r.seed}\n", markup=False)
        for table in r.tables:
            console.print(
                rich_table(render.grid(table), title=f"{table.number}: {table.title} ({table.kind.value})")
            )
            if table.note:
                console.print(table.note, markup=False)
        for figure in r.figures:
            console.print(
                f"{figure.number}: {figure.title} ({figure.kind.value}) {figure.note}", markup=False
            )
        if r.bars:
            console.print(rich_table(render.bars_grid(r.bars), title="Bars"))
        for head, sentences in (("holds", r.holds), ("does not", r.fails), ("changed", r.changed)):
            for sentence in sentences:
                console.print(f"{head}: {sentence}", markup=False)
