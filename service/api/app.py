"""Put the parts together: the FastAPI application over a host, a database and the settings."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial

from anyio import CapacityLimiter, to_thread
from fastapi import FastAPI
from fastapi.routing import APIRoute
from sqlalchemy import Engine

from service import __version__
from service.api import (
    audit,
    dashboard,
    diagnosis,
    events,
    flow,
    frames,
    health,
    keys,
    lanes,
    live,
    openapi,
    problems,
    reference,
    sensors,
    tracks,
)
from service.api.bodies import BodyRoom
from service.api.broadcast import Broadcasts
from service.api.dependencies import Services
from service.api.exports import Exports
from service.api.gate import LOOPBACK_NAMES, Gate, HttpMetrics
from service.api.intake import Application, take_frame
from service.api.rates import RateLimits
from service.api.security import Keyring, is_loopback
from service.api.writes import Writes
from service.pipeline.host import EmbeddedHost
from service.pipeline.nursery import Nursery
from service.settings import Settings

PARSED_BATCHES = 2  # at once; parsing holds the interpreter, so more would only take memory


def create_app(
    host: EmbeddedHost,
    engine: Engine,
    settings: Settings,
    *,
    insecure: bool = False,
    nursery: Nursery | None = None,
) -> FastAPI:
    """Return the application; it starts the host when it starts, and stops it when it ends.

    nursery: where processes for exports are started; without it threads make them.
    insecure: be open while no key exists also when other machines can reach the service.
    """
    local = is_loopback(settings.host)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        await to_thread.run_sync(host.start)
        try:
            yield
        finally:
            await to_thread.run_sync(host.stop)

    app = Application(
        title="Wayside",
        version=__version__,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        generate_unique_id_function=_operation_id,
    )
    app.state.services = Services(
        host,
        engine,
        settings,
        Keyring(engine, local=local or insecure),
        Broadcasts(host, settings.stream_rate_hz),
        BodyRoom(settings.body_limit_bytes),
        RateLimits(settings),
        CapacityLimiter(PARSED_BATCHES),
        Exports(engine, nursery),
    )
    for module in (
        frames,
        live,
        tracks,
        lanes,
        sensors,
        flow,
        diagnosis,
        events,
        keys,
        audit,
        health,
        reference,
        dashboard,
    ):
        app.include_router(module.router)
    app.router.default = dashboard.Dashboard()
    app.openapi = lambda: openapi.describe(app)  # type: ignore[method-assign]  # FastAPI's documented way
    problems.install(app)
    app.add_middleware(Writes)
    gate = partial(
        Gate,
        allowed_hosts=_allowed_hosts(settings, local=local),
        http_metrics=HttpMetrics(host.telemetry.registry),
        verbose=settings.log_level == "debug",
    )
    app.add_middleware(gate)
    app.short_way = gate(take_frame)
    return app


def _allowed_hosts(settings: Settings, *, local: bool) -> frozenset[str] | None:
    """Return the names that the Host header may hold, None for any.

    On the loopback only its own names, so that a web page cannot reach the service through a name of its own
    that it points at 127.0.0.1 (DNS rebinding). They stay accepted beside any others: a container's health
    check asks at 127.0.0.1.
    """
    named = frozenset(name.lower() for name in settings.allowed_hosts)
    return LOOPBACK_NAMES | named if local or named else None


def _operation_id(route: APIRoute) -> str:
    return route.name
