"""Detections in: one frame, or a batch as a JSON array or NDJSON, compressed or not."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import orjson
from anyio import to_thread
from fastapi import APIRouter, Request, Response, status

from service.api.bodies import is_ndjson, read_body
from service.api.dependencies import PREFIX, SensorPath, admit
from service.api.problems import HttpProblem
from service.api.track_schemas import BatchReply, FrameReply
from service.errors import Conflict, FieldError, InvalidFrame, InvalidInput
from service.formats.json_frames import json_kind, parse_bytes, parse_frame
from service.formats.sensor import SensorConfig
from service.formats.strict_json import read_json
from service.pipeline.door import ItemResult, Outcome
from service.tracking.model import Frame

router = APIRouter(prefix=PREFIX)

INLINE_BYTES = 65_536  # a larger body is parsed in a thread: about 5 ms of the event loop's time
BATCH_FRAMES_MAX = 10_000
NAMED_FRAMES_MAX = (
    50  # rejected frames whose every fault is listed; of further ones only the first, in `detail`
)


@dataclass(frozen=True, slots=True)
class _Parsed:
    """The frames of a batch: good ones and what is wrong with the others, by index."""

    frames: dict[int, Frame]
    faults: dict[int, InvalidFrame]


@router.post(
    "/sensors/{sensor_id}/frames",
    tags=["frames"],
    status_code=status.HTTP_202_ACCEPTED,
    response_model=FrameReply,
    responses={
        200: {"model": FrameReply, "description": "duplicate"},
        409: {"description": "the same key with another content"},
    },
)
async def post_frame(sensor_id: SensorPath, request: Request) -> Response:
    """Take one frame; 202 means that it is durable."""
    services = await admit(request, "ingest", sensor_id)
    config = services.host.config(sensor_id)
    if is_ndjson(request):
        raise HttpProblem("unsupported-media-type", "NDJSON is for frames:batch; want application/json")
    with services.room.hold() as held:
        body = await read_body(request, services.room.limit_bytes, held)
        try:
            frame = await _in_time(body, config)
        except InvalidFrame:
            services.host.count_rejected(sensor_id, 1)
            raise
        result = (await services.host.submit(sensor_id, [frame]))[0]
    match result.outcome:
        case Outcome.CONFLICT:
            raise Conflict(result.reason or "the frame came before with another content")
        case Outcome.REJECTED:
            raise InvalidFrame.at(result.pointer, result.reason or "is not taken")
        case Outcome.DUPLICATE:
            code = status.HTTP_200_OK
        case _:
            code = status.HTTP_202_ACCEPTED
    reply = {"status": result.outcome, "frame": frame.sequence}
    return Response(orjson.dumps(reply), code, media_type="application/json")


@router.post(
    "/sensors/{sensor_id}/frames:batch",
    tags=["frames"],
    status_code=status.HTTP_202_ACCEPTED,
    response_model=BatchReply,
)
async def post_frames(sensor_id: SensorPath, request: Request) -> Response:
    """Take many frames; each is accepted or refused by itself, and the reply says which."""
    services = await admit(request, "ingest", sensor_id)
    config = services.host.config(sensor_id)
    ndjson = is_ndjson(request)
    with services.room.hold() as held:
        body = await read_body(request, services.room.limit_bytes, held)
        parsed = await to_thread.run_sync(_parse_batch, body, config, ndjson, limiter=services.batches)
        if parsed.faults:
            services.host.count_rejected(sensor_id, len(parsed.faults))
        frames = list(parsed.frames.values())
        outcomes = await services.host.submit(sensor_id, frames) if frames else []
    results: dict[int, dict[str, object]] = {
        index: _rejected(index, fault, named=count < NAMED_FRAMES_MAX)
        for count, (index, fault) in enumerate(parsed.faults.items())
    }
    for (index, frame), result in zip(parsed.frames.items(), outcomes, strict=True):
        results[index] = {
            "index": index,
            "status": result.outcome,
            "frame": frame.sequence,
            "detail": result.reason,
            "errors": [_refused(index, result)] if result.outcome is Outcome.REJECTED else [],
        }
    return Response(
        orjson.dumps(_batch_reply(results)), status.HTTP_202_ACCEPTED, media_type="application/json"
    )


async def _in_time(body: bytes, config: SensorConfig) -> Frame:
    if len(body) <= INLINE_BYTES:
        return parse_bytes(body, config)
    return await to_thread.run_sync(parse_bytes, body, config)


def _parse_batch(body: bytes, config: SensorConfig, ndjson: bool) -> _Parsed:  # noqa: FBT001 - run_sync has no keywords
    """Return the frames of a batch; raises InvalidFrame when the body as a whole is wrong."""
    parsed = _Parsed({}, {})
    booleans = b"true" in body or b"false" in body
    items: list[object] = list(_lines(body)) if ndjson else _array(body, parsed.faults)
    if len(items) > BATCH_FRAMES_MAX:
        raise InvalidFrame.at("", f"has {len(items)} frames, at most {BATCH_FRAMES_MAX} are taken at once")
    for index, item in enumerate(items):
        if index in parsed.faults:
            continue
        try:
            frame = (
                parse_bytes(item, config)
                if isinstance(item, bytes)
                else parse_frame(item, config, booleans=booleans)
            )
        except InvalidFrame as fault:
            parsed.faults[index] = fault
        else:
            parsed.frames[index] = frame
    return parsed


def _array(body: bytes, faults: dict[int, InvalidFrame]) -> list[object]:
    """Return the frames of a JSON array; adds those with a repeated member to `faults`."""
    try:
        value, repeated = read_json(body)
    except InvalidInput as error:
        raise InvalidFrame(str(error), error.errors) from None
    if not isinstance(value, list):
        raise InvalidFrame.at("", f"want an array of frames, got {json_kind(value)}")
    for fault in repeated:
        index, _, rest = fault.pointer[1:].partition("/")
        faults.setdefault(int(index), InvalidFrame.at(f"/{rest}", fault.reason))
    return value


def _lines(body: bytes) -> list[bytes]:
    return [line for line in body.split(b"\n") if line.strip()]


def _rejected(index: int, fault: InvalidFrame, *, named: bool) -> dict[str, object]:
    return {
        "index": index,
        "status": "rejected",
        "frame": None,
        "detail": str(fault),
        "errors": [_named(index, error) for error in fault.errors] if named else [],
    }


def _refused(index: int, result: ItemResult) -> dict[str, str]:
    return {"pointer": f"/{index}{result.pointer}", "detail": result.reason or "is not taken"}


def _named(index: int, error: FieldError) -> dict[str, str]:
    return {"pointer": f"/{index}{error.pointer}", "detail": error.reason}


def _batch_reply(results: dict[int, dict[str, object]]) -> dict[str, object]:
    counts = Counter(str(result["status"]) for result in results.values())
    named = {name: counts[name] for name in ("accepted", "duplicate", "late", "conflict", "rejected")}
    return {**named, "results": [results[index] for index in sorted(results)]}
