"""Read JSON files and lines of JSON, gzip or not; an error names file and line."""

from __future__ import annotations

import gzip
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar, cast

import orjson

from service.errors import InvalidInput
from service.formats.rfc3339 import parse_time_us

Record = dict[str, object]
T = TypeVar("T")


def read_text(path: Path) -> str:
    """Return the whole text of a file, unpacked when its name ends in .gz; raises InvalidInput."""
    try:
        raw = path.read_bytes()
        return (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode()
    except (OSError, EOFError, UnicodeDecodeError) as error:
        raise InvalidInput(f"{path}: cannot be read: {error}") from None


def read_record(path: Path) -> Record:
    """Return the one JSON object that a file holds; raises InvalidInput."""
    return _record(read_text(path), f"{path}")


def read_records(path: Path) -> Iterator[tuple[int, Record]]:
    """Yield line number (from 1) and object of each line that is not empty; raises InvalidInput."""
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        if line.strip():
            yield number, _record(line, f"{path}, line {number}")


def read_each(path: Path, parse: Callable[[Record], T]) -> list[T]:
    """Return parse(record) of each line; a missing or wrong field becomes InvalidInput with file and line."""
    out: list[T] = []
    for number, record in read_records(path):
        try:
            out.append(parse(record))
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidInput(f"{path}, line {number}: {describe(error)}") from None
    return out


def describe(error: Exception) -> str:
    """Say in words what a failed field access was about."""
    return f"{error} is missing" if isinstance(error, KeyError) else str(error)


def number(record: Record, *names: str) -> float:
    """Return the first of the named fields that is there as a float; raises KeyError or TypeError."""
    for name in names:
        if name in record:
            value = record[name]
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise TypeError(f"{name!r} is {value!r}, want a number")
            return float(value)
    raise KeyError(names[0])


def text(record: Record, name: str) -> str:
    """Return a field as text; raises KeyError or TypeError."""
    value = record[name]
    if not isinstance(value, str):
        raise TypeError(f"{name!r} is {value!r}, want text")
    return value


def items(record: Record, name: str) -> list[Record]:
    """Return a field that is a list of objects; raises KeyError or TypeError."""
    value = record[name]
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        raise TypeError(f"{name!r} is not a list of objects")
    return cast("list[Record]", value)


def points(record: Record, name: str) -> list[tuple[float, float]]:
    """Return a field that is a list of [x, y]; raises KeyError, TypeError or ValueError."""
    value = record[name]
    if not isinstance(value, list):
        raise TypeError(f"{name!r} is not a list of points")
    return [(float(x), float(y)) for x, y in value]


def time_us(record: Record, name: str = "timestamp") -> int:
    """Return a time field as microseconds since 1970; raises KeyError, TypeError or ValueError."""
    return parse_time_us(text(record, name))


def _record(line: str, where: str) -> Record:
    try:
        value = orjson.loads(line)
    except orjson.JSONDecodeError as error:
        raise InvalidInput(f"{where}: not JSON: {error}") from None
    if not isinstance(value, dict):
        raise InvalidInput(f"{where}: not a JSON object")
    return value
