"""Complete the OpenAPI description: security, problem replies, request bodies read by hand, and examples."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from service.api import examples
from service.api.problems import MEDIA_TYPE, Problem
from service.api.track_schemas import FrameInput

Json = dict[str, Any]  # a JSON object of the description

SUMMARY = "Traffic monitor for a roadside radar: detections in, tracks out"
DESCRIPTION = """Angles are in degrees clockwise, lengths in metres, times RFC 3339 in UTC with \
milliseconds; a unit stands in each field's name. `null` is "not known". Intervals are half-open, \
`[start, end)`. Errors are `application/problem+json` (RFC 9457) with a JSON Pointer for each wrong value."""
TAGS = (
    ("sites", "Places with sensors."),
    ("sensors", "Radars as mounted: pose, conventions, noise, region, tracker."),
    ("frames", "Detections in."),
    ("live", "The newest tracks: polled, long-polled or streamed."),
    ("tracks", "Stored tracks and their states."),
    ("lanes", "The lane map, learned from traffic or drawn by a user, and lane changes."),
    ("counts", "Crossings of count lines, traffic measures and what is behind them."),
    ("events", "What happened at a sensor."),
    ("keys", "API keys."),
    ("session", "A browser's session."),
    ("health", "Is the service alive, ready, and are its sensors?"),
)
_SECURITY: list[dict[str, list[str]]] = [
    {"bearer": []},
    {"header": []},
    {"session": []},
    {},
]  # {}: the open local mode
_SCHEMES = {
    "bearer": {"type": "http", "scheme": "bearer", "description": "an API key"},
    "header": {"type": "apiKey", "in": "header", "name": "X-API-Key", "description": "an API key"},
    "session": {
        "type": "apiKey",
        "in": "cookie",
        "name": "wayside_session",
        "description": "given by POST /api/v1/session",
    },
}
_REFUSALS = {
    "401": "no valid key",
    "403": "the key lacks the scope or the sensor",
    "429": "the key asks too often; Retry-After says when to ask again",
    "404": "no such thing",
    "422": "a value is wrong",
    "503": "try again after Retry-After seconds",
}
_PROBLEM_REF = {"$ref": "#/components/schemas/Problem"}
_FRAME_REF = {"$ref": "#/components/schemas/FrameInput"}
_BODIES: dict[str, Json] = {
    "post_frame": {"application/json": {"schema": _FRAME_REF}},
    "post_frames": {
        "application/json": {"schema": {"type": "array", "items": _FRAME_REF}},
        "application/x-ndjson": {
            "schema": {"type": "string", "description": "one frame a line"},
            "example": "{...}\n{...}\n",
        },
    },
}


def describe(app: FastAPI) -> Json:
    """Return the description of the application, made once."""
    if app.openapi_schema is None:
        schema = get_openapi(
            title=app.title,
            version=app.version,
            summary=SUMMARY,
            description=DESCRIPTION,
            routes=app.routes,
            tags=[{"name": name, "description": text} for name, text in TAGS],
        )
        _complete(schema)
        app.openapi_schema = schema
    return app.openapi_schema


def operations(schema: Json) -> Iterator[tuple[str, str, Json]]:
    """Yield the path, the method and the description of every operation."""
    for path, item in schema["paths"].items():
        for method, operation in item.items():
            yield path, method, cast("Json", operation)


def _complete(schema: Json) -> None:
    components = schema.setdefault("components", {})
    components["securitySchemes"] = _SCHEMES
    schemas = components.setdefault("schemas", {})
    for model in (Problem, FrameInput):
        described = model.model_json_schema(ref_template="#/components/schemas/{model}")
        schemas |= described.pop("$defs", {})
        schemas[model.__name__] = described
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    for path, _, operation in operations(schema):
        name = operation["operationId"]
        secured = path.startswith("/api/") and name not in {"read_session", "close_session"}
        operation["security"] = _SECURITY if secured else []
        if name in _BODIES:
            operation["requestBody"] = {"required": True, "content": _copy(_BODIES[name])}
        _add_problems(operation, secured=secured, with_path="{" in path)
        _add_examples(operation, name)


def _add_problems(operation: Json, *, secured: bool, with_path: bool) -> None:
    responses = operation["responses"]
    takes_input = "422" in responses or "requestBody" in operation
    wanted = {
        "401": secured,
        "403": secured,
        "429": secured,
        "404": with_path,
        "422": takes_input,
        "503": secured,
    }
    for status, text in _REFUSALS.items():
        if wanted[status]:
            example = {"summary": text, "value": examples.PROBLEM if status == "422" else None}
            content: Json = {"schema": _PROBLEM_REF}
            if example["value"] is not None:
                content["examples"] = {"problem": example}
            responses[status] = {"description": text, "content": {MEDIA_TYPE: content}}
    responses["default"] = {
        "description": "any other problem",
        "content": {MEDIA_TYPE: {"schema": _PROBLEM_REF}},
    }


def _add_examples(operation: Json, name: str) -> None:
    if name in examples.REQUESTS:
        content = operation["requestBody"]["content"]
        first = next(iter(content.values()))
        first["examples"] = {text: {"value": value} for text, value in examples.REQUESTS[name].items()}
    if name in examples.RESPONSES or name in examples.OTHER_RESPONSES:
        kind, value = examples.OTHER_RESPONSES.get(name, ("application/json", examples.RESPONSES.get(name)))
        success = next(status for status in operation["responses"] if status.startswith("2"))
        content = operation["responses"][success].setdefault("content", {})
        content.setdefault(kind, {})["examples"] = {"example": {"value": value}}


def _copy(body: Json) -> Json:
    return {kind: dict(content) for kind, content in body.items()}
