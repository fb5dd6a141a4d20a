"""Serve the dashboard's files for every path that no route knows, and a page for each kind of problem."""

from __future__ import annotations

from pathlib import Path

from fastapi import APIRouter
from fastapi.responses import PlainTextResponse
from starlette.exceptions import HTTPException
from starlette.staticfiles import StaticFiles
from starlette.types import Message, Receive, Scope, Send

from service.api.problems import KINDS
from service.errors import NotFound

FILES = Path(__file__).parent.parent / "dashboard"

HEADERS = (
    (
        b"content-security-policy",
        (
            b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
            b"connect-src 'self'; font-src 'self'; manifest-src 'self'; base-uri 'none'; "
            b"form-action 'self'; frame-ancestors 'none'"
        ),
    ),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cache-control", b"no-cache"),  # with the ETag of the file: asked again, sent only when changed
)

router = APIRouter()


class Dashboard:
    """The application behind the router: static files, else a 404 problem."""

    def __init__(self, folder: Path = FILES) -> None:
        self._files = StaticFiles(directory=folder, html=True, check_dir=False)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection that no route took."""
        if (
            scope["type"] != "http"
            or scope["method"] not in {"GET", "HEAD"}
            or scope["path"].startswith("/api/")
        ):
            raise HTTPException(404, "there is nothing at this path")

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *HEADERS]
            await send(message)

        try:
            await self._files(scope, receive, send_guarded)
        except (HTTPException, RuntimeError):  # RuntimeError: the folder itself is missing
            raise HTTPException(404, "there is nothing at this path") from None


@router.get("/problems/{name}", response_class=PlainTextResponse, include_in_schema=False)
def read_problem(name: str) -> str:
    """What a kind of problem means; the `type` of every problem leads here."""
    kind = KINDS.get(name)
    if kind is None:
        raise NotFound(f"no kind of problem {name[:64]}")
    return f"{kind.title} (status {kind.status})\n\n{kind.explanation}\n"
