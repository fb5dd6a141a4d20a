"""`wayside key`: create, list, rotate and revoke API keys in the database itself, the first one too."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from service.cli import options
from service.cli.database import now_us, open_rows, read_settings
from service.cli.edge import one_sentence, say
from service.cli.output import print_json, print_rows, provenance
from service.formats.rfc3339 import format_time

if TYPE_CHECKING:
    from sqlalchemy import Connection

    from service.storage.keys import ApiKey

app = typer.Typer(help="Create, list, rotate and revoke API keys.", no_args_is_help=True)

COLUMNS = ("key_id", "name", "scopes", "sensor_ids", "created", "last_used", "revoked")


@app.command()
@one_sentence()
def create(
    *,
    name: Annotated[str, typer.Option("--name", help="What the key is for.")] = "command line",
    scope: Annotated[
        list[str] | None, typer.Option(help="ingest, read or admin; repeat. [default: read]")
    ] = None,
    sensor: Annotated[
        list[str] | None, typer.Option(help="Bind the scope ingest to this sensor; repeat for more.")
    ] = None,
    data_dir: options.DataDir = None,
    database: options.Database = None,
    as_json: options.Json = False,
) -> None:
    """Create a key and print its secret, which is shown this once."""
    from service.storage.database import session_scope
    from service.storage.keys import create_key

    with session_scope(open_rows(read_settings(data_dir=data_dir, database_url=database))) as connection:
        key, secret = create_key(
            connection, name=name, scopes=scope or ["read"], sensor_ids=sensor or None, now_us=now_us()
        )
        _note(connection, "key.created", key)
    if as_json:
        print_json(provenance() | _record(key) | {"key": secret})
        return
    typer.echo(secret)
    say(f"Key {key.key_id} opens {', '.join(sorted(key.scopes))}. Keep it now: it cannot be shown again.")


@app.command("list")
@one_sentence()
def list_(
    *,
    revoked: Annotated[bool, typer.Option("--revoked", help="Show revoked keys too.")] = False,
    data_dir: options.DataDir = None,
    database: options.Database = None,
    as_json: options.Json = False,
) -> None:
    """List the keys, without their secrets."""
    from service.storage.database import connection
    from service.storage.keys import list_keys

    with connection(open_rows(read_settings(data_dir=data_dir, database_url=database))) as reader:
        records = [_record(key) for key in list_keys(reader, include_revoked=revoked).items]
    if as_json:
        print_json(provenance() | {"keys": records})
    else:
        print_rows(COLUMNS if revoked else COLUMNS[:-1], records)


@app.command()
@one_sentence()
def rotate(
    key_id: Annotated[str, typer.Argument(help="As `wayside key list` shows it.")],
    *,
    data_dir: options.DataDir = None,
    database: options.Database = None,
    as_json: options.Json = False,
) -> None:
    """Give a key another secret and print it; a running service forgets the old one within five seconds."""
    from service.storage.database import session_scope
    from service.storage.keys import rotate_key

    with session_scope(open_rows(read_settings(data_dir=data_dir, database_url=database))) as connection:
        key, secret = rotate_key(connection, key_id, now_us=now_us())
        _note(connection, "key.rotated", key)
    if as_json:
        print_json(provenance() | _record(key) | {"key": secret})
        return
    typer.echo(secret)
    say(f"Key {key.key_id} has this secret now. Keep it: it cannot be shown again.")


@app.command()
@one_sentence()
def revoke(
    key_id: Annotated[str, typer.Argument(help="As `wayside key list` shows it.")],
    *,
    data_dir: options.DataDir = None,
    database: options.Database = None,
    as_json: options.Json = False,
) -> None:
    """Make a key worthless for good."""
    from service.storage.database import session_scope
    from service.storage.keys import revoke_key

    with session_scope(open_rows(read_settings(data_dir=data_dir, database_url=database))) as connection:
        key = revoke_key(connection, key_id, now_us=now_us())
        _note(connection, "key.revoked", key)
    if as_json:
        print_json(provenance() | _record(key))
    else:
        typer.echo(f"Key {key.key_id} is revoked.")


def _note(connection: Connection, action: str, key: ApiKey) -> None:
    from service.storage.audit import COMMAND_LINE, note_act

    detail = {"name": key.name, "scopes": sorted(key.scopes)}
    note_act(connection, actor=COMMAND_LINE, action=action, target=key.key_id, detail=detail, now_us=now_us())


def _record(key: ApiKey) -> dict[str, object]:
    return {
        "key_id": key.key_id,
        "name": key.name,
        "scopes": sorted(key.scopes),
        "sensor_ids": None if key.sensor_ids is None else sorted(key.sensor_ids),
        "created": format_time(key.created_us),
        "last_used": None if key.last_used_us is None else format_time(key.last_used_us),
        "revoked": None if key.revoked_us is None else format_time(key.revoked_us),
    }
