"""Turn a frame into the bytes that the log keeps, and back, exact to the bit.

Layout, little endian: a fixed header, the sensor id and boot id as UTF-8, then the four columns as
float32 one after the other. Not compressed: on recordings of 106 and 152 points a frame zlib saved 22 %
of the bytes and cost 0.2 ms a frame, ten times the rest of the encoding.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import replace

import numpy as np

from service.errors import InvalidFrame
from service.tracking.model import Frame

VERSION = 1
_HEADER = struct.Struct(
    "<BBBBqqI"
)  # version, flags, bytes of sensor id, of boot id, time_us, sequence, points
_HAS_SEQUENCE = 1
_HAS_BOOT = 2
_COLUMNS = ("range_m", "azimuth_rad", "radial_velocity_mps", "snr_db")
_F32 = np.dtype("<f4")
_BYTE_LIMIT = 255  # the lengths of the two ids are one byte each
_DIGEST_BYTES = 8


def encode_frame(frame: Frame) -> bytes:
    """Return the frame as bytes; raises InvalidFrame where an id or a number does not fit the layout."""
    sensor = frame.sensor_id.encode()
    boot = b"" if frame.boot_id is None else frame.boot_id.encode()
    for name, text in (("sensor_id", sensor), ("boot_id", boot)):
        if len(text) > _BYTE_LIMIT:
            raise InvalidFrame.at(f"/{name}", f"want at most {_BYTE_LIMIT} bytes of UTF-8, got {len(text)}")
    flags = (0 if frame.sequence is None else _HAS_SEQUENCE) | (0 if frame.boot_id is None else _HAS_BOOT)
    try:
        header = _HEADER.pack(
            VERSION, flags, len(sensor), len(boot), frame.time_us, frame.sequence or 0, len(frame)
        )
    except struct.error as error:
        raise InvalidFrame.at("/frame", f"want numbers of 64 bits, got {error}") from error
    return b"".join(
        (
            header,
            sensor,
            boot,
            *(getattr(frame, name).astype(_F32, copy=False).tobytes() for name in _COLUMNS),
        )
    )


def decode_frame(data: bytes | memoryview) -> Frame:
    """Return the frame that `encode_frame` wrote; raises InvalidFrame when the bytes are no whole frame."""
    if len(data) < _HEADER.size:
        raise InvalidFrame(f"a stored frame has at least {_HEADER.size} bytes, got {len(data)}")
    version, flags, sensor_bytes, boot_bytes, time_us, sequence, points = _HEADER.unpack_from(data)
    if version != VERSION:
        raise InvalidFrame(f"stored frame of version {version}, want {VERSION}")
    at_boot = _HEADER.size + sensor_bytes
    at_columns = at_boot + boot_bytes
    want = at_columns + len(_COLUMNS) * points * _F32.itemsize
    if len(data) != want:
        raise InvalidFrame(f"a stored frame of {points} points has {want} bytes, got {len(data)}")
    columns = np.frombuffer(data, _F32, offset=at_columns).reshape(len(_COLUMNS), points).astype(np.float32)
    return Frame(
        sensor_id=bytes(data[_HEADER.size : at_boot]).decode(),
        time_us=time_us,
        sequence=sequence if flags & _HAS_SEQUENCE else None,
        boot_id=bytes(data[at_boot:at_columns]).decode() if flags & _HAS_BOOT else None,
        range_m=columns[0],
        azimuth_rad=columns[1],
        radial_velocity_mps=columns[2],
        snr_db=columns[3],
    )


def content_digest(frame: Frame) -> int:
    """Return 63 bits that name the frame's content, to tell a repeated frame from a conflicting one."""
    return digest_of(encode_frame(frame))


def points_digest(frame: Frame) -> int:
    """Return 63 bits that name time and points, whatever boot and number the frame came with."""
    return digest_of(encode_frame(replace(frame, boot_id=None, sequence=None)))


def digest_of(data: bytes) -> int:
    """Return the 63 bits that name these bytes."""
    return int.from_bytes(hashlib.blake2b(data, digest_size=_DIGEST_BYTES).digest(), "little") >> 1
