"""Turn the state of a fold into bytes, and back.

Layout, little endian: magic, version, length and digest of a JSON header, the header (sensor, epoch,
configuration, counters, lengths of the parts), then order, open blocks, tracker and traffic as
`service.tracking.snapshot` writes them, compressed. The tracker's parameters are derived from the
configuration again, so that a new parameter does not make old snapshots unreadable.
"""

from __future__ import annotations

import hashlib
import json
import struct
import zlib
from typing import Any, cast

from pydantic import ValidationError

from service.errors import InvalidInput, SnapshotUnreadable
from service.formats.sensor import SensorConfig
from service.pipeline.blocks import Collected
from service.pipeline.fold_state import FoldState, S, Tracker
from service.pipeline.order import OrderState
from service.tracking import snapshot
from service.traffic.monitor import TrafficState
from service.traffic.parameters import traffic_setup

VERSION = 3
_MAGIC = b"WSFS"
_HEADER = struct.Struct("<4sHI16s")
# On a recorded scene 701 kB become 65 kB in 2.5 ms (the maps are mostly empty); more gains little.
_LEVEL = 1
_PARTS = 4
_FIELDS = (
    "sensor_id",
    "epoch",
    "epoch_first_position",
    "position",
    "config",
    "frame_us",
    "frame_number",
    "boot",
    "ticks",
    "events",
)


def dump(state: FoldState[S]) -> bytes:
    """Return the state as bytes; the same state gives the same bytes."""
    values = (state.order, state.collected, state.tracker, state.traffic)
    parts = [zlib.compress(snapshot.dump(part), _LEVEL) for part in values]
    header = {name: getattr(state, name) for name in _FIELDS} | {"parts": [len(part) for part in parts]}
    text = json.dumps(header, sort_keys=True, separators=(",", ":")).encode()
    return b"".join((_HEADER.pack(_MAGIC, VERSION, len(text), _digest(text)), text, *parts))


def load(data: bytes, tracker: Tracker[S]) -> FoldState[S]:
    """Return the state that `dump` wrote; raises SnapshotUnreadable when this build cannot restore it."""
    header, parts = _split(data)
    empty = tracker.initial_state()
    try:
        config = SensorConfig.model_validate_json(header["config"])
        return FoldState(
            **{name: header[name] for name in _FIELDS},
            parameters=config.tracker_parameters(),
            setup=traffic_setup(config),
            order=snapshot.load(OrderState, parts[0]),
            collected=snapshot.load(Collected, parts[1]),
            tracker=snapshot.load(type(empty), parts[2]),
            traffic=snapshot.load(TrafficState, parts[3]),
        )
    except (KeyError, TypeError, ValidationError, InvalidInput) as error:
        raise SnapshotUnreadable(f"the snapshot's header does not fit: {error}") from error


def _inflate(part: bytes) -> bytes:
    try:
        return zlib.decompress(part)
    except zlib.error as error:
        raise SnapshotUnreadable(f"the snapshot is damaged: {error}") from error


def _digest(text: bytes) -> bytes:
    return hashlib.blake2b(text, digest_size=16).digest()


def _split(data: bytes) -> tuple[dict[str, Any], list[bytes]]:
    """Return the header and the parts behind it."""
    if len(data) < _HEADER.size:
        raise SnapshotUnreadable(f"a fold's snapshot has at least {_HEADER.size} bytes, got {len(data)}")
    magic, version, length, digest = _HEADER.unpack_from(data)
    if magic != _MAGIC or version != VERSION:
        raise SnapshotUnreadable(f"want a fold's snapshot of version {VERSION}, got {magic!r} {version}")
    at = _HEADER.size + length
    if _digest(data[_HEADER.size : at]) != digest:
        raise SnapshotUnreadable("the snapshot's header is damaged: its digest does not match")
    try:
        header = cast("dict[str, Any]", json.loads(data[_HEADER.size : at]))
        sizes = [int(size) for size in header["parts"]]
    except (ValueError, KeyError, TypeError) as error:
        raise SnapshotUnreadable(f"the snapshot's header does not fit: {error}") from error
    if at + sum(sizes) != len(data) or len(sizes) != _PARTS:
        raise SnapshotUnreadable("the snapshot is truncated")
    parts = []
    for size in sizes:
        parts.append(_inflate(data[at : at + size]))
        at += size
    return header, parts
