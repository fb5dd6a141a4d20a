"""The one tree of errors that Wayside raises on purpose.

WaysideError
├── InvalidInput          a caller's value is wrong; names the field and the reason
│   └── InvalidFrame      ... inside a frame of detections
├── NotFound              no such site, sensor, track or key
├── Conflict              the same key with another content, or a thing that exists already
├── NotAllowed            missing or insufficient key
├── Unavailable           try again later (full log, full disk, not ready); carries retry_after_s
├── SnapshotUnreadable    a stored state cannot be restored
└── StorageError          the database or the log is not usable (newer schema, second process, ...)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self


@dataclass(frozen=True, slots=True)
class FieldError:
    """One wrong value: where it stands (a JSON Pointer, RFC 6901) and what is wrong with it."""

    pointer: str
    reason: str


class WaysideError(Exception):
    """Base of every error that is raised on purpose."""


class InvalidInput(WaysideError):  # noqa: N818 - reads as a sentence where it is raised
    """A value from outside is wrong; `errors` names each field and the reason."""

    def __init__(self, message: str, errors: Sequence[FieldError] = ()) -> None:
        super().__init__(message)
        self.errors = tuple(errors)

    @classmethod
    def at(cls, pointer: str, reason: str) -> Self:
        """Return the error for one field."""
        return cls(f"{pointer or 'body'}: {reason}", (FieldError(pointer, reason),))


class InvalidFrame(InvalidInput):
    """A frame of detections is wrong."""


class NotFound(WaysideError):  # noqa: N818
    """The named thing does not exist."""


class Conflict(WaysideError):  # noqa: N818
    """The thing exists already, or exists with another content."""


class NotAllowed(WaysideError):  # noqa: N818
    """The caller has no key, or a key without the needed scope."""


class Unavailable(WaysideError):  # noqa: N818
    """The service cannot do this now; `retry_after_s` says when to try again."""

    def __init__(self, message: str, retry_after_s: float = 1.0) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s


class SnapshotUnreadable(WaysideError):  # noqa: N818
    """A stored tracker state cannot be restored: wrong version, truncated or damaged."""


class StorageError(WaysideError):
    """The database or the log cannot be used."""
