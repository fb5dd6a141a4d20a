"""`wayside serve`: the embedded service."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from service.cli import options
from service.cli.edge import one_sentence, say

if TYPE_CHECKING:
    from sqlalchemy import Engine


@one_sentence()
def serve(
    *,
    host: Annotated[
        str | None, typer.Option(help="Address to listen on. [WAYSIDE_HOST, 127.0.0.1]", metavar="ADDRESS")
    ] = None,
    port: options.Port = None,
    data_dir: options.DataDir = None,
    database: options.Database = None,
    insecure: Annotated[
        bool, typer.Option("--insecure", help="Listen on any address without a key, on a network you trust.")
    ] = False,
    first_key: Annotated[
        bool,
        typer.Option("--first-key", help="When there is no key, create one with scope admin and print it."),
    ] = False,
) -> None:
    """Run the service: HTTP API, tracker and dashboard in one process."""
    from service.api.server import run
    from service.cli.database import read_settings
    from service.cli.kernels import warm_up
    from service.telemetry import set_up_logging

    settings = read_settings(host=host, port=port, data_dir=data_dir, database_url=database)
    set_up_logging(settings.log_level, settings.log_format)

    def prepare(engine: Engine) -> None:
        if first_key:
            _create_first_key(engine)
        warm_up()

    run(
        settings, insecure=insecure, prepare=prepare, on_ready=lambda address: say(f"Wayside is at {address}")
    )


def _create_first_key(engine: Engine) -> None:
    from service.cli.database import now_us
    from service.storage.audit import COMMAND_LINE, note_act
    from service.storage.database import session_scope
    from service.storage.keys import create_key, list_keys

    with session_scope(engine) as connection:
        if not list_keys(connection, limit=1).items:
            key, secret = create_key(connection, name="first key", scopes=["admin"], now_us=now_us())
            note_act(connection, actor=COMMAND_LINE, action="key.created", target=key.key_id, now_us=now_us())
            say(f"The first API key, shown this once: {secret}")
