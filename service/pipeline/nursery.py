"""Start processes without imports and compiling: forks of one that stands by since before the service began.

A process with threads cannot be forked safely, and a new interpreter takes seconds to import the numerical
libraries and to load the kernels. So the service forks once, while it has one thread, and that process (the
nursery) forks again whenever one is wanted: some milliseconds, and the memory of the libraries is shared.
The nursery ends when the service does, however it does; what it forked sees to that itself.
"""

from __future__ import annotations

import gc
import json
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import NoReturn

import structlog

from service.errors import StorageError

_log = structlog.get_logger(__name__)

Work = Callable[[list[int], dict[str, object]], None]  # file descriptors and arguments

_REQUEST_BYTES = 65_536
_DESCRIPTORS = 4  # of one request, at most
_FIRST_OWN = 3  # file descriptors below it are the standard streams
FAILED = 70


class Nursery:
    """The process that forks, as its owner sees it."""

    def __init__(self, works: Mapping[str, Work]) -> None:
        """Fork; to be called while this process has one thread. `works` can be started by name later."""
        ours, theirs = socket.socketpair()
        self._guard = threading.Lock()
        self.pid = os.fork()
        if self.pid == 0:
            _keep_only([theirs.fileno()])
            _stand_by(theirs, works)
        theirs.close()
        self._line = ours

    def start(self, name: str, descriptors: Sequence[int], arguments: Mapping[str, object]) -> int:
        """Fork a process that does the work of that name, with these open files, and return its id.

        Raises StorageError when the nursery is gone.
        """
        request = json.dumps({"name": name, "arguments": arguments}).encode() + b"\n"
        try:
            with self._guard:
                socket.send_fds(self._line, [request], list(descriptors))
                reply = self._line.recv(64)
        except OSError as error:
            raise StorageError(f"the process that starts others is gone: {error}") from error
        if not reply:
            raise StorageError("the process that starts others is gone")
        return int(reply)

    def close(self) -> None:
        """Let the nursery end, and wait for it."""
        self._line.close()
        with suppress(ChildProcessError):
            os.waitpid(self.pid, 0)


def _stand_by(line: socket.socket, works: Mapping[str, Work]) -> NoReturn:
    """Fork at each request until the owner is gone."""
    # Signals are for the owner, who ends its helpers in order; a terminal sends them to all.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for them: their files tell when they end
    gc.collect()
    gc.freeze()  # so that the collector does not write into shared memory
    while True:
        try:
            data, descriptors, _, _ = socket.recv_fds(line, _REQUEST_BYTES, _DESCRIPTORS)
            while data and not data.endswith(b"\n"):
                data += line.recv(_REQUEST_BYTES)
        except OSError:
            data = b""
        if not data:
            os._exit(0)
        pid = os.fork()
        if pid == 0:
            line.close()
            _work(works, data, descriptors)
        for descriptor in descriptors:
            os.close(descriptor)
        with suppress(OSError):
            line.sendall(b"%d" % pid)


def _work(works: Mapping[str, Work], data: bytes, descriptors: list[int]) -> NoReturn:
    code = FAILED
    try:
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        request = json.loads(data)
        works[request["name"]](descriptors, request["arguments"])
        code = 0
    except BaseException:  # noqa: BLE001 - the edge of a process
        _log.exception("a helper process failed")
    finally:
        os._exit(code)


def _keep_only(descriptors: list[int]) -> None:
    """Close every file but the standard streams and these: locks and sockets belong to the owner."""
    kept = sorted(descriptors)
    first = _FIRST_OWN
    for descriptor in kept:
        os.closerange(first, descriptor)
        first = descriptor + 1
    os.closerange(first, os.sysconf("SC_OPEN_MAX"))
    # They may have been redirected to files that are closed now.
    sys.stdout, sys.stderr = (open(number, "w", closefd=False) for number in (1, 2))  # noqa: SIM115


def end_with(lifeline: int) -> None:
    """End this process at once when the other end of a pipe is closed: its owner is gone, however it went."""

    def watch() -> None:
        with suppress(OSError):
            while os.read(lifeline, 1):
                pass
        os._exit(FAILED)

    threading.Thread(target=watch, name="wayside-lifeline", daemon=True).start()
