"""The short way of a posted frame: from the outermost layer straight to its route's function.

FastAPI's routing, dependencies and exception layers took 40 % of the time of a frame (CPU, 100 points), and
do nothing for it: its path holds one name, and its body is read by hand. The route itself stays as it is, for
the description of the API and for whatever this layer does not recognise.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

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


class Intake:
    """Wraps the application; takes single frames and passes everything else on."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._route = _Route()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one ASGI connection."""
        match = (
            _PATH.fullmatch(scope["path"]) if scope["type"] == "http" and scope["method"] == "POST" else None
        )
        if match is None:
            await self._app(scope, receive, send)
            return
        scope["route"] = self._route
        request = Request(scope, receive)
        try:
            reply = await frames.post_frame(match[1], request)
        except WaysideError as error:
            reply = problem_of(scope, error)
        await reply(scope, receive, send)
