"""Replies kept for a day under an Idempotency-Key, so that a repeated request has no second effect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from sqlalchemy import Connection, delete, select

from service.storage.database import insert_or_ignore
from service.storage.tables import kept_replies

KEPT_US: Final = 24 * 3600 * 1_000_000


@dataclass(frozen=True, slots=True)
class KeptReply:
    """What a request was answered."""

    request: bytes  # digest of its body
    status: int
    headers: Mapping[str, str]
    body: bytes | None  # None: it held a secret, which is kept nowhere


def find_reply(connection: Connection, name: bytes, *, now_us: int) -> KeptReply | None:
    """Return the reply kept under a name, None when there is none or it has expired."""
    table = kept_replies.c
    query = select(table.request, table.status, table.headers, table.body)
    row = connection.execute(query.where(table.name == name, table.expires_us > now_us)).one_or_none()
    return None if row is None else KeptReply(*row)


def keep_reply(connection: Connection, name: bytes, reply: KeptReply, *, now_us: int) -> None:
    """Keep a reply for a day, and let go of expired ones."""
    connection.execute(delete(kept_replies).where(kept_replies.c.expires_us <= now_us))
    connection.execute(
        insert_or_ignore(connection, "kept_replies").values(
            name=name,
            request=reply.request,
            status=reply.status,
            headers=dict(reply.headers),
            body=reply.body,
            expires_us=now_us + KEPT_US,
        )
    )
