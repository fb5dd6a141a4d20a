"""`wayside simulate`: make frames with exact truth from a named scenario."""

from __future__ import annotations

from typing import Annotated

import typer

from service.cli import options
from service.cli.edge import one_sentence
from service.cli.output import json_text, print_facts, print_json, progress, provenance

FILES = ("site.json", "frames.jsonl.gz", "labels.jsonl.gz", "truth.csv.gz", "road_truth.json", "summary.json")


@one_sentence()
def simulate(
    scenario: Annotated[str, typer.Argument(help="motorway, dense, queue, two_way, curve, wide or demo.")],
    out: options.Out,
    *,
    seed: Annotated[int, typer.Option(min=0, help="Equal seeds give equal files.")] = 1,
    duration_s: Annotated[
        float | None, typer.Option("--duration", min=1.0, metavar="SECONDS", help="[default: the scenario's]")
    ] = None,
    force: options.Force = False,
    show: options.ShowProgress = None,
    as_json: options.Json = False,
) -> None:
    """Simulate a road with a radar: frames, site file and truth."""
    from service.cli.results import written_together
    from service.simulation.scenario import scenario_named
    from service.simulation.scene_files import write_scene

    scenario_named(scenario)  # tells of a wrong name before anything is written
    with written_together(out, FILES, force=force) as folder, progress(wanted=show) as bar:
        task = bar.add_task(f"simulating {scenario}", total=None)
        made = write_scene(
            scenario,
            folder,
            seed=seed,
            duration_s=duration_s,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
        summary = provenance() | made
        (folder / "summary.json").write_text(json_text(summary) + "\n")
    if as_json:
        print_json(summary | {"out": str(out)})
    else:
        print_facts(f"{scenario} -> {out}", summary)
