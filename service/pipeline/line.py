"""Messages between the serving process and a tracker process: kind and length in front, over a Unix socket.

Nobody ever waits for the other side: what the socket does not take stays here, and the sender looks at
`clear` before it adds what a newer message will replace.
"""

from __future__ import annotations

import select
import socket
import struct
import threading
from collections.abc import Iterator
from enum import IntEnum

_HEAD = struct.Struct("<BI")
_RECEIVE_BYTES = 262_144
SOCKET_BYTES = 1_048_576  # of each direction, where the system grants it


class Kind(IntEnum):
    """What a message is."""

    # To the tracker:
    ADD = 1  # a sensor's configuration and the ends of its log
    LEAVE = 2  # let a sensor go
    NEWS = 3  # newest positions by sensor
    REFUSED = 4  # a tick that the log did not take
    STOP = 5  # fold what is logged while there is time, store it, end
    # From the tracker:
    READY = 16
    VIEW = 17  # the newest tracks of a sensor
    REPORT = 18  # where its sensors stand, and its metrics
    TICK = 19  # to be logged
    RELEASE = 20  # what the log may drop
    GONE = 21  # a sensor was let go
    DONE = 22  # everything is stored; the process ends


class LineClosed(Exception):  # noqa: N818 - reads as a sentence where it is caught
    """The other side is gone."""


class Line:
    """One end of the connection."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        self._socket.setblocking(False)
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            self._socket.setsockopt(socket.SOL_SOCKET, option, SOCKET_BYTES)
        self._guard = threading.Lock()  # over what is to be sent
        self._unsent = bytearray()
        self._received = bytearray()

    @property
    def clear(self) -> bool:
        """Whether all that was to be sent is on its way."""
        return not self._unsent

    def send(self, kind: Kind, body: bytes = b"") -> None:
        """Send a message now, or as much of it as the socket takes; from any thread. Never waits."""
        with self._guard:
            self._unsent += _HEAD.pack(kind, len(body)) + body
            self._push()

    def push(self) -> None:
        """Send what is left over."""
        if self._unsent:
            with self._guard:
                self._push()

    def _push(self) -> None:
        try:
            while self._unsent:
                del self._unsent[: self._socket.send(self._unsent)]
        except BlockingIOError:
            pass
        except OSError:
            self._unsent.clear()  # the receiving side tells that the line is closed

    def wait(self, timeout_s: float) -> None:
        """Wait until something has come, or what is left over can go on."""
        writing = [self._socket] if self._unsent else []
        select.select([self._socket], writing, [], timeout_s)

    def receive(self) -> Iterator[tuple[Kind, bytes]]:
        """Yield the messages that have come; raises LineClosed when there will be none any more."""
        closed = False
        try:
            while data := self._socket.recv(_RECEIVE_BYTES):
                self._received += data
                if len(data) < _RECEIVE_BYTES:
                    break
            else:
                closed = True
        except BlockingIOError:
            pass
        except OSError:
            closed = True
        at = 0
        while at + _HEAD.size <= len(self._received):
            kind, length = _HEAD.unpack_from(self._received, at)
            if at + _HEAD.size + length > len(self._received):
                break
            at += _HEAD.size
            yield Kind(kind), bytes(self._received[at : at + length])
            at += length
        del self._received[:at]
        if closed:
            raise LineClosed

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()
