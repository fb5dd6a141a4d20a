"""`wayside evaluate`: score tracks against truth, or write an accuracy card of scenes."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from service.cli import options
from service.cli.edge import one_sentence, say
from service.cli.output import WIDE, print_json, provenance
from service.errors import InvalidInput

if TYPE_CHECKING:
    from service.evaluation.scene_runs import Job


@one_sentence()
def evaluate(
    directories: Annotated[
        list[Path],
        typer.Argument(metavar="DIR...", help="What `wayside track` wrote; with --card, scenes with truth."),
    ],
    *,
    truth: Annotated[
        Path | None, typer.Option(metavar="DIR", help="A scene with truth, as `wayside simulate` writes.")
    ] = None,
    card: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT_DIR", help="Write accuracy.md, .html and .json of the scenes into a folder."
        ),
    ] = None,
    tracks: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="With --card: holds SCENE/tracks.jsonl; else the tracker is run."),
    ] = None,
    until_s: Annotated[
        float | None,
        typer.Option("--until", min=0.1, metavar="SECONDS", help="Score only the first seconds."),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="With --card: scenes at a time.")] = os.cpu_count() or 1,
    profile: options.Profile = None,
    filter_name: options.Filter = None,
    settings: options.Set = None,
    as_json: options.Json = False,
) -> None:
    """Score tracks against truth: GOSPA, OSPA, HOTA, MOTA, counts, speeds; --card: many scenes on a page."""
    if card is not None:
        if truth is not None:
            raise InvalidInput("--card takes scenes, which have their truth with them; leave --truth out")
        from service.evaluation.scene_runs import Job

        _write_card(
            card,
            [
                Job(
                    scene,
                    None if tracks is None else tracks / scene.name,
                    filter_name,
                    tuple(settings or ()),
                    until_s,
                    profile=profile,
                )
                for scene in directories
            ],
            jobs,
        )
        return
    if truth is None or len(directories) != 1:
        raise InvalidInput("want one folder with tracks and --truth DIR, or --card OUT_DIR with scenes")
    _print_scores(directories[0], truth, until_s, as_json=as_json)


def _print_scores(directory: Path, truth: Path, until_s: float | None, *, as_json: bool) -> None:
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


def _write_card(out: Path, jobs: list[Job], processes: int) -> None:
    """Score the scenes, telling of each when it is done, and write the card."""
    from service.evaluation.card import Card, write
    from service.evaluation.scene_runs import run_all

    results = []
    for result in run_all(jobs, processes):
        results.append(result)
        say(f"{result['scene']}: HOTA {result['hota']:.3f}, GOSPA {result['gospa']:.2f} m")
    first = jobs[0]
    chosen = [*first.settings, *([f"filter={first.filter}"] if first.filter else [])]
    digests = {str(result.get("parameters") or _about(job.tracks)["parameters_digest"])
               for job, result in zip(jobs, results, strict=True)}  # fmt: skip
    about = provenance() | {
        "parameters_digest": ", ".join(sorted(digests)),
        "profile": (first.profile or "default") + (" with settings of one's own" if chosen else ""),
"settings": ", ".join(chosen) or "none",
        "tracks": "made by this version" if first.tracks is None else "given",
        "seconds": "all" if first.until_s is None else f"the first {first.until_s:g} of each scene",
    }  # fmt: skip
    for path in write(Card(results, about), out):
        if path.suffix != ".svg":
            typer.echo(str(path))


def _about(directory: Path | None) -> dict[str, object]:
    """Return which parameters made the tracks, as far as they say so."""
    summary = None if directory is None else directory / "summary.json"
    known = json.loads(summary.read_bytes()) if summary is not None and summary.is_file() else {}
    return {name: known.get(name) for name in ("parameters_digest", "profile", "filter")}
