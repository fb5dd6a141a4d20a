"""`wayside evaluate`: score tracks against truth."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from service.cli import options
from service.cli.edge import one_sentence
from service.cli.output import WIDE, print_json, provenance


@one_sentence()
def evaluate(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="What `wayside track` wrote.")],
    truth: Annotated[
        Path, typer.Option(metavar="DIR", help="A scene with truth, as `wayside simulate` writes.")
    ],
    *,
    until_s: Annotated[
        float | None,
        typer.Option("--until", min=0.1, metavar="SECONDS", help="Score only the first seconds."),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Score tracks against truth: GOSPA, OSPA, HOTA, MOTA, counts, speeds."""
    from service.evaluation import report, scores

    scored = scores.evaluate(directory, truth, until=until_s)
    about = provenance() | _about(directory)
    if as_json:
        print_json(about | json.loads(report.to_json([scored])))
        return
    console = Console() if sys.stdout.isatty() else Console(width=WIDE)
    console.print(report.rich_table(report.by_measure([scored]), title=f"{directory} against {truth}"))
    for note in report.notes([scored]):
        typer.echo(note)
    typer.echo("  ".join(f"{name} {value}" for name, value in about.items()))


def _about(directory: Path) -> dict[str, object]:
    """Return which parameters made the tracks, as far as they say so."""
    summary = directory / "summary.json"
    known = json.loads(summary.read_bytes()) if summary.is_file() else {}
    return {name: known.get(name) for name in ("parameters_digest", "filter")}
