"""Header fields of a request, looked up at once instead of one by one along the list."""

from __future__ import annotations

from starlette.types import Scope

_KEY = "wayside.headers"


def header(scope: Scope, name: bytes) -> str | None:
    """Return the first field of that name (in lower case) of an ASGI scope, None where there is none."""
    fields: dict[bytes, bytes] | None = scope.get(_KEY)
    if fields is None:
        fields = scope[_KEY] = dict(reversed(scope["headers"]))
    value = fields.get(name)
    return None if value is None else value.decode("latin-1")
