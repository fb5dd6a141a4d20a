"""`wayside bench`: time one step of the tracker under growing load."""

from __future__ import annotations

import dataclasses
import os
import platform
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from service.cli import options
from service.cli.edge import one_sentence, say
from service.cli.output import WIDE, print_json, provenance
from service.errors import InvalidInput

if TYPE_CHECKING:
    from service.formats.sensor import SensorConfig
    from service.tracking.model import Frame

_PEER_FRAMES = 80  # of a tracker that takes a tenth of a second for each


@one_sentence()
def bench(
    *,
    scene: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Time a recorded scene (frames.jsonl, site.json), not a steady road."
        ),
    ] = None,
    until_s: Annotated[
        float | None, typer.Option("--until", min=1.0, metavar="SECONDS", help="... its first seconds only.")
    ] = None,
    steps: Annotated[int, typer.Option(min=10, help="Steps that are timed under each load.")] = 300,
    warm_up: Annotated[int, typer.Option("--warm-up", min=0, help="Steps before them.")] = 100,
    wall: Annotated[
        bool, typer.Option("--wall", help="Measure wall time, as on a machine with nothing else to do.")
    ] = False,
    peer: Annotated[
        bool | None,
        typer.Option(
            "--peer/--no-peer", help="Compare with Stone Soup's JPDA; by default where it is installed."
        ),
    ] = None,
    profile: options.Profile = None,
    filter_name: options.Filter = None,
    settings: options.Set = None,
    as_json: options.Json = False,
) -> None:
    """Time one step of the tracker and its stages, for 30, 60 and 120 vehicles or for a scene."""
    from service.cli.fold_bench import FoldRun
    from service.cli.site_file import read_site, with_settings
    from service.evaluation import bench as timing
    from service.evaluation import peer_bench
    from service.evaluation.report import rich_table
    from service.formats.sensor import SensorConfig

    config = with_settings(
        SensorConfig() if scene is None else read_site(scene / "site.json"),
        filter_name,
        settings or (),
        profile,
    )
    parameters = config.tracker_parameters()
    clock = time.perf_counter if wall else time.process_time
    if scene is None:
        timings = []
        for load in timing.LOADS:
            say(f"{load.vehicles} vehicles ...")
            timings += timing.bench(
                [load], parameters=parameters, warm_up=warm_up, steps=steps, clock=clock, fold=FoldRun
            )
        frames = timing.steady(timing.LOADS[0], _PEER_FRAMES, parameters)
    else:
        frames = _frames_of(scene, config, until_s)
        say(f"{len(frames)} frames of {scene} ...")
        begin = min(warm_up, len(frames) // 2)
        timings = [timing.bench_frames(frames, parameters, warm_up=begin, clock=clock, fold=FoldRun)]
    compared = None
    if peer or (peer is None and peer_bench.is_installed()):
        frames = frames if until_s else frames[:_PEER_FRAMES]
        say(f"Stone Soup on {len(frames)} frames ...")
        compared = peer_bench.compare(frames, parameters)
    about = provenance(parameters) | {
        "machine": _machine(),
        "time": "wall" if wall else "CPU",
        "steps": steps if scene is None else len(frames),
    }
    if as_json:
        against = None if compared is None else dataclasses.asdict(compared) | {"ratio": compared.ratio}
        print_json(about | {"timings": [dataclasses.asdict(t) for t in timings], "peer": against})
        return
    console = Console() if sys.stdout.isatty() else Console(width=WIDE)
    console.print(rich_table(timing.grid(timings), title="One step of the tracker"))
    console.print(rich_table(timing.stage_grid(timings), title="Its stages, and what the fold adds"))
    if compared is not None:
        typer.echo(compared.sentence())
    typer.echo("  ".join(f"{name} {value}" for name, value in about.items()))


def _frames_of(scene: Path, config: SensorConfig, until_s: float | None) -> list[Frame]:
    from service.formats.json_frames import read_frames

    found = sorted(scene.glob("frames.jsonl*"))
    if not found:
        raise InvalidInput.at("/scene", f"no frames.jsonl in {scene}")
    frames = list(read_frames(found, config))
    if until_s is None:
        return frames
    return [frame for frame in frames if frame.time_us < frames[0].time_us + until_s * 1e6]


def _machine() -> str:
    return f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
