"""Render the OpenAPI description as one page without scripts, which works offline and under any policy."""

from __future__ import annotations

import base64
import hashlib
import json
from collections import defaultdict
from collections.abc import Iterator
from html import escape

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from service.api.openapi import Json, describe, operations

router = APIRouter()

_STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}
pre{background:#f3f5f7;padding:.7rem;overflow:auto;font-size:13px}code{font-size:14px}
summary{cursor:pointer;padding:.3rem 0}b.m{display:inline-block;width:4.5rem}"""
_STYLE_HASH = base64.b64encode(hashlib.sha256(_STYLE.encode()).digest()).decode()
_POLICY = f"default-src 'none'; style-src 'sha256-{_STYLE_HASH}'; base-uri 'none'; frame-ancestors 'none'"


@router.get("/docs", response_class=HTMLResponse, include_in_schema=False)
def read_reference(request: Request) -> HTMLResponse:
    """Return the reference of the API for people."""
    page = "".join(_page(describe(request.app)))
    return HTMLResponse(page, headers={"Content-Security-Policy": _POLICY})


def _page(schema: Json) -> Iterator[str]:
    info = schema["info"]
    yield f"<!doctype html><html lang=en><meta charset=utf-8><title>{escape(info['title'])} API</title>"
    yield f"<style>{_STYLE}</style><h1>{escape(info['title'])} API {escape(info['version'])}</h1>"
    yield f"<p>{escape(info['summary'])}.</p><p>{escape(info['description'])}</p>"
    yield "<p>Machine-readable: <a href=/openapi.json>/openapi.json</a></p>"
    by_tag: dict[str, list[tuple[str, str, Json]]] = defaultdict(list)
    for path, method, operation in operations(schema):
        by_tag[operation["tags"][0]].append((path, method, operation))
    for tag in schema["tags"]:
        yield f"<h2>{escape(tag['name'])}</h2><p>{escape(tag['description'])}</p>"
        for path, method, operation in by_tag[tag["name"]]:
            yield from _operation(path, method, operation)
    yield "</html>"


def _operation(path: str, method: str, operation: Json) -> Iterator[str]:
    yield f"<details><summary><b class=m>{method.upper()}</b><code>{escape(path)}</code></summary>"
    yield f"<p>{escape(operation.get('description', ''))}</p>"
    parameters = operation.get("parameters", [])
    if parameters:
        yield "<ul>"
        for parameter in parameters:
            text = f"{parameter['in']}: {parameter.get('description', '')}"
            yield f"<li><code>{escape(parameter['name'])}</code> ({escape(text)})"
        yield "</ul>"
    yield from _examples("Request", operation.get("requestBody", {}).get("content", {}))
    for status, response in operation["responses"].items():
        if status.startswith("2"):
            yield from _examples(f"Reply {status}", response.get("content", {}))
    yield "</details>"


def _examples(title: str, content: Json) -> Iterator[str]:
    for kind, described in content.items():
        for name, example in described.get("examples", {}).items():
            value = example["value"]
            text = value if isinstance(value, str) else json.dumps(value, indent=1)
            yield f"<p>{title}, {escape(kind)} ({escape(name)})</p><pre>{escape(text)}</pre>"
