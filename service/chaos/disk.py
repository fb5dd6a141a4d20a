"""A layer below SQLite, for this process only: it counts what is written, and can lose it or refuse it.

SQLite reaches the disk through a table of functions (its VFS, https://sqlite.org/vfs.html). `Disk.install`
registers a copy of that table whose writes and syncs pass through here. What was written to a file since its
last sync is remembered with the bytes that stood there before, so that `lose` can put the files into a state
in which a power cut may leave them: an acknowledgement given before the sync is caught as a lie. The syncs
themselves are not passed on: this model of the disk is what counts, and a real one takes milliseconds each.
"""

from __future__ import annotations

import ctypes
import os
import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.errors import StorageError

_INSTALLED: list[Disk] = []  # SQLite calls them as long as the process lives

SQLITE_OK, SQLITE_FULL = 0, 13

_Pointer = ctypes.c_void_p
_OPEN = (ctypes.c_int, _Pointer, _Pointer, _Pointer, ctypes.c_int, _Pointer)
_WRITE = (ctypes.c_int, _Pointer, _Pointer, ctypes.c_int, ctypes.c_int64)
_TRUNCATE = (ctypes.c_int, _Pointer, ctypes.c_int64)
_SYNC = (ctypes.c_int, _Pointer, ctypes.c_int)
_DELETE = (ctypes.c_int, _Pointer, ctypes.c_char_p, ctypes.c_int)


class _Vfs(ctypes.Structure):
    _fields_ = (
        ("version", ctypes.c_int),
        ("file_bytes", ctypes.c_int),
        ("path_most", ctypes.c_int),
        ("next", _Pointer),
        ("name", ctypes.c_char_p),
        ("data", _Pointer),
        ("open", _Pointer),
        ("delete", _Pointer),
        ("others", _Pointer * 14),
    )


class _Methods(ctypes.Structure):
    _fields_ = (
        ("version", ctypes.c_int),
        ("close", _Pointer),
        ("read", _Pointer),
        ("write", _Pointer),
        ("truncate", _Pointer),
        ("sync", _Pointer),
        ("others", _Pointer * 13),
    )


class _File(ctypes.Structure):
    _fields_ = (("methods", ctypes.POINTER(_Methods)),)


@dataclass(frozen=True, slots=True)
class Before:
    """What stood in a file where something was written or cut off."""

    offset: int
    content: bytes
    size: int  # of the whole file


@dataclass(frozen=True, slots=True)
class Operation:
    """One write, truncation or sync that is about to happen."""

    path: str
    kind: str


class Disk:
    """The files of SQLite in this process; `before` hears of every operation and may refuse it."""

    def __init__(self, before: Callable[[Operation], bool]) -> None:
        """`before` returns whether there is room for the operation; from any thread, one at a time."""
        self._before = before
        self.syncs = 0
        self._paths: dict[int, str] = {}  # address of SQLite's file -> its path
        self._unsynced: dict[str, list[Before]] = {}
        self._descriptors: dict[str, int] = {}  # never closed: closing one would drop SQLite's locks
        self._tables: dict[int, _Methods] = {}  # address of the original table -> ours
        self._kept: list[object] = []  # what C points at

    def enter_fork(self) -> None:
        """Forget the files of the process that this one was forked from."""
        self._paths.clear()
        self._unsynced.clear()
        self._descriptors.clear()

    # ------------------------------------------------------------- losing

    def lose(self, rng: random.Random | None) -> None:
        """Take back what was not synced: all of it, or with `rng` each write by a coin."""
        for path, undone in self._unsynced.items():
            descriptor = self._descriptor(path)
            for item in reversed(undone):
                if rng is not None and rng.random() < 0.5:  # noqa: PLR2004 - a fair coin
                    continue
                os.pwrite(descriptor, item.content, item.offset)
                if rng is None:
                    os.ftruncate(descriptor, item.size)

    def _descriptor(self, path: str) -> int:
        if path not in self._descriptors:
            self._descriptors[path] = os.open(path, os.O_RDWR)
        return self._descriptors[path]

    def _remember(self, path: str, offset: int, count: int) -> None:
        descriptor = self._descriptor(path)
        size = os.fstat(descriptor).st_size
        content = os.pread(descriptor, count, offset).ljust(count, b"\0")  # what a lost write may leave
        self._unsynced.setdefault(path, []).append(Before(offset, content, size))

    # ------------------------------------------------------------- SQLite's functions

    def install(self) -> None:
        """Become the way to the disk of every connection that is opened from now on.

        Raises StorageError where this Python's SQLite is not a library of its own.
        """
        _INSTALLED.append(self)
        library = _sqlite_library()
        library.sqlite3_vfs_find.restype = ctypes.POINTER(_Vfs)
        original = library.sqlite3_vfs_find(None)
        ours = _Vfs.from_buffer_copy(original.contents)
        ours.name = b"wayside-chaos"
        # PYFUNCTYPE keeps the interpreter locked during the call: no other thread gets in between.
        call_open = ctypes.PYFUNCTYPE(*_OPEN)(ours.open)
        call_delete = ctypes.PYFUNCTYPE(*_DELETE)(ours.delete)

        def opened(_: int, name: int | None, file: int, flags: int, out: int | None) -> int:
            result: int = call_open(ctypes.addressof(original.contents), name, file, flags, out)
            if result == SQLITE_OK:
                path = None if name is None else ctypes.string_at(name).decode()
                self._adopt(file, path)
            return result

        def deleted(_: int, name: bytes, flags: int) -> int:
            path = name.decode()
            self._unsynced.pop(path, None)
            self._descriptors.pop(path, None)
            result: int = call_delete(ctypes.addressof(original.contents), name, flags)
            return result

        ours.open = self._keep(ctypes.CFUNCTYPE(*_OPEN)(opened))
        ours.delete = self._keep(ctypes.CFUNCTYPE(*_DELETE)(deleted))
        self._kept += [ours, library]
        library.sqlite3_vfs_register(ctypes.byref(ours), 1)

    def _adopt(self, address: int, path: str | None) -> None:
        """Let an opened file go through our functions."""
        if path is None:  # a temporary file: nothing of it is to last
            self._paths.pop(address, None)
            return
        self._paths[address] = path
        file = _File.from_address(address)
        original = ctypes.addressof(file.methods.contents)
        if original not in self._tables:
            self._tables[original] = self._table(file.methods.contents)
        file.methods = ctypes.pointer(self._tables[original])

    def _table(self, original: _Methods) -> _Methods:
        write = ctypes.PYFUNCTYPE(*_WRITE)(original.write)
        truncate = ctypes.PYFUNCTYPE(*_TRUNCATE)(original.truncate)
        sync = ctypes.PYFUNCTYPE(*_SYNC)(original.sync)

        def written(file: int, data: int, count: int, offset: int) -> int:
            path = self._paths.get(file)
            if path is not None:
                if not self._before(Operation(path, "write")):
                    return SQLITE_FULL
                self._remember(path, offset, count)
            result: int = write(file, data, count, offset)
            return result

        def truncated(file: int, size: int) -> int:
            path = self._paths.get(file)
            if path is not None:
                self._before(Operation(path, "truncate"))
                self._remember(path, size, max(0, Path(path).stat().st_size - size))
            result: int = truncate(file, size)
            return result

        def synced(file: int, flags: int) -> int:
            path = self._paths.get(file)
            if path is not None:
                self._before(Operation(path, "sync"))
                self.syncs += 1
                self._unsynced.pop(path, None)
                return SQLITE_OK
            result: int = sync(file, flags)
            return result

        table = _Methods.from_buffer_copy(original)
        table.write = self._keep(ctypes.CFUNCTYPE(*_WRITE)(written))
        table.truncate = self._keep(ctypes.CFUNCTYPE(*_TRUNCATE)(truncated))
        table.sync = self._keep(ctypes.CFUNCTYPE(*_SYNC)(synced))
        return table

    def _keep(self, function: Any) -> int:  # noqa: ANN401 - a pointer to a function has no type of its own
        """Return the address of a function that SQLite will call."""
        self._kept.append(function)
        return ctypes.cast(function, _Pointer).value or 0


def _sqlite_library() -> ctypes.PyDLL:
    """Return the library that Python's sqlite3 uses; another package may have loaded a SQLite of its own."""
    import _sqlite3  # noqa: PLC0415 - so that it is loaded

    library = ctypes.PyDLL(getattr(_sqlite3, "__file__", None))  # with what it is linked to
    if not hasattr(library, "sqlite3_vfs_register"):
        raise StorageError("this Python has SQLite built in: writes below it cannot be watched")
    return library


def available() -> bool:
    """Return whether the layer can be installed here."""
    try:
        _sqlite_library()
    except StorageError:
        return False
    return True
