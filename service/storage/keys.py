"""API keys: a secret is shown once and kept as its SHA-256; scopes say what it opens.

SHA-256 without salt or stretching is enough: the secret has 256 random bits, so there is nothing to guess.
"""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final, Literal, get_args

from sqlalchemy import Connection, RowMapping, insert, or_, select, update

from service.errors import Conflict, InvalidInput, NotFound
from service.storage.page import Page, check_limit, cut, read_cursor
from service.storage.sites import read_sensor
from service.storage.tables import api_keys

Scope = Literal["ingest", "read", "admin"]
SCOPES: Final[tuple[Scope, ...]] = get_args(Scope)

LIST_LIMIT: Final = 1000  # keys of one page unless told

_SECRET_BYTES: Final = 32
_ID_BYTES: Final = 8
_TOUCH_EVERY_US: Final = 60_000_000  # a key used all the time costs one write a minute


@dataclass(frozen=True, slots=True)
class ApiKey:
    """What is known of a key; never its secret."""

    key_id: str
    name: str
    scopes: frozenset[Scope]
    sensor_ids: frozenset[str] | None  # sensors it may send frames for; None: every sensor
    created_us: int
    revoked_us: int | None
    last_used_us: int | None
    rotated_us: int | None  # when it got its present secret; None: at its creation

    def may_ingest(self, sensor_id: str) -> bool:
        """Return whether the key may send frames for this sensor."""
        return "ingest" in self.scopes and (self.sensor_ids is None or sensor_id in self.sensor_ids)


def create_key(
    connection: Connection,
    *,
    name: str,
    scopes: Collection[str],
    sensor_ids: Collection[str] | None = None,
    now_us: int,
) -> tuple[ApiKey, str]:
    """Create a key and return it with its secret, which cannot be read again.

    Raises InvalidInput for an unknown scope or sensor, or when sensors are named without the scope `ingest`.
    """
    wanted: list[Scope] = [scope for scope in SCOPES if scope in scopes]
    if not wanted or len(wanted) != len(set(scopes)):
        raise InvalidInput.at("/scopes", f"want some of {', '.join(SCOPES)}, got {sorted(scopes)}")
    if sensor_ids is not None:
        _check_sensors(connection, wanted, sensor_ids)
    secret = secrets.token_urlsafe(_SECRET_BYTES)
    key_id = secrets.token_hex(_ID_BYTES)
    connection.execute(
        insert(api_keys).values(
            key_id=key_id,
            name=name,
            digest=_digest(secret),
            scopes=wanted,
            sensor_ids=None if sensor_ids is None else sorted(set(sensor_ids)),
            created_us=now_us,
        )
    )
    return read_key(connection, key_id), secret


def find_key(connection: Connection, secret: str) -> ApiKey | None:
    """Return the valid key with this secret, None when there is none or it was revoked."""
    query = select(api_keys).where(api_keys.c.digest == _digest(secret), api_keys.c.revoked_us.is_(None))
    row = connection.execute(query).mappings().one_or_none()
    return None if row is None else _api_key(row)


def read_key(connection: Connection, key_id: str) -> ApiKey:
    """Return a key, revoked or not; raises NotFound."""
    row = connection.execute(select(api_keys).where(api_keys.c.key_id == key_id)).mappings().one_or_none()
    if row is None:
        raise NotFound(f"no key {key_id}")
    return _api_key(row)


def list_keys(
    connection: Connection,
    *,
    include_revoked: bool = False,
    cursor: str | None = None,
    limit: int = LIST_LIMIT,
) -> Page[ApiKey]:
    """Return keys in the order in which they were made."""
    order = (api_keys.c.created_us, api_keys.c.key_id)
    query = select(api_keys).order_by(*order).limit(check_limit(limit) + 1)
    if not include_revoked:
        query = query.where(api_keys.c.revoked_us.is_(None))
    if cursor is not None:
        created_us, key_id = read_cursor(cursor, int, str)
        query = query.where(
            or_(order[0] > created_us, (order[0] == created_us) & (order[1] > key_id)),
        )
    found = [_api_key(row) for row in connection.execute(query).mappings()]
    return cut(found, limit, lambda key: (key.created_us, key.key_id))


def revoke_key(connection: Connection, key_id: str, *, now_us: int) -> ApiKey:
    """Make a key worthless for good and return it; again has no effect. Raises NotFound."""
    connection.execute(
        update(api_keys)
        .where(api_keys.c.key_id == key_id, api_keys.c.revoked_us.is_(None))
        .values(revoked_us=now_us)
    )
    return read_key(connection, key_id)


def rotate_key(connection: Connection, key_id: str, *, now_us: int) -> tuple[ApiKey, str]:
    """Give a key another secret and return both; the one before is worthless from now on.

    Raises NotFound, and Conflict when the key is revoked.
    """
    if read_key(connection, key_id).revoked_us is not None:
        raise Conflict(f"key {key_id} is revoked; make another")
    secret = secrets.token_urlsafe(_SECRET_BYTES)
    connection.execute(
        update(api_keys).where(api_keys.c.key_id == key_id).values(digest=_digest(secret), rotated_us=now_us)
    )
    return read_key(connection, key_id), secret


def note_use(connection: Connection, key_id: str, *, now_us: int) -> None:
    """Remember that a key was used, to the minute."""
    last = api_keys.c.last_used_us
    connection.execute(
        update(api_keys)
        .where(api_keys.c.key_id == key_id, or_(last.is_(None), last <= now_us - _TOUCH_EVERY_US))
        .values(last_used_us=now_us)
    )


def _check_sensors(connection: Connection, scopes: list[Scope], sensor_ids: Collection[str]) -> None:
    if "ingest" not in scopes:
        raise InvalidInput.at("/sensor_ids", "binds the scope ingest, which this key does not have")
    if not sensor_ids:
        raise InvalidInput.at("/sensor_ids", "want at least one sensor, or null for every sensor")
    for sensor_id in sorted(set(sensor_ids)):
        try:
            read_sensor(connection, sensor_id)
        except NotFound as error:
            raise InvalidInput.at("/sensor_ids", str(error)) from error


def _digest(secret: str) -> bytes:
    return hashlib.sha256(secret.encode("utf-8", "surrogateescape")).digest()


def _api_key(row: RowMapping) -> ApiKey:
    fields = dict(row)
    del fields["digest"]
    bound = fields.pop("sensor_ids")
    return ApiKey(
        scopes=frozenset(fields.pop("scopes")),
        sensor_ids=None if bound is None else frozenset(bound),
        **fields,
    )
