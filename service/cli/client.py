"""Speak to a running service over HTTP, and turn its problem replies into our errors."""

from __future__ import annotations

from typing import Self
from urllib.parse import urlencode

import httpx

from service.errors import Conflict, FieldError, InvalidInput, NotAllowed, NotFound, Unavailable, WaysideError

TIMEOUT_S = 30.0  # longer than the slowest flush that holds up a reply
DEFAULT_RETRY_S = 1.0


class Client:
    """The HTTP API of one service with one key."""

    def __init__(self, url: str, key: str | None) -> None:
        headers = {} if key is None else {"Authorization": f"Bearer {key}"}
        self._url = url.rstrip("/")
        self._http = httpx.Client(base_url=f"{self._url}/api/v1", headers=headers, timeout=TIMEOUT_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._http.close()

    def request(self, method: str, path: str, *, json: object = None) -> dict[str, object]:
        """Return the reply to a JSON request; raises the error of our tree that its status stands for."""
        return self._send(self._http.build_request(method, path, json=json))

    def items(self, path: str) -> list[dict[str, object]]:
        """Return all items of a list, page by page."""
        found: list[dict[str, object]] = []
        cursor: object = None
        while True:
            page = self.request("GET", path if cursor is None else f"{path}?{urlencode({'cursor': cursor})}")
            items = page.get("items")
            found += items if isinstance(items, list) else []
            cursor = page.get("next")
            if cursor is None:
                return found

    def post_ndjson(self, path: str, body: bytes) -> dict[str, object]:
        """Return the reply to lines of JSON that are gzip-compressed already."""
        headers = {"Content-Type": "application/x-ndjson", "Content-Encoding": "gzip"}
        return self._send(self._http.build_request("POST", path, content=body, headers=headers))

    def _send(self, request: httpx.Request) -> dict[str, object]:
        try:
            response = self._http.send(request)
        except httpx.TimeoutException:
            raise Unavailable(f"{self._url} did not answer within {TIMEOUT_S:.0f} s") from None
        except httpx.UnsupportedProtocol:
            raise InvalidInput(f"{self._url} is no address; want one such as http://127.0.0.1:8321") from None
        except httpx.TransportError as error:
            raise Unavailable(
                f"no service answers at {self._url} ({error}); start one by `wayside serve`"
            ) from None
        if response.is_error:
            raise _error_of(response)
        if not response.content:
            return {}
        reply = response.json()
        return reply if isinstance(reply, dict) else {"items": reply}


def _error_of(response: httpx.Response) -> WaysideError:
    problem = _problem(response)
    detail = str(problem.get("detail") or problem.get("title") or response.reason_phrase)
    status = response.status_code
    match status:
        case 401:
            error: WaysideError = NotAllowed(
                f"{detail} (give --key or WAYSIDE_KEY; `wayside key create` makes one)"
            )
        case 403:
            error = NotAllowed(detail)
        case 404:
            error = NotFound(detail)
        case 409:
            error = Conflict(detail)
        case 429 | 503:
            error = Unavailable(detail, _retry_after_s(response))
        case _ if response.is_client_error:
            error = InvalidInput(detail, _fields(problem))
        case _:
            error = WaysideError(f"the service failed with status {status}: {detail}")
    return error


def _problem(response: httpx.Response) -> dict[str, object]:
    if "json" not in response.headers.get("content-type", ""):
        return {}
    problem = response.json()
    return problem if isinstance(problem, dict) else {}


def _fields(problem: dict[str, object]) -> list[FieldError]:
    errors = problem.get("errors")
    if not isinstance(errors, list):
        return []
    return [
        FieldError(str(e.get("pointer", "")), str(e.get("detail", ""))) for e in errors if isinstance(e, dict)
    ]


def _retry_after_s(response: httpx.Response) -> float:
    text = response.headers.get("retry-after", "")
    return float(text) if text.isdigit() else DEFAULT_RETRY_S
