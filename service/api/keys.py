"""API keys and dashboard sessions over HTTP."""

from __future__ import annotations

import time
from collections.abc import Mapping

from fastapi import APIRouter, Request, Response, status
from sqlalchemy import Connection

from service.api.dependencies import (
    PREFIX,
    AdminKey,
    CallerDep,
    Cursor,
    Limit,
    Reader,
    ServicesDep,
    open_caller,
)
from service.api.paging import page_reply
from service.api.problems import HttpProblem
from service.api.schemas import Identifier, KeyInput, KeyReply, NewKeyReply, Page, SessionReply
from service.api.security import SESSION_COOKIE, SESSION_S, Caller
from service.storage import keys as store
from service.storage.audit import note_act
from service.storage.database import session_scope

router = APIRouter(prefix=PREFIX)


@router.post("/keys", status_code=status.HTTP_201_CREATED, tags=["keys"])
def create_key(body: KeyInput, services: ServicesDep, response: Response, caller: AdminKey) -> NewKeyReply:
    """Make an API key; its secret is in this reply and nowhere else."""
    with session_scope(services.engine) as writer:
        key, secret = store.create_key(
            writer,
            name=body.name,
            scopes=body.scopes,
            sensor_ids=body.sensor_ids,
            now_us=_now_us(),
        )
        detail = {"name": key.name, "scopes": sorted(key.scopes), "sensor_ids": body.sensor_ids}
        _note(writer, caller, "key.created", key.key_id, detail)
    services.keyring.forget()
    response.headers["Location"] = f"/api/v1/keys/{key.key_id}"
    response.headers["Cache-Control"] = "no-store"
    return NewKeyReply.made(key, secret)


@router.get("/keys", tags=["keys"])
def list_keys(
    request: Request,
    reader: Reader,
    response: Response,
    _: AdminKey,
    cursor: Cursor = None,
    limit: Limit = 1000,
) -> Page[KeyReply]:
    """Valid keys, without their secrets."""
    return page_reply(request, response, store.list_keys(reader, cursor=cursor, limit=limit), KeyReply.of)


@router.post("/keys/{key_id}:rotate", tags=["keys"])
def rotate_key(
    key_id: Identifier, services: ServicesDep, response: Response, caller: AdminKey
) -> NewKeyReply:
    """Give a key another secret; the one before, and sessions opened with it, end at once."""
    with session_scope(services.engine) as writer:
        key, secret = store.rotate_key(writer, key_id, now_us=_now_us())
        _note(writer, caller, "key.rotated", key_id)
    services.keyring.forget()
    response.headers["Cache-Control"] = "no-store"
    return NewKeyReply.made(key, secret)


@router.delete("/keys/{key_id}", status_code=status.HTTP_204_NO_CONTENT, tags=["keys"])
def revoke_key(key_id: Identifier, services: ServicesDep, caller: AdminKey) -> None:
    """Make a key worthless, at once and for good."""
    with session_scope(services.engine) as writer:
        store.revoke_key(writer, key_id, now_us=_now_us())
        _note(writer, caller, "key.revoked", key_id)
    services.keyring.forget()


@router.get("/session", tags=["session"])
async def read_session(request: Request, services: ServicesDep, response: Response) -> SessionReply:
    """Who the caller is; without a valid key or session the scopes are empty."""
    response.headers["Cache-Control"] = "no-store"
    return _reply(await open_caller(request, services))


@router.post("/session", tags=["session"])
async def open_session(
    request: Request, caller: CallerDep, services: ServicesDep, response: Response
) -> SessionReply:
    """Trade the key of this request for a cookie that only this server can read; it lasts twelve hours."""
    response.headers["Cache-Control"] = "no-store"
    if caller.by_cookie:
        raise HttpProblem("bad-request", "send the API key itself in a header, not a session")
    if caller.key is not None:
        response.set_cookie(
            SESSION_COOKIE,
            services.keyring.open_session(caller.key),
            max_age=SESSION_S,
            httponly=True,
            samesite="strict",
            secure=request.url.scheme == "https",
        )
    return _reply(caller)


@router.delete("/session", status_code=status.HTTP_204_NO_CONTENT, tags=["session"])
async def close_session(response: Response) -> None:
    """Forget the session of this browser."""
    response.delete_cookie(SESSION_COOKIE, httponly=True, samesite="strict")


def _note(
    writer: Connection, caller: Caller, action: str, key_id: str, detail: Mapping[str, object] | None = None
) -> None:
    note_act(writer, actor=caller.name, action=action, target=key_id, detail=detail, now_us=_now_us())


def _reply(caller: Caller | None) -> SessionReply:
    return SessionReply(
        open=caller is not None and caller.key is None,
        key_id=caller.key.key_id if caller is not None and caller.key is not None else None,
        scopes=sorted(caller.scopes) if caller is not None else [],
    )


def _now_us() -> int:
    return time.time_ns() // 1000
