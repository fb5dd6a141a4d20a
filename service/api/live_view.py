"""Turn a live entry into the bytes of its replies; what does not change with the clock is rendered once."""

from __future__ import annotations

import numpy as np
import orjson

from service.formats.georeference import pose_of
from service.formats.rfc3339 import format_time
from service.formats.sensor import SensorConfig
from service.formats.tracks import LiveContext, live_tracks, rounded
from service.pipeline.live import LiveEntry
from service.tracking.geometry import plan_points


def etag(entry: LiveEntry, now_us: int, *, points: bool) -> str:
    """Return the strong entity tag: it names epoch, version, state and form, not the age."""
    return f'"{entry.epoch}-{entry.version}-{entry.state(now_us)}{"-points" if points else ""}"'


def body(entry: LiveEntry, config: SensorConfig, now_us: int, *, points: bool) -> bytes:
    """Return the live reply as JSON; the fields and their order are those of docs/architecture.md."""
    age_s = None if entry.received_us is None else round(max(now_us - entry.received_us, 0) / 1e6, 3)
    parts = [
        entry.rendered("head", _head)[:-1],
        b',"age_s":',
        orjson.dumps(age_s),
        b',"state":"',
        entry.state(now_us).encode(),
        b'","tracks":',
        entry.rendered("tracks", lambda e: _tracks(e, config)),
    ]
    if points:
        parts += [b',"points":', entry.rendered("points", lambda e: _points(e, config))]
    return b"".join((*parts, b"}"))


def _head(entry: LiveEntry) -> bytes:
    folded = entry.folded
    return orjson.dumps(
        {
            "sensor_id": entry.sensor_id,
            "version": entry.version,
            "epoch": entry.epoch,
            "frame": None if folded is None else folded.number,
            "timestamp": None if folded is None else format_time(folded.time_us),
            "received_at": None if entry.received_us is None else format_time(entry.received_us),
        }
    )


def _tracks(entry: LiveEntry, config: SensorConfig) -> bytes:
    if entry.folded is None:
        return b"[]"
    context = LiveContext(entry.sensor_id, entry.epoch, pose_of(config), config.length_bounds_m)
    return orjson.dumps(live_tracks(context, entry.folded.time_us, entry.folded.estimates))


def _points(entry: LiveEntry, config: SensorConfig) -> bytes:
    frame = None if entry.points_from is None else entry.points_from.frame
    if frame is None:
        return b'{"x_m":[],"y_m":[],"radial_velocity_mps":[],"snr_db":[]}'
    plan = plan_points(frame, config.sensor_model())
    return orjson.dumps(
        {
            "x_m": rounded(plan.x_m),
            "y_m": rounded(plan.y_m),
            "radial_velocity_mps": rounded(frame.radial_velocity_mps.astype(np.float64)),
            "snr_db": rounded(frame.snr_db.astype(np.float64), 1),
        }
    )
