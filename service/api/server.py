"""Run the service: database, host and application behind one HTTP server, until a signal ends it."""

from __future__ import annotations

import logging
import signal
import socket
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager, contextmanager, nullcontext, suppress
from types import FrameType
from typing import Any

import uvicorn
from fastapi import FastAPI
from sqlalchemy import Engine

from service.api import exports
from service.api.app import create_app
from service.api.dependencies import Services
from service.api.security import is_loopback
from service.errors import InvalidInput, StorageError, WaysideError
from service.pipeline import tracker_process
from service.pipeline.host import EmbeddedHost, wall_clock_us
from service.pipeline.nursery import Nursery
from service.settings import Settings
from service.storage.database import connection, open_database
from service.storage.keys import list_keys
from service.storage.migrate import upgrade
from service.tracking import tracker

Beside = Callable[[EmbeddedHost], AbstractAsyncContextManager[None]]

GRACE_S = 10  # for requests under way when the service is told to stop; streams end at once
BACKLOG = 512

# How long the tracker thread may keep the interpreter from the event loop. Python's 5 ms add up over the
# several times that a request lets go of it: at ten sensors of 20 Hz the median from post to readable fell
# from 161 to 76 ms on two cores that were busy otherwise.
SWITCH_S = 0.001


def run(
    settings: Settings,
    *,
    insecure: bool = False,
    on_ready: Callable[[str], None] | None = None,
    prepare: Callable[[Engine], None] | None = None,
    beside: Beside | None = None,
) -> None:
    """Serve until SIGTERM or SIGINT; prints nothing. `on_ready` hears the address once requests are answered.

    `prepare` works on the migrated database before anything starts; `beside` runs in the event loop as long
    as the host does. Raises InvalidInput when other machines could reach the service without any key (unless
    `insecure`), and StorageError when the port, the database or the data directory cannot be used.
    """
    nursery: Nursery | None = None
    with listening(settings) as listener:
        engine = open_database(settings.rows_url)
        try:
            upgrade(engine)
            if prepare is not None:
                prepare(engine)
            refuse_open_network(engine, settings, insecure=insecure)
            nursery = _nursery(engine, settings)
            host = EmbeddedHost(engine, settings, nursery=nursery)
            app = create_app(host, engine, settings, insecure=insecure, nursery=nursery)
            failures = _watch(app, host, beside)
            server = Server(app, settings, on_ready)
            sys.setswitchinterval(SWITCH_S)
            with _calm_signals(), suppress(SystemExit):  # uvicorn's word for a start that failed
                server.run(sockets=[listener])
            if failures:
                raise failures[0]
            if not server.started:
                raise StorageError("the service could not start; the log says why")
        finally:
            if nursery is not None:
                nursery.close()
            engine.dispose()


def _nursery(engine: Engine, settings: Settings) -> Nursery | None:
    """Make the process that starts the helpers, None where there are none; no thread may run yet."""
    if not settings.tracker_process_count:
        return None
    engine.dispose()  # a connection must not be shared with a fork
    return Nursery(
        {
            tracker_process.WORK: tracker_process.work_of(settings, tracker, wall_clock_us),
            exports.WORK: exports.work_of(settings.rows_url),
        }
    )


def refuse_open_network(engine: Engine, settings: Settings, *, insecure: bool) -> None:
    """Raise InvalidInput when the address can be reached from outside and no key is there to ask for."""
    if insecure or is_loopback(settings.host):
        return
    with connection(engine) as reader:
        if not list_keys(reader, limit=1).items:
            raise InvalidInput.at(
                "/host",
                f"{settings.host} can be reached from other machines, and there is no API key yet; "
                "create one by `wayside key create --scope admin`, or allow this by --insecure",
            )


def _watch(app: FastAPI, host: EmbeddedHost, beside: Beside | None) -> list[WaysideError]:
    """Run `beside` within the application's life; return where the reason of a failed start will stand."""
    inner, failures = app.router.lifespan_context, list[WaysideError]()

    @asynccontextmanager
    async def life(application: FastAPI) -> AsyncIterator[Any]:
        try:
            async with inner(application) as state, beside(host) if beside is not None else nullcontext():
                yield state
        except WaysideError as error:
            failures.append(error)
            logging.getLogger("uvicorn.error").disabled = True  # it would add a traceback to the reason
            raise

    app.router.lifespan_context = life
    return failures


class Server(uvicorn.Server):
    """A uvicorn server that says when it is ready, and ends waiting replies before it waits for them."""

    def __init__(
        self, app: FastAPI, settings: Settings, on_ready: Callable[[str], None] | None = None
    ) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                log_config=None,  # structlog has the log
                access_log=False,
                server_header=False,
                backlog=BACKLOG,
                timeout_graceful_shutdown=GRACE_S,
            )
        )
        self._services: Services = app.state.services
        self._settings = settings
        self._on_ready = on_ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start the application and listen."""
        await super().startup(sockets=sockets)
        if self.started and self._on_ready is not None and sockets:
            self._on_ready(address(self._settings.host, sockets[0].getsockname()[1]))

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End streams and long polls, let the other requests finish, stop the application."""
        self._services.host.live.end()
        await super().shutdown(sockets=sockets)


def address(host: str, port: int) -> str:
    """Return the URL of the service as a browser on this machine would open it."""
    if host in {"0.0.0.0", "::", ""}:  # noqa: S104 - shown, not bound
        host = "127.0.0.1"
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


@contextmanager
def listening(settings: Settings) -> Iterator[socket.socket]:
    """Yield a socket bound to the address of the settings; raises StorageError when it is taken."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((settings.host, settings.port))
        except OSError as error:
            raise StorageError(
                f"cannot listen on {settings.host} port {settings.port}: {error.strerror or error}; "
                "choose another by --port or WAYSIDE_PORT (0: any free one)"
            ) from None
        yield listener
    finally:
        listener.close()


@contextmanager
def _calm_signals() -> Iterator[None]:
    """Keep uvicorn from raising the signals again that it has already answered by an orderly stop."""

    def ignore(_signal: int, _frame: FrameType | None) -> None:
        """Do nothing: uvicorn has handled the signal and gives it back when it is done."""

    kept = {number: signal.signal(number, ignore) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)
