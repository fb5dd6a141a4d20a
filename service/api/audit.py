"""The audit log over HTTP: who changed what, and when."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from service.api.dependencies import PREFIX, AdminKey, Cursor, Limit, Reader
from service.api.paging import page_reply
from service.api.schemas import ActReply, Page
from service.storage.audit import list_acts

router = APIRouter(prefix=PREFIX)


@router.get("/audit", tags=["keys"])
def read_audit(  # noqa: PLR0913, PLR0917 - one parameter of the query each
    request: Request,
    response: Response,
    reader: Reader,
    _: AdminKey,
    action: Annotated[str | None, Query(max_length=64, examples=["key.created"])] = None,
    target: Annotated[str | None, Query(max_length=64, description="id of what was changed")] = None,
    cursor: Cursor = None,
    limit: Limit = 100,
) -> Page[ActReply]:
    """Administrative acts, the newest first; nothing here can be changed."""
    page = list_acts(reader, action=action, target=target, cursor=cursor, limit=limit)
    return page_reply(request, response, page, ActReply.of)
