"""Turn errors into `application/problem+json` replies (RFC 9457), the only form of error that is given."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus

import orjson
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException
from starlette.routing import compile_path

from service.errors import (
    Conflict,
    FieldError,
    InvalidInput,
    NotAllowed,
    NotFound,
    Unavailable,
    WaysideError,
)

MEDIA_TYPE = "application/problem+json"


class ProblemField(BaseModel):
    """One wrong value of a request."""

    pointer: str = Field(description="JSON Pointer (RFC 6901) into the body, or /name of a parameter")
    detail: str


class Problem(BaseModel):
    """What went wrong, after RFC 9457."""

    type: str = Field(description="stable name of the kind of problem; a page that explains it")
    title: str
    status: int
    detail: str
    instance: str = Field(description="path of the request")
    request_id: str = Field(description="also in the header X-Request-ID and in the log")
    errors: list[ProblemField] = []


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of problem: its name in the type URI, its status and what a reader should know."""

    name: str
    status: int
    title: str
    explanation: str


KINDS = {
    kind.name: kind
    for kind in (
        Kind(
            "invalid-input",
            422,
            "Invalid input",
            "A value of the request is wrong; `errors` names it by JSON Pointer.",
        ),
        Kind("bad-request", 400, "Bad request", "The request cannot be understood as it stands."),
        Kind(
            "unauthenticated",
            401,
            "Key needed",
            "Send a valid API key as `Authorization: Bearer KEY` or `X-API-Key: KEY`, or open a session.",
        ),
        Kind(
            "not-allowed",
            403,
            "Not allowed",
            "The key lacks the scope or the sensor that this request needs.",
        ),
        Kind("not-found", 404, "Not found", "There is no such thing, or no such path."),
        Kind(
            "method-not-allowed",
            405,
            "Method not allowed",
            "The path exists; the header Allow lists its methods.",
        ),
        Kind(
            "not-acceptable",
            406,
            "Not acceptable",
            "None of the media types in Accept can be given; `detail` lists them.",
        ),
        Kind(
            "too-slow",
            408,
            "Too slow",
            "The body of the request did not arrive in time.",
        ),
        Kind("conflict", 409, "Conflict", "The thing exists already, or exists with another content."),
        Kind(
            "too-large",
            413,
            "Too large",
            "The body is larger than the limit, before or after decompression; send fewer frames at once.",
        ),
        Kind(
            "unsupported-media-type",
            415,
            "Unsupported media type",
            "Send application/json, to frames:batch also application/x-ndjson; frames may have "
            "Content-Encoding gzip or zstd.",
        ),
        Kind(
            "misdirected",
            421,
            "Misdirected request",
            "The Host header is none of this server's names; set WAYSIDE_ALLOWED_HOSTS to accept it.",
        ),
        Kind(
            "too-many-requests",
            429,
            "Too many requests",
            "The key asks more often than it may; Retry-After says when to ask again.",
        ),
        Kind(
            "internal", 500, "Internal error", "A fault of the service; the request id finds it in the log."
        ),
        Kind(
            "unavailable",
            503,
            "Try again later",
            "The service cannot do this now; Retry-After says when to ask.",
        ),
    )
}
_BY_STATUS = {kind.status: kind for kind in KINDS.values()}


class HttpProblem(WaysideError):  # noqa: N818 - reads as a sentence where it is raised
    """A refusal that only HTTP knows, such as a media type that cannot be given."""

    def __init__(self, name: str, detail: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(detail)
        self.kind = KINDS[name]
        self.headers = dict(headers or {})


def problem_response(
    scope: Mapping[str, object],
    kind: Kind,
    detail: str,
    errors: Sequence[FieldError] = (),
    headers: Mapping[str, str] | None = None,
) -> Response:
    """Return the reply for one problem of the request with this ASGI scope."""
    body = {
        "type": f"/problems/{kind.name}",
        "title": kind.title,
        "status": kind.status,
        "detail": detail,
        "instance": scope.get("path", ""),
        "request_id": request_id_of(scope),
        "errors": [{"pointer": error.pointer, "detail": error.reason} for error in errors],
    }
    return Response(orjson.dumps(body), kind.status, headers, media_type=MEDIA_TYPE)


def request_id_of(scope: Mapping[str, object]) -> str:
    """Return the id that the outermost layer gave the request."""
    state = scope.get("state")
    return str(state.get("request_id", "")) if isinstance(state, dict) else ""


def install(app: FastAPI) -> None:
    """Give every expected error of the application its problem reply."""
    app.add_exception_handler(WaysideError, _wayside)
    app.add_exception_handler(RequestValidationError, _validation)
    app.add_exception_handler(HTTPException, _http)


async def _wayside(request: Request, error: Exception) -> Response:
    if not isinstance(error, WaysideError):
        raise error
    return problem_of(request.scope, error)


def problem_of(scope: Mapping[str, object], error: WaysideError) -> Response:
    """Return the reply for an expected error; raises the error itself where no status fits it."""
    headers: dict[str, str] = {}
    errors: Sequence[FieldError] = ()
    if isinstance(error, HttpProblem):
        return problem_response(scope, error.kind, str(error), headers=error.headers)
    if isinstance(error, InvalidInput):
        name, errors = "invalid-input", error.errors
    elif isinstance(error, NotFound):
        name = "not-found"
    elif isinstance(error, Conflict):
        name = "conflict"
    elif isinstance(error, NotAllowed):
        name = "not-allowed"
    elif isinstance(error, Unavailable):
        name, headers = "unavailable", {"Retry-After": str(math.ceil(error.retry_after_s))}
    else:
        raise error
    return problem_response(scope, KINDS[name], str(error), errors, headers)


async def _validation(request: Request, error: Exception) -> Response:
    if not isinstance(error, RequestValidationError):
        raise error
    errors = [FieldError(_pointer(fault["loc"]), str(fault["msg"])) for fault in error.errors()]
    first = errors[0] if errors else FieldError("", "the request is not valid")
    detail = f"{first.pointer or 'body'}: {first.reason}"
    return problem_response(request.scope, KINDS["invalid-input"], detail, errors)


def _pointer(location: Sequence[object]) -> str:
    """Return the JSON Pointer of pydantic's location; its first part says body, query or path."""
    parts = [str(part).replace("~", "~0").replace("/", "~1") for part in location[1:]]
    if location and location[0] == "body" and parts and parts[0].isdigit() and len(parts) == 1:
        return ""  # the offset at which the JSON broke off
    return "".join(f"/{part}" for part in parts)


async def _http(request: Request, error: Exception) -> Response:
    if not isinstance(error, HTTPException):
        raise error
    kind = _BY_STATUS.get(error.status_code)
    if kind is None:
        status = HTTPStatus(error.status_code)
        kind = Kind(status.phrase.lower().replace(" ", "-"), status.value, status.phrase, status.description)
    headers = dict(error.headers or {})
    if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
        headers["Allow"] = ", ".join(_methods(request))
    return problem_response(request.scope, kind, str(error.detail), headers=headers)


def _methods(request: Request) -> list[str]:
    """Return the methods that any route takes at the path (Starlette names only those of the first)."""
    found = set[str]()
    for template, operations in request.app.openapi()["paths"].items():
        if compile_path(template)[0].match(request.scope["path"]):
            found |= {method.upper() for method in operations}
    return sorted(found)
