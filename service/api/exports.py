"""Stream long exports from processes of their own, so that none holds the interpreter that answers requests.

A thread that renders a million states takes the interpreter for a millisecond at each of the event loop's
turns: replies to posts took 265 ms. A process forked for the export writes its pieces into a pipe instead,
with less right to the processor than everybody else; what remains here is passing them on.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial

import structlog
from anyio import to_thread
from fastapi.responses import StreamingResponse
from sqlalchemy import Engine
from starlette.concurrency import iterate_in_threadpool

from service.errors import StorageError
from service.pipeline.nursery import Nursery, Work
from service.storage.database import open_database

WORK = "export"
PIECE_BYTES = 49_152  # below what a pipe holds
PROCESSES = 8  # at once; further exports are made in threads of the serving process
NICENESS = 10

_LENGTH_BYTES = 4  # in front of each piece; a length of 0 ends the export
_READ_BYTES = 262_144

Pieces = Callable[..., Iterator[bytes]]  # (engine, **arguments), which can be written as JSON
_log = structlog.get_logger(__name__)
_pieces: dict[str, Pieces] = {}


def exported(name: str) -> Callable[[Pieces], Pieces]:
    """Make a function known as the export of a name."""

    def note(pieces: Pieces) -> Pieces:
        _pieces[name] = pieces
        return pieces

    return note


def work_of(url: str) -> Work:
    """Return the work of an export process on a database, for a nursery; its file is the pipe."""
    return partial(_work, url)


def joined(pieces: Iterator[bytes]) -> Iterator[bytes]:
    """Yield the same bytes in pieces of some size: each costs a turn of the event loop."""
    waiting: list[bytes] = []
    size = 0
    for piece in pieces:
        waiting.append(piece)
        size += len(piece)
        if size >= PIECE_BYTES:
            yield b"".join(waiting)
            waiting, size = [], 0
    if waiting:
        yield b"".join(waiting)


class Exports:
    """The exports of one serving process."""

    def __init__(self, engine: Engine, nursery: Nursery | None = None) -> None:
        """Without a nursery exports are made in threads."""
        self._engine = engine
        self._nursery = nursery
        self.running = 0  # processes

    def stream(self, name: str, arguments: Mapping[str, object], media_type: str) -> StreamingResponse:
        """Return the reply that streams an export."""
        return StreamingResponse(self._stream(name, arguments), media_type=media_type)

    async def _stream(self, name: str, arguments: Mapping[str, object]) -> AsyncIterator[bytes]:
        pipe = await self._begin(name, arguments)
        if pipe is None:
            async for piece in iterate_in_threadpool(joined(_pieces[name](self._engine, **arguments))):
                yield piece
            return
        self.running += 1
        try:
            async for piece in _read(pipe):
                yield piece
        finally:
            self.running -= 1

    async def _begin(self, name: str, arguments: Mapping[str, object]) -> int | None:
        """Start a process for an export, and return the file to read from; None: there is none to be had."""
        if self._nursery is None or self.running >= PROCESSES:
            return None
        reading, writing = os.pipe()
        try:
            request = {"name": name, "arguments": dict(arguments)}
            await to_thread.run_sync(self._nursery.start, WORK, [writing], request)
        except StorageError as error:
            _log.warning("an export goes on in a thread", reason=str(error))
            os.close(reading)
            return None
        finally:
            os.close(writing)
        return reading


async def _read(pipe: int) -> AsyncIterator[bytes]:
    """Yield the pieces of an export process; raises StorageError when it ends before its time."""
    reader = asyncio.StreamReader(limit=_READ_BYTES)
    transport, _ = await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader), os.fdopen(pipe, "rb", 0)
    )
    try:
        while length := int.from_bytes(await reader.readexactly(_LENGTH_BYTES), "little"):
            yield await reader.readexactly(length)
    except asyncio.IncompleteReadError:
        raise StorageError("an export ended before its time") from None
    finally:
        transport.close()


def _work(url: str, descriptors: list[int], request: dict[str, object]) -> None:
    """Be the process of one export; ends when nobody reads any more."""
    os.nice(NICENESS)
    arguments = request["arguments"]
    assert isinstance(arguments, dict)  # noqa: S101 - our own message
    pieces = _pieces[str(request["name"])](open_database(url), **arguments)
    with suppress(BrokenPipeError), os.fdopen(descriptors[0], "wb") as pipe:
        for piece in joined(pieces):
            pipe.write(len(piece).to_bytes(_LENGTH_BYTES, "little") + piece)
        pipe.write(bytes(_LENGTH_BYTES))
