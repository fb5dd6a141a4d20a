"""`wayside doctor`: say in plain words what is wrong with a radar's stream."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from service.cli import options
from service.cli.edge import FAILED, one_sentence, say
from service.cli.output import print_facts, print_json, provenance
from service.errors import InvalidInput

if TYPE_CHECKING:
    from service.traffic.diagnosis import Diagnosis


@one_sentence()
def doctor(
    frames: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FRAMES]...", help="Recorded frames; or see --sensor."),
    ] = None,
    *,
    site: Annotated[
        Path | None, typer.Option("--site", metavar="SITE.json", help="The sensor as mounted, for FRAMES.")
    ] = None,
    sensor: Annotated[str | None, typer.Option(help="Sensor of the running service.")] = None,
    url: options.Url = options.DEFAULT_URL,
    key: options.Key = None,
    as_json: options.Json = False,
) -> None:
    """Say what is wrong with a radar's stream: rate, gaps, clock, Doppler, points, region, mounting.

    Exit code 1 when there is a fault.
    """
    if frames:
        found = _of_recording(frames, site)
    elif sensor is not None:
        found = _of_service(url, key, sensor)
    else:
        raise InvalidInput("want recorded FRAMES, or --sensor of a running service")
    if as_json:
        print_json({**provenance(), **found})
    else:
        _print(found)
    if found["findings"]:
        raise typer.Exit(FAILED)


def _of_recording(paths: list[Path], site: Path | None) -> dict[str, object]:
    from service.formats.json_frames import read_frames
    from service.pipeline.diagnosing import diagnose_recording
    from service.pipeline.offline import read_site

    config = read_site(site)
    found: Diagnosis = diagnose_recording(list(read_frames(paths, config)), config)
    return {"sensor_id": config.sensor_id, **asdict(found)}


def _of_service(url: str, key: str | None, sensor: str) -> dict[str, object]:
    from service.cli.client import Client

    with Client(url, key) as client:
        return client.request("GET", f"/sensors/{sensor}/diagnosis")


def _print(found: dict[str, object]) -> None:
    findings = cast("list[dict[str, object]]", found["findings"])
    say(f"{found['sensor_id']}: " + (f"{len(findings)} findings" if findings else "nothing is wrong"))
    for finding in findings:
        typer.echo(f"\n{finding['code']}: {finding['sentence']}\n  {finding['advice']}")
        evidence = cast("dict[str, float]", finding["evidence"])
        typer.echo("  " + ", ".join(f"{name} = {value:.4g}" for name, value in evidence.items()))
    print_facts("measured", cast("dict[str, object]", found["measured"]))
    for text in cast("list[str]", found["not_told"]):
        typer.echo(f"not told: {text}")
