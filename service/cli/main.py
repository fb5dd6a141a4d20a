"""The command `wayside` and its parts, one module each."""

from __future__ import annotations

from typing import Annotated

import typer

from service import __version__
from service.cli import key, sensor
from service.cli.bench import bench
from service.cli.chaos import chaos
from service.cli.compare import compare
from service.cli.count_check import count_check
from service.cli.demo import demo
from service.cli.doctor import doctor
from service.cli.evaluate import evaluate
from service.cli.export import export
from service.cli.migrate import migrate
from service.cli.replay import replay
from service.cli.reproduce import reproduce
from service.cli.serve import serve
from service.cli.simulate import simulate
from service.cli.track import track

app = typer.Typer(
    name="wayside",
    help="Turn a roadside radar into a traffic monitor.",
    no_args_is_help=True,
    rich_markup_mode="markdown",  # "rich" takes [default: ...] for markup and drops it
    pretty_exceptions_enable=False,
)
for command in (
    demo,
    serve,
    track,
    replay,
    simulate,
    evaluate,
    compare,
    export,
    count_check,
    reproduce,
    bench,
    chaos,
    doctor,
    migrate,
):
    app.command()(command)
app.add_typer(key.app, name="key")
app.add_typer(sensor.app, name="sensor")


def _print_version(wanted: bool) -> None:  # noqa: FBT001 - typer hands the flag over like this
    if wanted:
        typer.echo(f"wayside {__version__}")
        raise typer.Exit


@app.callback()
def options(
    *,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Turn a roadside radar into a traffic monitor."""


if __name__ == "__main__":
    app()
