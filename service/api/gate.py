"""The outermost layer of the application: request ids, whose server this is, and errors that nobody expected.

Plain ASGI, since Starlette's base class for middleware would copy every streamed reply through a queue.
"""

from __future__ import annotations

import itertools
import re
import secrets
import time
from urllib.parse import urlsplit

import structlog
from prometheus_client import CollectorRegistry, Counter, Histogram
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.headers import header
from service.api.problems import KINDS, problem_response
from service.api.security import host_name

LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]"})

CLIENT_LEFT = 499  # in the metrics, for requests whose sender hung up; nobody is there to hear it

REPLY_POLICY = "default-src 'none'; frame-ancestors 'none'; base-uri 'none'"  # pages say their own
_MARKS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"content-security-policy", REPLY_POLICY.encode()),
)
_NONE: dict[str, str] = {}

_SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
_METHODS = _SAFE_METHODS | {"POST", "PATCH", "PUT", "DELETE"}
_BUCKETS_S = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 5.0, 30.0)
_REQUEST_ID = re.compile(r"[A-Za-z0-9_-]{8,64}", re.ASCII)
_TRACE_PARENT = re.compile(r"[0-9a-f]{2}-([0-9a-f]{32})-[0-9a-f]{16}-[0-9a-f]{2}", re.ASCII)

_log = structlog.get_logger(__name__)


class HttpMetrics:
    """Counts requests and their time by route; paths that no route knows are one label."""

    def __init__(self, registry: CollectorRegistry) -> None:
        labels = ("method", "route", "status")
        self._known: dict[tuple[str, str, int], tuple[Counter, Histogram]] = {}
        self._requests = Counter(
            "wayside_http_requests", "Requests by route and status.", labels, registry=registry
        )
        self._seconds = Histogram(
            "wayside_http_request_seconds",
            "Time to the end of a reply; waiting of long polls and streams included.",
            ("route",),
            registry=registry,
            buckets=_BUCKETS_S,
        )

    def observe(self, scope: Scope, status: int, spent_s: float) -> None:
        """Count one request that is over."""
        route = str(getattr(scope.get("route"), "path", "other"))
        method = scope["method"] if scope["method"] in _METHODS else "other"
        known = self._known.get((method, route, status))
        if known is None:  # the labels are few; finding them took longer than counting
            known = self._requests.labels(method, route, str(status)), self._seconds.labels(route)
            self._known[method, route, status] = known
        known[0].inc()
        known[1].observe(spent_s)


class Gate:
    """Wraps the application; `allowed_hosts` None accepts every Host header."""

    def __init__(
        self,
        app: ASGIApp,
        allowed_hosts: frozenset[str] | None,
        http_metrics: HttpMetrics,
        *,
        verbose: bool = False,
    ) -> None:
        self._app = app
        self._verbose = verbose  # a line for each request; making one that nobody wants took 20 us
        self._allowed_hosts = allowed_hosts
        self._metrics = http_metrics
        # A request id is the process's name and a number: asking the system for random bytes lets go of the
        # interpreter, and getting it back from a busy tracker took 2 ms a request.
        self._name = secrets.token_hex(4)
        self._numbers = itertools.count(1)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one ASGI connection."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = _given_id(scope) or f"{self._name}{next(self._numbers):08x}"
        scope.setdefault("state", {})["request_id"] = request_id
        status = 0  # of the reply, once it has begun

        async def send_marked(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                rates = scope["state"].get("rate_headers", _NONE)
                extra = [(name.lower().encode(), value.encode()) for name, value in rates.items()]
                marks = [(b"x-request-id", request_id.encode()), *_MARKS, *extra]
                given = {name.lower() for name, _ in message["headers"]}
                message["headers"] = [*message["headers"], *(mark for mark in marks if mark[0] not in given)]
            await send(message)

        begun_s = time.perf_counter()
        bound = structlog.contextvars.bind_contextvars(request_id=request_id)
        try:
            refusal = self._refusal(scope)
            if refusal is not None:
                kind, detail = refusal
                await problem_response(scope, KINDS[kind], detail)(scope, receive, send_marked)
                return
            try:
                await self._app(scope, receive, send_marked)
            except ClientDisconnect:
                status = status or CLIENT_LEFT
                _log.debug("client left", method=scope["method"], path=scope["path"])
            except Exception:
                _log.exception("request failed", method=scope["method"], path=scope["path"])
                if status:  # the reply has begun: cutting it off is the only way left to tell the client
                    raise
                reply = problem_response(
                    scope,
                    KINDS["internal"],
                    "an unexpected error; its details are in the log under this request id",
                )
                await reply(scope, receive, send_marked)
            finally:
                spent_s = time.perf_counter() - begun_s
                self._metrics.observe(scope, status, spent_s)
                if self._verbose:
                    _log.debug(
                        "request", method=scope["method"], path=scope["path"], seconds=round(spent_s, 6)
                    )
        finally:
            structlog.contextvars.reset_contextvars(**bound)

    def _refusal(self, scope: Scope) -> tuple[str, str] | None:
        """Return the kind of problem and its detail for requests that a strange web page may have caused."""
        host = header(scope, b"host") or ""
        if self._allowed_hosts is not None and host_name(host) not in self._allowed_hosts:
            return "misdirected", f"this server does not answer for the host {host[:200]!r}"
        origin = header(scope, b"origin")
        if origin is not None and scope["method"] not in _SAFE_METHODS and urlsplit(origin).netloc != host:
            return "not-allowed", "a page of another origin may not change anything here"
        return None


def _given_id(scope: Scope) -> str | None:
    """Return the caller's trace or request id where it gives a well-formed one."""
    parent = header(scope, b"traceparent")
    trace = None if parent is None else _TRACE_PARENT.fullmatch(parent)
    if trace is not None:
        return trace.group(1)
    given = header(scope, b"x-request-id")
    return given if given is not None and _REQUEST_ID.fullmatch(given) else None
