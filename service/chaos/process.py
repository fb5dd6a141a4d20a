"""Run a piece of work in a process of its own that may be killed, and hear what it said before."""

from __future__ import annotations

import faulthandler
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn

import orjson

Say = Callable[[object], None]
FAILED = 70
PATIENCE_S = 120.0  # longest life of a process before it counts as hung


@dataclass(frozen=True, slots=True)
class Ended:
    """What is left of a process."""

    said: list[dict[str, object]]
    signal: int | None  # that ended it
    code: int  # else its exit code

    @property
    def killed(self) -> bool:
        """Whether SIGKILL ended it."""
        return self.signal == signal.SIGKILL


@dataclass(frozen=True, slots=True)
class Running:
    """A process at work."""

    pid: int
    ear: int  # file descriptor

    def listen(self, until: Callable[[dict[str, object]], bool] | None = None) -> list[dict[str, object]]:
        """Return what the process says, up to its end or the message that `until` waits for."""
        said: list[dict[str, object]] = []
        line = b""
        while chunk := os.read(self.ear, 1 if until is not None else 65_536):
            line += chunk
            *lines, line = line.split(b"\n")
            said += [orjson.loads(item) for item in lines]
            if until is not None and lines and until(said[-1]):
                break
        return said

    def send(self, number: int) -> None:
        """Send a signal."""
        os.kill(self.pid, number)

    def end(self) -> Ended:
        """Hear the process out, wait for its end, and return what it said since it was last listened to."""
        watchdog = threading.Timer(PATIENCE_S, self.send, (signal.SIGABRT,))
        watchdog.start()
        try:
            said = self.listen()
            _, status = os.waitpid(self.pid, 0)
        finally:
            watchdog.cancel()
            watchdog.join()
            os.close(self.ear)
        by_signal = os.WTERMSIG(status) if os.WIFSIGNALED(status) else None
        return Ended(said, by_signal, 0 if by_signal is not None else os.WEXITSTATUS(status))


def start(work: Callable[[Say], None]) -> Running:
    """Fork: the child does the work and ends. What is imported and compiled here needs not be there again.

    To be called while this process has one thread only.
    """
    ear, mouth = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid == 0:
        os.close(ear)
        _work(work, mouth)
    os.close(mouth)
    return Running(pid, ear)


def _work(work: Callable[[Say], None], mouth: int) -> NoReturn:
    def say(message: object) -> None:
        os.write(mouth, orjson.dumps(message) + b"\n")  # below PIPE_BUF, so whole or not at all

    code = FAILED
    faulthandler.enable()  # a process that hangs is aborted, and then tells where
    try:
        work(say)
        code = 0
    except BaseException:  # noqa: BLE001 - the edge of a process
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)  # no clean-up of what the parent owns
