"""Turn a live entry into bytes and back, for the way from a tracker process to the readers.

Layout, little endian: lengths, a JSON head, the columns of the estimates one after the other, and the newest
frame as the log stores it. Only what the readers see goes over; the report of the step does not.
"""

from __future__ import annotations

import dataclasses
import struct
from typing import Any

import numpy as np
import orjson

from service.formats.columnar import decode_frame, encode_frame
from service.pipeline.fold_state import Folded
from service.pipeline.live import LiveEntry
from service.tracking.model import Frame, StepReport, TrackEstimates

_HEAD = struct.Struct("<?II")  # its record is a frame, bytes of the head, tracks
_DTYPES: dict[str, np.dtype[Any]] = {"I64": np.dtype("<i8"), "F32": np.dtype("<f4"), "U8": np.dtype("u1")}
_COLUMNS = tuple((item.name, _DTYPES[str(item.type)]) for item in dataclasses.fields(TrackEstimates))
_NO_REPORT = StepReport()


def encode_entry(entry: LiveEntry, *, frame: bool) -> bytes:
    """Return the entry as bytes; `frame`: the record that led to it is a frame."""
    folded, newest = entry.folded, entry.points_from
    head = orjson.dumps(
        [
            entry.sensor_id,
            entry.version,
            entry.epoch,
            entry.received_us,
            None if folded is None else _place(folded),
            None if newest is None else _place(newest),
        ]
    )
    parts = [_HEAD.pack(frame, len(head), 0 if folded is None else len(folded.estimates)), head]
    if folded is not None:
        parts += [getattr(folded.estimates, name).astype(dtype).tobytes() for name, dtype in _COLUMNS]
    if newest is not None and newest.frame is not None:
        parts.append(encode_frame(newest.frame))
    return b"".join(parts)


def decode_entry(data: bytes) -> tuple[LiveEntry, bool]:
    """Return the entry, and whether its record is a frame."""
    from_frame, head_bytes, tracks = _HEAD.unpack_from(data)
    at = _HEAD.size + head_bytes
    sensor_id, version, epoch, received_us, place, frame_place = orjson.loads(data[_HEAD.size : at])
    folded = points_from = None
    if place is not None:
        columns = []
        for _, dtype in _COLUMNS:
            columns.append(np.frombuffer(data, dtype, tracks, at))
            at += tracks * dtype.itemsize
        estimates = TrackEstimates(*columns)
        folded = _folded(place, estimates, None)
        if frame_place is not None and at < len(data):
            points_from = _folded(frame_place, estimates, decode_frame(memoryview(data)[at:]))
    return LiveEntry(sensor_id, version, epoch, received_us, folded, points_from), from_frame


def _folded(place: list[int], estimates: TrackEstimates, frame: Frame | None) -> Folded:
    position, epoch, number, boot, time_us = place
    return Folded(position, epoch, number, boot, time_us, estimates, _NO_REPORT, frame)


def _place(folded: Folded) -> tuple[int, int, int, int, int]:
    return folded.position, folded.epoch, folded.number, folded.boot, folded.time_us
