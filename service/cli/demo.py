"""`wayside demo`: a simulated road, live, with nothing to prepare."""

from __future__ import annotations

import asyncio
import dataclasses
import tempfile
import webbrowser
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack, asynccontextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli import options
from service.cli.edge import one_sentence, say
from service.errors import Conflict, Unavailable

if TYPE_CHECKING:
    from sqlalchemy import Engine

    from service.pipeline.host import EmbeddedHost
    from service.tracking.model import Frame

SITE_ID = "demo"
LATITUDE_DEG, LONGITUDE_DEG = 52.5163, 13.3777  # somewhere for the map
HEADING_DEG = 85.0
BEHIND_US = 5_000_000  # after a longer pause (a closed laptop) the road goes on at the present time


@one_sentence()
def demo(
    *,
    port: options.Port = None,
    data_dir: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Keep the data here. [default: a temporary folder]")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Another number, another traffic.")] = 1,
    open_browser: Annotated[bool, typer.Option("--open", help="Open the dashboard in the browser.")] = False,
) -> None:
    """Serve a simulated road with its dashboard until interrupted."""
    from service.api.server import run
    from service.cli.database import read_settings
    from service.cli.kernels import warm_up
    from service.telemetry import set_up_logging

    def ready(address: str) -> None:
        say(f"A simulated road is tracked at {address} (Ctrl-C ends it)")
        if open_browser:
            webbrowser.open(address)

    def prepare(engine: Engine) -> None:
        _register(engine)
        warm_up()

    @asynccontextmanager
    async def traffic(host: EmbeddedHost) -> AsyncIterator[None]:
        task = asyncio.create_task(_drive(host, seed))
        try:
            yield
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task

    with ExitStack() as stack:
        if data_dir is None:
            data_dir = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="wayside-demo-")))
        settings = read_settings(host="127.0.0.1", port=port, data_dir=data_dir)
        settings = settings.model_copy(update={"database_url": None})
        set_up_logging("warning", settings.log_format)
        run(settings, on_ready=ready, prepare=prepare, beside=traffic)


def _register(engine: Engine) -> None:
    """Register the simulated site and its radar, unless an earlier demo did."""
    from service.cli.database import now_us
    from service.formats.sensor import SensorConfig
    from service.simulation.scenario import scenario_named
    from service.simulation.scene_files import site
    from service.storage.database import session_scope
    from service.storage.sites import create_sensor, create_site

    scenario = scenario_named("demo")
    pose = {"latitude_deg": LATITUDE_DEG, "longitude_deg": LONGITUDE_DEG, "heading_deg": HEADING_DEG}
    config = SensorConfig.model_validate(site(scenario, scenario.duration_s) | pose)
    with suppress(Conflict), session_scope(engine) as connection:
        create_site(
            connection,
            SITE_ID,
            name="Simulated road",
            latitude_deg=LATITUDE_DEG,
            longitude_deg=LONGITUDE_DEG,
            now_us=now_us(),
        )
        create_sensor(connection, config, site_id=SITE_ID, name="Simulated radar", now_us=now_us())


async def _drive(host: EmbeddedHost, seed: int) -> None:
    """Submit each frame of an endless simulated road when its time has come."""
    from service.cli.database import now_us
    from service.simulation.scenario import endless_frames

    frames = endless_frames("demo", seed=seed)
    frame = await asyncio.to_thread(_next, frames)
    shift_us = now_us() - frame.time_us
    while True:
        ahead_us = frame.time_us + shift_us - now_us()
        if ahead_us > 0:
            await asyncio.sleep(ahead_us / 1e6)
        elif ahead_us < -BEHIND_US:
            shift_us -= ahead_us
        try:
            await host.submit(frame.sensor_id, [dataclasses.replace(frame, time_us=frame.time_us + shift_us)])
        except Unavailable as error:
            say(f"A frame was not taken: {error}")
            await asyncio.sleep(error.retry_after_s)
        frame = await asyncio.to_thread(_next, frames)


def _next(frames: Iterator[Frame]) -> Frame:
    return next(frames)
