"""The short way of a posted frame: from the outermost layer straight to its route's function.

FastAPI's routing, dependencies and exception layers took 40 % of the time of a frame (CPU, 100 points), the
layers of the application around its middleware another 5 %, and they do nothing for it: its path holds one
name, and its body is read by hand. The route itself stays as it is, for the description of the API and for
whatever this layer does not recognise.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from fastapi import FastAPI
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from service.api import frames
from service.api.dependencies import PREFIX
from service.api.problems import problem_of
from service.errors import WaysideError

_PATH = re.compile(rf"{PREFIX}/sensors/([A-Za-z0-9_-]{{1,64}})/frames", re.ASCII)


@dataclass(frozen=True, slots=True)
class _Route:
    """What the metrics ask of a route."""

    path: str = f"{PREFIX}/sensors/{{sensor_id}}/frames"


_ROUTE = _Route()


class Application(FastAPI):
    """The application, with `short_way` for single frames in front of all else."""

    short_way: ASGIApp | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one ASGI connection."""
        if self.short_way is not None and scope["type"] == "http" and scope["method"] == "POST":
            match = _PATH.fullmatch(scope["path"])
            if match is not None:
                scope["app"], scope["route"] = self, _ROUTE
                scope["path_params"] = {"sensor_id": match[1]}
                await self.short_way(scope, receive, send)
                return
        await super().__call__(scope, receive, send)


async def take_frame(scope: Scope, receive: Receive, send: Send) -> None:
    """Take the frame in one request."""
    request = Request(scope, receive)
    try:
        reply = await frames.post_frame(scope["path_params"]["sensor_id"], request)
    except WaysideError as error:
        reply = problem_of(scope, error)
    await reply(scope, receive, send)
