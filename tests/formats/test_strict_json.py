from __future__ import annotations

import json

import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.errors import InvalidInput
from service.formats.strict_json import read_json, strict_json

VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**53), 2**53)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=4),
    max_leaves=12,
)


@given(VALUES)
def test_a_clear_text_is_read_as_it_stands(value):
    for body in (orjson.dumps(value), json.dumps(value).encode()):  # the second escapes what is not ASCII
        found, repeated = read_json(body)

        assert found == orjson.loads(body)
        assert repeated == ()


@pytest.mark.parametrize(
    ("body", "pointers"),
    [
        (b'{"a": 1, "a": 1}', ["/a"]),
        (b'{"a": "x", "b": {"c": 1, "c": 2}}', ["/b/c"]),
        (b'[{"a": 1}, {"a": 1, "b": "\\"", "a": 2}]', ["/1/a"]),
        (b'{"a": 1, "\\u0061": 2}', ["/a"]),
        (b'{"a/b~": 1, "a/b~": [{"c": 1, "c": 1}]}', ["/a~1b~0", "/a~1b~0/0/c"]),
        (b'{"a": ["x"], "a": 1}', ["/a"]),
        (b'{"a": ["x", "y"], "b": "z", "b": 1}', ["/b"]),
        (b'{"b": {"c": "x"}, "a": [1], "b": {"c": ["x"]}}', ["/b"]),
        (b'{"a": 1e5, "x": 123456789012345678901234567890, "a": []}', ["/a"]),
    ],
)
def test_a_member_that_stands_twice_is_found(body, pointers):
    _, repeated = read_json(body)

    assert [fault.pointer for fault in repeated] == pointers
    with pytest.raises(InvalidInput, match="more than once"):
        strict_json(body)


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (b"[" * 40 + b"]" * 40, "more than 32 levels"),
        (b'{"a":' * 40 + b"1" + b"}" * 40, "more than 32 levels"),
        (b'{"a": [1, ' + b"[" * 40 + b"]" * 40 + b"]}", "more than 32 levels"),
        (b"[" + b"[]," * 100_000 + b"[]]", "nearly empty"),
        (b"[1e999]", "is not JSON"),
        (b"NaN", "is not JSON"),
        (b"9" * 5000, "is not JSON"),
        (b'"\\ud800"', "is not JSON"),
        (b"\xff", "is not JSON"),
        (b"", "is not JSON"),
        (b"{} {}", "is not JSON"),
    ],
)
def test_what_is_no_clear_json_is_refused_with_a_reason(body, reason):
    with pytest.raises(InvalidInput, match=reason):
        read_json(body)


def test_long_numbers_beside_a_repeated_member_do_not_stop_the_search():
    _, repeated = read_json(b'{"a": 0.' + b"1" * 6000 + b', "a": ' + b"1" * 300 + b"}")

    assert [fault.pointer for fault in repeated] == ["/a"]
