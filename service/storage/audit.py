"""Who changed what: administrative acts, written in the transaction of the change itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from sqlalchemy import Connection, insert, select

from service.storage.page import Page, check_limit, cut, read_cursor
from service.storage.tables import acts

COMMAND_LINE: Final = "command line"  # the actor of an act on the database itself
NOBODY: Final = "nobody"  # ... of an act in the open local mode, where no key exists


@dataclass(frozen=True, slots=True)
class Act:
    """One administrative act."""

    number: int  # rises
    time_us: int
    actor: str  # id of a key, COMMAND_LINE or NOBODY
    action: str  # such as "key.created"
    target: str  # id of what was changed
    detail: Mapping[str, object]  # never a secret


def note_act(  # noqa: PLR0913 - the columns
    connection: Connection,
    *,
    actor: str,
    action: str,
    target: str,
    detail: Mapping[str, object] | None = None,
    now_us: int,
) -> None:
    """Write down an act in the transaction that carries it out."""
    row = {"actor": actor, "action": action, "target": target, "detail": dict(detail or {})}
    connection.execute(insert(acts).values(time_us=now_us, **row))


def list_acts(
    connection: Connection,
    *,
    action: str | None = None,
    target: str | None = None,
    cursor: str | None = None,
    limit: int = 100,
) -> Page[Act]:
    """Return acts, the newest first, of one action or target if given."""
    query = select(acts).order_by(acts.c.number.desc()).limit(check_limit(limit) + 1)
    if action is not None:
        query = query.where(acts.c.action == action)
    if target is not None:
        query = query.where(acts.c.target == target)
    if cursor is not None:
        query = query.where(acts.c.number < read_cursor(cursor, int)[0])
    found = [Act(**row) for row in connection.execute(query).mappings()]
    return cut(found, limit, lambda act: (act.number,))
