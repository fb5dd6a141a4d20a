"""`wayside sensor`: register and look at the sensors of a running service, through its API.

A change of a sensor is a record in its log that only the host may write; so these commands speak HTTP.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, cast

import typer

from service.cli import options
from service.cli.edge import one_sentence
from service.cli.output import print_facts, print_json, print_rows, provenance

app = typer.Typer(help="Register and look at the sensors of a running service.", no_args_is_help=True)

SensorId = Annotated[str, typer.Argument(metavar="SENSOR", help="Id of the sensor.")]
COLUMNS = ("sensor_id", "name", "site_id", "filter", "rate_hz", "mount_height_m", "heading_deg")


@app.command()
@one_sentence()
def add(
    site: Annotated[Path, typer.Argument(metavar="SITE.json", help="The sensor as mounted.")],
    *,
    profile: options.Profile = None,
    filter_name: options.Filter = None,
    settings: options.Set = None,
    url: options.Url = options.DEFAULT_URL,
    key: options.Key = None,
    as_json: options.Json = False,
) -> None:
    """Register the sensor of a site file."""
    from service.cli.client import Client
    from service.cli.site_file import read_site

    config = read_site(site, filter_name, settings or (), profile)
    with Client(url, key) as client:
        sensor = client.request("POST", "/sensors", json=config.model_dump(mode="json"))
    if as_json:
        print_json(provenance(config.tracker_parameters()) | sensor)
    else:
        typer.echo(f"Sensor {config.sensor_id} is registered: {url}/api/v1/sensors/{config.sensor_id}/frames")


@app.command("list")
@one_sentence()
def list_(
    *, url: options.Url = options.DEFAULT_URL, key: options.Key = None, as_json: options.Json = False
) -> None:
    """List the sensors."""
    from service.cli.client import Client

    with Client(url, key) as client:
        items = client.items("/sensors")
    if as_json:
        print_json(provenance() | {"sensors": items})
    else:
        print_rows(COLUMNS, items)


@app.command()
@one_sentence()
def show(
    sensor_id: SensorId,
    *,
    url: options.Url = options.DEFAULT_URL,
    key: options.Key = None,
    as_json: options.Json = False,
) -> None:
    """Show the configuration of a sensor."""
    from service.cli.client import Client

    with Client(url, key) as client:
        sensor = client.request("GET", f"/sensors/{sensor_id}")
    if as_json:
        print_json(provenance() | sensor)
    else:
        print_facts(f"Sensor {sensor_id}", sensor)


@app.command()
@one_sentence()
def restart(
    sensor_id: SensorId,
    *,
    skip: Annotated[
        bool, typer.Option("--skip", help="Leave untracked what waits in the log; begin behind it.")
    ] = False,
    url: options.Url = options.DEFAULT_URL,
    key: options.Key = None,
) -> None:
    """Track a sensor again whose tracker failed."""
    from service.cli.client import Client

    with Client(url, key) as client:
        done = client.request("POST", f"/sensors/{sensor_id}:restart?skip={str(skip).lower()}")
    typer.echo(f"Sensor {sensor_id} is tracked again; {done['skipped']} records are left out.")


@app.command()
@one_sentence()
def remove(
    sensor_id: SensorId,
    *,
    url: options.Url = options.DEFAULT_URL,
    key: options.Key = None,
) -> None:
    """Take a sensor out of use; what it recorded stays readable."""
    from service.cli.client import Client

    with Client(url, key) as client:
        client.request("DELETE", f"/sensors/{sensor_id}")
    typer.echo(f"Sensor {sensor_id} is taken out of use.")


@app.command()
@one_sentence()
def purge(
    sensor_id: SensorId,
    *,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
    url: options.Url = options.DEFAULT_URL,
    key: options.Key = None,
    as_json: options.Json = False,
) -> None:
    """Remove for good all that a sensor out of use recorded; its id stays taken."""
    from service.cli.client import Client

    if not yes:
        typer.confirm(f"Remove all frames, tracks and counts of {sensor_id} for good?", abort=True, err=True)
    with Client(url, key) as client:
        done = client.request("POST", f"/sensors/{sensor_id}:purge")
    if as_json:
        print_json(provenance() | done)
    else:
        print_facts(f"Removed of {sensor_id}", cast("dict[str, object]", done["rows"]))
