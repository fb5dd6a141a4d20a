"""Turn a state (nested frozen dataclasses of arrays and plain values) into bytes, and back, exact to the bit.

The type hints drive both ways, so the bytes hold values only. Ahead of them stands a fingerprint of the
schema (names and types of every field, all the way down): a state of another build of the code is refused,
not misread. A digest over the values tells damage. The same state gives the same bytes.

Layout, little endian: magic, version, fingerprint, digest, then the values depth first.

    int q   float d   bool ?   str, bytes: length and bytes   enum: its value   X | None: a flag, then X
    tuple: length (when not fixed), items   array: order, dimensions, shape, items; its dtype is in the schema

Arrays keep their dtype, shape and memory order (C or Fortran), since the order of a sum may depend on it; a
strided view comes back contiguous, so states should hold contiguous arrays.
"""

from __future__ import annotations

import dataclasses
import hashlib
import struct
import types
import typing
from collections.abc import Callable
from enum import Enum
from functools import cache
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

from service.errors import SnapshotUnreadable

T = TypeVar("T")

VERSION = 1
_MAGIC = b"WSNP"
_HEADER = struct.Struct("<4sH16s16s")
_INT = struct.Struct("<q")
_FLOAT = struct.Struct("<d")
_BOOL = struct.Struct("<?")
_LENGTH = struct.Struct("<I")
_ARRAY = struct.Struct("<cB")  # order, dimensions
_DIGEST_BYTES = 16


def dump(state: object) -> bytes:
    """Return the dataclass `state` as bytes.

    Raises TypeError where a field's type has no codec or a value does not fit its hint: mistakes in the code.
    """
    codec = _codec(cast("Any", type(state)))
    parts: list[bytes] = []
    codec.write(state, parts)
    body = b"".join(parts)
    return _HEADER.pack(_MAGIC, VERSION, _fingerprint(codec), _digest(body)) + body


def load(kind: type[T], data: bytes) -> T:
    """Return the state of type `kind` that `dump` wrote; raises SnapshotUnreadable on anything else."""
    if len(data) < _HEADER.size:
        raise SnapshotUnreadable(f"a snapshot has at least {_HEADER.size} bytes, got {len(data)}")
    magic, version, fingerprint, digest = _HEADER.unpack_from(data)
    if magic != _MAGIC:
        raise SnapshotUnreadable("the bytes are no snapshot: wrong first bytes")
    if version != VERSION:
        raise SnapshotUnreadable(f"snapshot of version {version}, want {VERSION}")
    codec = _codec(cast("Any", kind))
    if fingerprint != _fingerprint(codec):
        raise SnapshotUnreadable(f"the snapshot was written by a build with another {kind.__name__}")
    body = memoryview(data)[_HEADER.size :]
    if _digest(body) != digest:
        raise SnapshotUnreadable("the snapshot is damaged: its digest does not match")
    value, end = codec.read(body, 0)
    if end != len(body):
        raise SnapshotUnreadable(f"{len(body) - end} bytes too many behind the snapshot")
    return cast("T", value)


class _Codec(NamedTuple):
    schema: str
    write: Callable[[Any, list[bytes]], None]
    read: Callable[[memoryview, int], tuple[Any, int]]


def _digest(body: bytes | memoryview) -> bytes:
    return hashlib.blake2b(body, digest_size=_DIGEST_BYTES).digest()


def _fingerprint(codec: _Codec) -> bytes:
    return _digest(codec.schema.encode())


@cache
def _codec(hint: Any) -> _Codec:  # noqa: ANN401, PLR0911 - a hint has no narrower type; one line a kind
    """Return how values of one type hint are written and read."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hasattr(
        origin, "__value__"
    ):  # a type alias with parameters, as numpy's NDArray is from Python 3.12 on
        return _codec(origin.__value__[arguments])
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return _dataclass_codec(hint)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return _enum_codec(hint)
    if hint in _PLAIN:
        return _PLAIN[hint]
    if origin is np.ndarray:
        return _array_codec(np.dtype(typing.get_args(arguments[1])[0]))
    if origin is tuple:
        return _tuple_codec(arguments)
    if origin in {types.UnionType, typing.Union}:
        return _optional_codec(hint, arguments)
    if origin is typing.Literal and all(isinstance(choice, str) for choice in arguments):
        return _PLAIN[str]._replace(schema="|".join(map(repr, arguments)))
    raise TypeError(f"no snapshot codec for {hint!r}; want a dataclass, array, tuple or plain value")


def _number_codec(layout: struct.Struct, kind: type) -> _Codec:
    def write(value: Any, parts: list[bytes]) -> None:  # noqa: ANN401
        if kind is not float and isinstance(value, bool) != (kind is bool):
            raise TypeError(f"want {kind.__name__}, got {value!r}")
        try:
            parts.append(layout.pack(value))
        except struct.error as error:
            raise TypeError(f"want {kind.__name__}, got {value!r}: {error}") from error

    def read(body: memoryview, at: int) -> tuple[Any, int]:
        return layout.unpack_from(body, at)[0], at + layout.size

    return _Codec(kind.__name__, write, read)


def _bytes_codec(kind: type, encode: Callable[[Any], bytes], decode: Callable[[bytes], Any]) -> _Codec:
    def write(value: Any, parts: list[bytes]) -> None:  # noqa: ANN401
        if not isinstance(value, kind):
            raise TypeError(f"want {kind.__name__}, got {value!r}")
        data = encode(value)
        parts.extend((_LENGTH.pack(len(data)), data))

    def read(body: memoryview, at: int) -> tuple[Any, int]:
        start = at + _LENGTH.size
        end = start + _LENGTH.unpack_from(body, at)[0]
        return decode(bytes(body[start:end])), end

    return _Codec(kind.__name__, write, read)


_PLAIN: dict[Any, _Codec] = {
    int: _number_codec(_INT, int),
    float: _number_codec(_FLOAT, float),
    bool: _number_codec(_BOOL, bool),
    str: _bytes_codec(str, str.encode, bytes.decode),
    bytes: _bytes_codec(bytes, bytes, bytes),
}


def _enum_codec(kind: type[Enum]) -> _Codec:
    values = _codec(cast("Any", type(next(iter(kind)).value)))
    members = ",".join(f"{member.name}={member.value!r}" for member in kind)

    def write(value: Any, parts: list[bytes]) -> None:  # noqa: ANN401
        values.write(kind(value).value, parts)

    def read(body: memoryview, at: int) -> tuple[Any, int]:
        value, at = values.read(body, at)
        return kind(value), at

    return _Codec(f"{kind.__name__}({members})", write, read)


def _optional_codec(hint: object, arguments: tuple[Any, ...]) -> _Codec:
    kinds = [argument for argument in arguments if argument is not type(None)]
    if len(kinds) != 1 or len(arguments) == 1:
        raise TypeError(f"no snapshot codec for {hint!r}; of the unions only X | None has one")
    inner = _codec(kinds[0])

    def write(value: Any, parts: list[bytes]) -> None:  # noqa: ANN401
        parts.append(_BOOL.pack(value is not None))
        if value is not None:
            inner.write(value, parts)

    def read(body: memoryview, at: int) -> tuple[Any, int]:
        present, at = _BOOL.unpack_from(body, at)[0], at + _BOOL.size
        return inner.read(body, at) if present else (None, at)

    return _Codec(f"{inner.schema}?", write, read)


def _tuple_codec(arguments: tuple[Any, ...]) -> _Codec:
    if arguments[1:] == (Ellipsis,):
        return _sequence_codec(_codec(arguments[0]))
    items = [_codec(argument) for argument in arguments]

    def write(value: Any, parts: list[bytes]) -> None:  # noqa: ANN401
        for item, part in zip(items, value, strict=True):
            item.write(part, parts)

    def read(body: memoryview, at: int) -> tuple[Any, int]:
        values = []
        for item in items:
            value, at = item.read(body, at)
            values.append(value)
        return tuple(values), at

    return _Codec(f"({','.join(item.schema for item in items)})", write, read)


def _sequence_codec(item: _Codec) -> _Codec:
    def write(value: Any, parts: list[bytes]) -> None:  # noqa: ANN401
        parts.append(_LENGTH.pack(len(value)))
        for part in value:
            item.write(part, parts)

    def read(body: memoryview, at: int) -> tuple[Any, int]:
        count, at = _LENGTH.unpack_from(body, at)[0], at + _LENGTH.size
        values = []
        for _ in range(count):
            value, at = item.read(body, at)
            values.append(value)
        return tuple(values), at

    return _Codec(f"[{item.schema}]", write, read)


def _array_codec(dtype: np.dtype[Any]) -> _Codec:
    if dtype.hasobject or dtype.names:
        raise TypeError(f"no snapshot codec for arrays of {dtype}; want numbers")
    stored = dtype.newbyteorder("<")

    def write(value: Any, parts: list[bytes]) -> None:  # noqa: ANN401
        if not isinstance(value, np.ndarray) or value.dtype != dtype:
            got = value.dtype if isinstance(value, np.ndarray) else type(value).__name__
            raise TypeError(f"want an array of {dtype}, got {got}")
        fortran = value.flags.f_contiguous and not value.flags.c_contiguous
        parts.append(_ARRAY.pack(b"F" if fortran else b"C", value.ndim))
        parts.extend(_LENGTH.pack(length) for length in value.shape)
        parts.append(value.astype(stored, copy=False).tobytes("F" if fortran else "C"))

    def read(body: memoryview, at: int) -> tuple[Any, int]:
        order, dimensions = _ARRAY.unpack_from(body, at)
        shape = struct.unpack_from(f"<{dimensions}I", body, at + _ARRAY.size)
        start = at + _ARRAY.size + dimensions * _LENGTH.size
        count = int(np.prod(shape, dtype=np.int64))
        flat = np.frombuffer(body, stored, count=count, offset=start)
        # A copy of its own: aligned and writable, as the array that was dumped.
        array = flat.reshape(shape, order=order.decode()).astype(dtype, order="K", copy=True)
        return array, start + count * stored.itemsize

    return _Codec(f"array<{stored.str}>", write, read)


def _dataclass_codec(kind: type) -> _Codec:
    hints = typing.get_type_hints(kind)
    names = [item.name for item in dataclasses.fields(kind)]
    codecs = [_codec(hints[name]) for name in names]
    schema = ",".join(f"{name}:{codec.schema}" for name, codec in zip(names, codecs, strict=True))

    def write(value: Any, parts: list[bytes]) -> None:  # noqa: ANN401
        if type(value) is not kind:
            raise TypeError(f"want {kind.__name__}, got {type(value).__name__}")
        for name, codec in zip(names, codecs, strict=True):
            try:
                codec.write(getattr(value, name), parts)
            except TypeError as error:
                raise TypeError(f"{kind.__name__}.{name}: {error}") from error

    def read(body: memoryview, at: int) -> tuple[Any, int]:
        values = {}
        for name, codec in zip(names, codecs, strict=True):
            values[name], at = codec.read(body, at)
        return kind(**values), at

    return _Codec(f"{kind.__name__}{{{schema}}}", write, read)
