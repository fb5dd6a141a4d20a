from __future__ import annotations

import gzip

import anyio
import pytest
from hypothesis import given
from hypothesis import strategies as st
from starlette.requests import Request

from service.api.bodies import is_ndjson, read_body
from service.api.problems import HttpProblem

LIMIT = 1000


def request(chunks, **headers):
    waiting = list(chunks)

    async def receive() -> dict[str, object]:
        return {"type": "http.request", "body": waiting.pop(0), "more_body": bool(waiting)}

    raw = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    return Request({"type": "http", "method": "POST", "path": "/", "headers": raw}, receive)


def read(chunks, **headers):
    return anyio.run(read_body, request(chunks, **headers), LIMIT)


def status_of(chunks, **headers):
    with pytest.raises(HttpProblem) as caught:
        read(chunks, **headers)
    return caught.value.kind.status


@given(st.binary(max_size=LIMIT), st.integers(1, 50))
def test_a_body_arrives_the_same_plain_and_compressed_in_any_pieces(body, size):
    packed = gzip.compress(body)
    pieces = [packed[i : i + size] for i in range(0, len(packed), size)]

    assert read([body]) == body
    assert read(pieces, content_encoding="gzip") == body


def test_several_gzip_members_are_one_body():
    assert read([gzip.compress(b"one ") + gzip.compress(b"two")], content_encoding="gzip") == b"one two"


def test_too_large_a_body_is_refused_by_its_announcement_by_its_size_and_once_inflated():
    assert status_of([b""], content_length=str(LIMIT + 1)) == 413
    assert status_of([b"x" * LIMIT, b"x"]) == 413
    assert status_of([gzip.compress(b"x" * (LIMIT + 1))], content_encoding="gzip") == 413


def test_a_bomb_is_stopped_before_it_grows():
    bomb = gzip.compress(bytes(50_000_000), 9)[:LIMIT]

    assert status_of([bomb], content_encoding="gzip") == 413


def test_damaged_truncated_and_unknown_encodings_are_refused():
    packed = gzip.compress(b"0123456789" * 20)
    assert status_of([b"no gzip at all"], content_encoding="gzip") == 400
    assert status_of([packed[:-4]], content_encoding="gzip") == 400
    assert status_of([b""], content_encoding="br") == 415


@pytest.mark.parametrize(
    ("kind", "ndjson"),
    [
        ("", False),
        ("application/json; charset=utf-8", False),
        ("application/x-ndjson", True),
        ("Application/JSONL", True),
    ],
)
def test_the_media_type_tells_json_from_ndjson(kind, ndjson):
    assert is_ndjson(request([b""], content_type=kind)) is ndjson


def test_another_media_type_is_refused():
    with pytest.raises(HttpProblem, match="text/plain"):
        is_ndjson(request([b""], content_type="text/plain"))
