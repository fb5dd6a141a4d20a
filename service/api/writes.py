"""In front of every administrative change: clear JSON of bounded size, no second effect of a repeated POST.

`Idempotency-Key` as in draft-ietf-httpapi-idempotency-key-header-07: the same key with the same body gives
the first reply again (for a day), with another body 422, while the first request is still running 409. Only
replies of success are kept: a refused request changed nothing and may be tried again. Posts of frames have
their natural key and pass by.
"""

from __future__ import annotations

import hashlib
import re
import time
from dataclasses import dataclass

from anyio import to_thread
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.bodies import is_json, media_type, read_body
from service.api.dependencies import PREFIX, Services, identify, services_of
from service.api.problems import HttpProblem, problem_of
from service.errors import Conflict, InvalidInput, WaysideError
from service.formats.strict_json import strict_json
from service.storage.database import connection, session_scope
from service.storage.replies import KeptReply, find_reply, keep_reply

BODY_LIMIT_BYTES = 2**20  # of a site, a sensor or a key

_METHODS = frozenset({"POST", "PATCH", "PUT", "DELETE"})
_KEY = re.compile(r'"([\x20-\x21\x23-\x5b\x5d-\x7e]{1,255})"|([A-Za-z0-9._~:/+=-]{1,255})', re.ASCII)
_KEPT_HEADERS = frozenset({"content-type", "location"})
_SUCCESS = range(200, 300)


@dataclass(slots=True)
class _Recorded:
    """The reply of the application, as its messages came."""

    messages: list[Message]

    @property
    def status(self) -> int:
        return int(self.messages[0]["status"]) if self.messages else 0

    @property
    def headers(self) -> dict[str, str]:
        return {name.decode().lower(): value.decode() for name, value in self.messages[0]["headers"]}

    @property
    def body(self) -> bytes:
        return b"".join(message.get("body", b"") for message in self.messages[1:])


class Writes:
    """Wraps the application."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._running: set[bytes] = set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one ASGI connection."""
        path: str = scope.get("path", "")
        ours = scope["type"] == "http" and scope["method"] in _METHODS and path.startswith(PREFIX)
        if not ours or path.endswith(("/frames", "/frames:batch")):
            await self._app(scope, receive, send)
            return
        request = Request(scope, receive)
        try:
            body = await _checked_body(request)
            reply = await self._answer(request, body, receive, send)
        except WaysideError as error:
            reply = problem_of(scope, error)
        if reply is not None:
            await reply(scope, receive, send)

    async def _answer(self, request: Request, body: bytes, receive: Receive, send: Send) -> Response | None:
        """Return what was answered before, or let the application answer (None)."""
        header = request.headers.get("idempotency-key")
        again = _again(body, receive)
        if header is None or request.method != "POST" or request.url.path.endswith("/session"):
            await self._app(request.scope, again, send)
            return None
        services = services_of(request)
        name = await _name(request, services, header)
        if name in self._running:
            raise Conflict("a request with this Idempotency-Key is still running")
        self._running.add(name)
        try:
            kept = await to_thread.run_sync(_find, services, name)
            if kept is not None:
                return _repeat(kept, body)
            await self._answer_and_keep(request.scope, again, send, services, name, body)
        finally:
            self._running.discard(name)
        return None

    async def _answer_and_keep(  # noqa: PLR0913, PLR0917 - one exchange
        self, scope: Scope, receive: Receive, send: Send, services: Services, name: bytes, body: bytes
    ) -> None:
        recorded = _Recorded([])

        async def record(message: Message) -> None:
            recorded.messages.append(message)

        await self._app(scope, receive, record)
        if recorded.status in _SUCCESS:
            await to_thread.run_sync(_keep, services, name, body, recorded)
        for message in recorded.messages:
            await send(message)


async def _checked_body(request: Request) -> bytes:
    """Return the body if it is empty or clear JSON; raises HttpProblem 413 or 415, and InvalidInput."""
    if request.headers.get("content-encoding", "identity").strip().lower() != "identity":
        raise HttpProblem("unsupported-media-type", "only bodies of frames may have a Content-Encoding")
    body = await read_body(request, BODY_LIMIT_BYTES)
    if not body:
        return body
    kind = media_type(request)
    if not is_json(kind):
        raise HttpProblem("unsupported-media-type", f"want application/json, got {kind[:100]!r}")
    strict_json(body)
    return body


def _again(body: bytes, receive: Receive) -> Receive:
    """Return a `receive` that gives the body once more, and then what comes after it."""
    given = False

    async def receive_again() -> Message:
        nonlocal given
        if given:
            return await receive()
        given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return receive_again


async def _name(request: Request, services: Services, header: str) -> bytes:
    """Return under what a reply is kept: the key belongs to its caller and to the path."""
    match = _KEY.fullmatch(header.strip())
    if match is None:
        raise HttpProblem("bad-request", 'want Idempotency-Key: "1 to 255 printable characters"')
    caller = await identify(request, services)
    caller.require("admin")
    parts = (caller.name, request.url.path, match.group(1) or match.group(2))
    return hashlib.sha256("\0".join(parts).encode()).digest()


def _repeat(kept: KeptReply, body: bytes) -> Response:
    if kept.request != hashlib.sha256(body).digest():
        raise InvalidInput("this Idempotency-Key came before with another body")
    if kept.body is None:
        at = kept.headers.get("location", "the key")
        raise Conflict(
            f"done by an earlier request; its secret is shown once: rotate {at} if the reply was lost"
        )
    headers = {**kept.headers, "Idempotency-Replayed": "true"}
    return Response(kept.body, kept.status, headers)


def _find(services: Services, name: bytes) -> KeptReply | None:
    with connection(services.engine) as reader:
        return find_reply(reader, name, now_us=_now_us())


def _keep(services: Services, name: bytes, body: bytes, recorded: _Recorded) -> None:
    headers = recorded.headers
    secret = headers.get("cache-control") == "no-store"  # a secret is kept nowhere
    reply = KeptReply(
        hashlib.sha256(body).digest(),
        recorded.status,
        {key: value for key, value in headers.items() if key in _KEPT_HEADERS},
        None if secret else recorded.body,
    )
    with session_scope(services.engine) as writer:
        keep_reply(writer, name, reply, now_us=_now_us())


def _now_us() -> int:
    return time.time_ns() // 1000
