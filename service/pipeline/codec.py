"""Turn a record of the log into bytes and back; each carries a checksum, so that damage is told from data."""

from __future__ import annotations

import struct
import zlib
from enum import IntEnum

from service.errors import StorageError, WaysideError
from service.formats.columnar import decode_frame, encode_frame
from service.pipeline.records import ControlRecord, DamagedRecord, FrameRecord, Record, TickRecord
from service.tracking.model import Frame

_HEAD = struct.Struct("<IBq")  # checksum of all that follows, kind, time (received_us, or a tick's time_us)
_CHECKSUM = struct.Struct("<I")


class _Kind(IntEnum):
    FRAME = 1
    CONTROL = 2
    TICK = 3


def encode_record(record: Record) -> bytes:
    """Return the record as bytes; raises InvalidFrame where a frame's ids or numbers do not fit."""
    match record:
        case FrameRecord():
            kind, time_us = _Kind.FRAME, record.received_us
            body = encode_frame(record.frame) if record.encoded is None else record.encoded
        case ControlRecord():
            kind, time_us, body = _Kind.CONTROL, record.received_us, record.config.encode()
        case TickRecord():
            kind, time_us, body = _Kind.TICK, record.time_us, b""
        case DamagedRecord():
            raise StorageError(f"a damaged record is not written: {record.reason}")
    data = _HEAD.pack(0, kind, time_us) + body
    return _CHECKSUM.pack(zlib.crc32(data[_CHECKSUM.size :])) + data[_CHECKSUM.size :]


def logged_bytes(frame: Frame) -> int:
    """Return what a frame takes in the log, but for the lengths of its ids."""
    return 64 + 16 * len(frame)


def record_time_us(data: bytes) -> int:
    """Return the time in a record's head: when it was received, or the time of a tick."""
    _, _, time_us = _HEAD.unpack_from(data)
    return int(time_us)


def decode_record(data: bytes) -> Record:
    """Return the record that `encode_record` wrote; raises StorageError when the bytes are damaged."""
    if len(data) < _HEAD.size:
        raise StorageError(f"a record has at least {_HEAD.size} bytes, got {len(data)}")
    checksum, kind, time_us = _HEAD.unpack_from(data)
    rest = memoryview(data)[_CHECKSUM.size :]
    if zlib.crc32(rest) != checksum:
        raise StorageError("a record of the log is damaged: its checksum does not match")
    body = memoryview(data)[_HEAD.size :]
    try:
        match kind:
            case _Kind.FRAME:
                return FrameRecord(frame=decode_frame(body), received_us=time_us)
            case _Kind.CONTROL:
                return ControlRecord(config=bytes(body).decode(), received_us=time_us)
            case _Kind.TICK:
                return TickRecord(time_us=time_us)
    except (WaysideError, UnicodeDecodeError) as error:
        raise StorageError(f"a record of the log cannot be read: {error}") from error
    raise StorageError(f"a record of the log has the unknown kind {kind}; was it written by a newer version?")
