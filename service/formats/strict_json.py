"""Read one JSON text and leave nothing to chance: no NaN, no deep nesting, no member that stands twice.

RFC 8259 leaves it to each reader which of two equal names counts; a frame that two readers understand
differently is no evidence, so it is refused.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from types import NoneType
from typing import cast

import orjson

from service.errors import FieldError, InvalidInput

DEPTH_MAX = 32  # levels of nesting; a frame has three, a batch four
REPEATS_MAX = 20  # repeated members that are named
NAME_MAX = 100  # characters of a member's name in a pointer

# A body of empty lists takes twenty times its size in memory; a row of the shortest numbers has 30 bytes.
_BYTES_PER_CONTAINER = 20
_CONTAINERS_FREE = 1000

_PLAIN: frozenset[type] = frozenset((float, int, bool, NoneType))


class _Object(dict[str, object]):
    """A JSON object that remembers which of its members stood there more than once."""

    repeated: tuple[str, ...] = ()


def read_json(body: bytes) -> tuple[object, tuple[FieldError, ...]]:
    """Return the value of one JSON text, and a fault for each member that stands there more than once.

    Raises InvalidInput when the text is no JSON (RFC 8259), nested too deeply or made of empty containers.
    """
    containers = body.count(b"[") + body.count(b"{")
    if containers > _CONTAINERS_FREE + len(body) // _BYTES_PER_CONTAINER:
        raise InvalidInput.at(
            "", f"has {containers} arrays and objects in {len(body)} bytes: nearly empty ones"
        )
    try:
        value: object = orjson.loads(body)
    except orjson.JSONDecodeError as error:
        raise InvalidInput.at("", f"is not JSON: {error}") from None
    # Each string of the text has two quotation marks; where one is escaped inside, a slower reader looks.
    marks = -1 if b"\\" in body else body.count(b'"')
    # A repeated member leaves fewer strings in the value than in the text. So where those that are found
    # without looking into arrays are as many as in the text, there is none, and none is in an array either.
    if containers <= DEPTH_MAX and marks == 2 * _strings_outside_arrays(value):
        return value, ()
    if marks == 2 * _strings(value, 1):
        return value, ()
    return value, _repeats(body)


def strict_json(body: bytes) -> object:
    """Return the value of one JSON text; raises InvalidInput also for repeated members."""
    value, repeated = read_json(body)
    if repeated:
        raise InvalidInput(f"{repeated[0].pointer}: {repeated[0].reason}", repeated)
    return value


def _strings_outside_arrays(value: object) -> int:
    """Return how many strings a value has outside its arrays, names of members too."""
    if not isinstance(value, dict):
        return isinstance(value, str)
    found = len(value)
    for member in value.values():
        if type(member) is str:
            found += 1
        elif type(member) is dict:
            found += _strings_outside_arrays(member)
    return found


def _strings(value: object, depth: int) -> int:
    """Return how many strings a value has, names of members too; raises InvalidInput when too deep."""
    if isinstance(value, str):
        return 1
    if not isinstance(value, dict | list):
        return 0
    if depth > DEPTH_MAX:
        raise InvalidInput.at("", f"is nested more than {DEPTH_MAX} levels deep")
    members: list[object] = value if isinstance(value, list) else list(value.values())
    names = 0 if isinstance(value, list) else len(value)
    if set(map(type, members)) <= _PLAIN:
        return names
    return names + sum(_strings(member, depth + 1) for member in members)


def _repeats(body: bytes) -> tuple[FieldError, ...]:
    tree = json.loads(body, object_pairs_hook=_object, parse_int=float)  # float: int refuses 5,000 digits
    found: list[FieldError] = []
    for pointer in _pointers(tree, ""):
        found.append(FieldError(pointer, "stands there more than once"))
        if len(found) == REPEATS_MAX:
            break
    return tuple(found)


def _object(pairs: list[tuple[str, object]]) -> _Object:
    made = _Object(pairs)
    if len(made) < len(pairs):
        counts = Counter(name for name, _ in pairs)
        made.repeated = tuple(name for name, count in counts.items() if count > 1)
    return made


def _pointers(value: object, at: str) -> Iterator[str]:
    """Yield the JSON Pointer (RFC 6901) of each repeated member."""
    if isinstance(value, list):
        for index, member in enumerate(cast("list[object]", value)):
            yield from _pointers(member, f"{at}/{index}")
    elif isinstance(value, _Object):
        for name in value.repeated:
            yield f"{at}/{escaped(name)}"
        for name, member in value.items():
            yield from _pointers(member, f"{at}/{escaped(name)}")


def escaped(name: str) -> str:
    """Return the name of a member as a JSON Pointer writes it; an absurdly long one is cut."""
    return name[:NAME_MAX].replace("~", "~0").replace("/", "~1")
