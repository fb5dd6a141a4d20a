"""Turn a stored page into a reply: the items, and the next cursor in body and Link header (RFC 8288)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from fastapi import Request, Response

from service.api.schemas import Page
from service.storage.page import Page as StoredPage

Stored = TypeVar("Stored")
Shown = TypeVar("Shown")


def page_reply(
    request: Request, response: Response, page: StoredPage[Stored], show: Callable[[Stored], Shown]
) -> Page[Shown]:
    """Return the page as shown to the client; sets the header `Link` when there is more."""
    if page.next_cursor is not None:
        response.headers["Link"] = next_link(request, page.next_cursor)
    return Page(items=[show(item) for item in page.items], next=page.next_cursor)


def next_link(request: Request, cursor: str) -> str:
    """Return the value of a Link header to the next page of this request."""
    url = request.url.include_query_params(cursor=cursor)
    return f'<{url.path}?{url.query}>; rel="next"'
