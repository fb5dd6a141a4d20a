"""Decide who a caller is and what they may do: API keys, dashboard sessions, and the open local mode.

While no key was ever made and the service listens on the loopback only, whoever reaches it may do everything;
with the first key, keys are needed. Key look-ups are remembered for a few seconds, so that frames do not wait
for the database; a key revoked through this process ends at once, one revoked elsewhere within that time.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import hmac
import ipaddress
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import structlog
from sqlalchemy import Engine

from service.api.problems import HttpProblem
from service.errors import NotAllowed, NotFound, Unavailable
from service.storage.audit import NOBODY
from service.storage.database import connection, session_scope
from service.storage.keys import ApiKey, Scope, find_key, list_keys, note_use, read_key

SESSION_COOKIE = "wayside_session"
SESSION_S = 12 * 3600  # a working day
REMEMBER_S = 5.0  # longest time for which a key revoked by another process still works here
NOTE_USE_EVERY_US = 60_000_000  # as storage.keys.note_use, which would ignore earlier calls
REMEMBERED_MAX = (
    1024  # look-ups kept; beyond it all are forgotten, so that guessed keys cannot fill the memory
)

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Caller:
    """Who sent a request: a key, or nobody in particular in the open local mode."""

    key: ApiKey | None
    by_cookie: bool = False

    @property
    def name(self) -> str:
        """How the audit log calls the caller: the id of the key."""
        return NOBODY if self.key is None else self.key.key_id

    @property
    def scopes(self) -> frozenset[Scope]:
        """What the caller may do; `admin` includes the others."""
        if self.key is None or "admin" in self.key.scopes:
            return frozenset({"ingest", "read", "admin"})
        return self.key.scopes

    def require(self, scope: Scope, sensor_id: str | None = None) -> None:
        """Raise NotAllowed unless the caller has the scope, for this sensor where one is given."""
        if scope not in self.scopes:
            raise NotAllowed(f"this needs a key with the scope {scope}")
        bound = self.key.sensor_ids if self.key is not None else None
        if scope == "ingest" and sensor_id is not None and bound is not None and sensor_id not in bound:
            raise NotAllowed(f"this key may not send frames for the sensor {sensor_id}")


@dataclass(frozen=True, slots=True)
class _Session:
    """A dashboard session: whose it is, and since when."""

    key_id: str
    opened_us: int

    def suits(self, key: ApiKey) -> bool:
        """Return whether the key still has the secret with which the session was opened."""
        return key.rotated_us is None or self.opened_us >= key.rotated_us


@dataclass(frozen=True, slots=True)
class _Remembered:
    value: ApiKey | None
    until_s: float


@dataclass(slots=True)
class Keyring:
    """Looks keys up, remembers them for a while, and signs dashboard sessions."""

    engine: Engine
    local: bool  # bound to the loopback only
    now_us: Callable[[], int] = lambda: time.time_ns() // 1000
    monotonic_s: Callable[[], float] = time.monotonic
    _signing_key: bytes = field(default_factory=lambda: secrets.token_bytes(32))
    _remembered: dict[bytes, _Remembered] = field(default_factory=dict)
    _keys_exist: bool = False  # never goes back: a revoked key still counts
    _keys_checked_s: float = float("-inf")
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def recall(self, secret: str | None, session: str | None) -> Caller | None:
        """Return the caller if memory alone can tell, without touching the database."""
        if secret is not None:
            key = self._recalled(_digest(secret))
            return None if key is None else Caller(key)
        if session is not None and (opened := self._opened(session)) is not None:
            key = self._recalled(opened.key_id.encode())
            return None if key is None or not opened.suits(key) else Caller(key, by_cookie=True)
        if self._is_open_by_memory():
            return Caller(None)
        return None

    def identify(self, secret: str | None, session: str | None) -> Caller:
        """Return the caller; reads the database. Raises HttpProblem 401."""
        if secret is not None:
            key = self._look_up(_digest(secret), lambda: self._find(secret))
            if key is None:
                raise _unauthenticated("the API key is not valid")
            return Caller(key)
        if session is not None and (opened := self._opened(session)) is not None:
            key = self._look_up(opened.key_id.encode(), lambda: self._read(opened.key_id))
            if key is not None and opened.suits(key):
                return Caller(key, by_cookie=True)
        if self.is_open():
            return Caller(None)
        raise _unauthenticated("an API key is needed")

    def is_open(self) -> bool:
        """Return whether no key is needed: none was ever made, and only this machine can reach us."""
        if not self.local or self._keys_exist:
            return False
        if not self._is_open_by_memory():
            with connection(self.engine) as reader:
                self._keys_exist = bool(list_keys(reader, include_revoked=True, limit=1).items)
            self._keys_checked_s = self.monotonic_s()
        return not self._keys_exist

    def forget(self) -> None:
        """Forget every look-up; to be called after a key was made or revoked."""
        with self._lock:
            self._remembered.clear()
            self._keys_checked_s = float("-inf")

    def open_session(self, key: ApiKey) -> str:
        """Return the signed value of a session cookie for this key."""
        payload = f"{key.key_id}.{self.now_us()}".encode()
        return f"{_text(payload)}.{_text(self._sign(payload))}"

    def _opened(self, session: str) -> _Session | None:
        """Return what a session cookie says that we signed and that has not expired."""
        payload_text, _, signature_text = session.partition(".")
        try:
            payload, signature = _bytes(payload_text), _bytes(signature_text)
        except (binascii.Error, ValueError):
            return None
        if not hmac.compare_digest(signature, self._sign(payload)):
            return None
        key_id, _, opened_us = payload.decode().partition(".")
        opened = _Session(key_id, int(opened_us))
        return opened if self.now_us() < opened.opened_us + SESSION_S * 1_000_000 else None

    def _sign(self, payload: bytes) -> bytes:
        return hmac.digest(self._signing_key, payload, "sha256")

    def _is_open_by_memory(self) -> bool:
        fresh = self.monotonic_s() - self._keys_checked_s < REMEMBER_S
        return self.local and not self._keys_exist and fresh

    def _recalled(self, name: bytes) -> ApiKey | None:
        entry = self._remembered.get(name)
        return entry.value if entry is not None and self.monotonic_s() < entry.until_s else None

    def _look_up(self, name: bytes, read: Callable[[], ApiKey | None]) -> ApiKey | None:
        entry = self._remembered.get(name)
        if entry is not None and self.monotonic_s() < entry.until_s:
            return entry.value
        key = read()
        if key is not None:
            self._note_use(key)
        with self._lock:
            if len(self._remembered) >= REMEMBERED_MAX:
                self._remembered.clear()
            self._remembered[name] = _Remembered(key, self.monotonic_s() + REMEMBER_S)
        return key

    def _find(self, secret: str) -> ApiKey | None:
        with connection(self.engine) as reader:
            return find_key(reader, secret)

    def _read(self, key_id: str) -> ApiKey | None:
        try:
            with connection(self.engine) as reader:
                key = read_key(reader, key_id)
        except NotFound:
            return None
        return key if key.revoked_us is None else None

    def _note_use(self, key: ApiKey) -> None:
        now_us = self.now_us()
        if key.last_used_us is not None and now_us - key.last_used_us < NOTE_USE_EVERY_US:
            return
        try:
            with session_scope(self.engine) as writer:
                note_use(writer, key.key_id, now_us=now_us)
        except Unavailable as error:  # the note is a courtesy; the request must not fail for it
            _log.warning("use of a key not noted", key_id=key.key_id, reason=str(error))


def is_loopback(host: str) -> bool:
    """Return whether a host name or address is this machine's own."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def host_name(header: str) -> str:
    """Return the name in a Host header or an origin's authority, without the port, in lower case."""
    name, _, port = header.strip().lower().rpartition(":")
    return name if name and port.isdigit() else header.strip().lower()


def _unauthenticated(detail: str) -> HttpProblem:
    return HttpProblem("unauthenticated", detail, {"WWW-Authenticate": 'Bearer realm="wayside"'})


def _digest(secret: str) -> bytes:
    return hashlib.sha256(secret.encode("utf-8", "surrogateescape")).digest()


def _text(data: bytes) -> str:
    return base64.urlsafe_b64encode(data).decode().rstrip("=")


def _bytes(text: str) -> bytes:
    return base64.b64decode(text.encode() + b"=" * (-len(text) % 4), altchars=b"-_", validate=True)
