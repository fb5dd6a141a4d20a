"""`wayside bench`: time one step of the tracker under growing load."""

from __future__ import annotations

import dataclasses
import os
import platform
import sys
from typing import Annotated

import typer
from rich.console import Console

from service.cli import options
from service.cli.edge import one_sentence, say
from service.cli.output import WIDE, print_json, provenance


@one_sentence()
def bench(
    *,
    steps: Annotated[int, typer.Option(min=10, help="Steps that are timed under each load.")] = 300,
    warm_up: Annotated[int, typer.Option("--warm-up", min=0, help="Steps before them.")] = 100,
    filter_name: options.Filter = None,
    settings: options.Set = None,
    as_json: options.Json = False,
) -> None:
    """Time one step of the tracker, points to tracks, for 30, 60 and 120 vehicles."""
    from service.cli.site_file import with_settings
    from service.evaluation import bench as timing
    from service.evaluation.report import rich_table
    from service.formats.sensor import SensorConfig

    parameters = with_settings(SensorConfig(), filter_name, settings or ()).tracker_parameters()
    timings = []
    for load in timing.LOADS:
        say(f"{load.vehicles} vehicles ...")
        timings += timing.bench([load], parameters=parameters, warm_up=warm_up, steps=steps)
    about = provenance(parameters) | {"machine": _machine(), "steps": steps}
    if as_json:
        print_json(about | {"timings": [dataclasses.asdict(t) for t in timings]})
        return
    console = Console() if sys.stdout.isatty() else Console(width=WIDE)
    console.print(rich_table(timing.grid(timings), title="One step of the tracker"))
    typer.echo("  ".join(f"{name} {value}" for name, value in about.items()))


def _machine() -> str:
    return f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
