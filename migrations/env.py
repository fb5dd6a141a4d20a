"""Run the revisions on the connection, inside the transaction, that `service.storage.migrate` hands over."""

from __future__ import annotations

import re
from collections.abc import Mapping

from alembic import context
from sqlalchemy import Connection

from service.storage.tables import metadata

# Partitions of PostgreSQL come and go with the days (storage/upkeep.py); the code's tables do not name them.
_PARTITION = re.compile(r"track_states_(\d{8}|default)")


def include_name(name: str | None, kind: str, _parents: Mapping[str, str | None]) -> bool:
    return kind != "table" or name is None or _PARTITION.fullmatch(name) is None


def run(connection: Connection) -> None:
    context.configure(
        connection=connection,
        target_metadata=metadata,
        include_name=include_name,
        render_as_batch=connection.dialect.name == "sqlite",
        compare_type=True,
        compare_server_default=True,
    )
    with context.begin_transaction():
        context.run_migrations()


run(context.config.attributes["connection"])
