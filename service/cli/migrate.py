"""`wayside migrate`: bring the database to the schema of this version."""

from __future__ import annotations

from typing import Annotated

import typer

from service.cli import options
from service.cli.database import read_settings
from service.cli.edge import FAILED, one_sentence
from service.cli.output import print_json, provenance


@one_sentence()
def migrate(
    *,
    check: Annotated[
        bool, typer.Option("--check", help="Change nothing; exit with 1 when the database is not up to date.")
    ] = False,
    data_dir: options.DataDir = None,
    database: options.Database = None,
    as_json: options.Json = False,
) -> None:
    """Bring the database to the schema of this version, as `wayside serve` does when it starts."""
    from service.storage import migrate as schema
    from service.storage.database import open_database

    engine = open_database(read_settings(data_dir=data_dir, database_url=database).rows_url)
    before = schema.current(engine)
    if not check:
        schema.upgrade(engine)
    after = schema.current(engine)
    if as_json:
        print_json(provenance() | {"before": before, "after": after, "needed": schema.head()})
    elif check:
        typer.echo(f"The database is at revision {after}; this version needs {schema.head()}.")
    else:
        typer.echo(f"The database is at revision {after}." if before == after else f"{before} -> {after}")
    if after != schema.head():
        raise typer.Exit(FAILED)
