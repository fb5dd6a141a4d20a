"""Gather what the diagnosis of a stream wants: from recorded frames, or from a host's log and rows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from sqlalchemy import Engine

from service.formats.sensor import SensorConfig
from service.pipeline.host import EmbeddedHost
from service.pipeline.offline import track
from service.storage.states import StateFrame, stream_states
from service.tracking.model import Frame, TrackStatus
from service.traffic.diagnosis import Diagnosis, Finding, Stream, examine
from service.traffic.mounting import Paths, examine_mounting

NO_TRACKS_WITH = frozenset({"doppler_sign", "no_doppler", "too_few_points"})  # tracks would mislead
EVERY_FRAMES = 4  # of a track: 5 places a second tell a direction as well as 20
SILENT_S = 5.0
_EPOCHS = 4096  # told apart among the tracks of one diagnosis
_US_PER_S = 1_000_000


def diagnose_recording(frames: Sequence[Frame], config: SensorConfig) -> Diagnosis:
    """Return what is wrong with recorded frames; tracks them for the mounting."""
    found = examine(Stream.of(frames), config)
    if _misleading(found):
        return found + _without_tracks()
    recording = track(frames, config)
    parts = []
    for scan in recording.scans[::EVERY_FRAMES]:
        now = scan.estimates
        mask = now.status == TrackStatus.CONFIRMED
        parts.append((now.number[mask], now.x_m[mask], now.y_m[mask], scan.epoch))
    return found + examine_mounting(_paths(parts), config)


def diagnose_sensor(
    host: EmbeddedHost, engine: Engine, sensor_id: str, *, seconds: float, minutes: float
) -> Diagnosis:
    """Return what is wrong with a sensor's newest frames; its mounting from the stored states.

    Raises NotFound for an unknown sensor.
    """
    config = host.config(sensor_id)
    health = next(s for s in host.health().sensors if s.sensor_id == sensor_id)
    records = host.recent_frames(sensor_id, round(seconds * config.rate_hz))
    if not records:
        return Diagnosis(not_told=("no frame of the sensor is in the log",))
    standing = _standing(health.failure, health.frame_age_s)
    stream = Stream.of([r.frame for r in records], [r.received_us for r in records])
    found = standing + examine(stream, config)
    if _misleading(found):
        return found + _without_tracks()
    end_us = int(stream.time_us.max()) + 1
    states = stream_states(engine, sensor_id, end_us - round(60 * minutes * _US_PER_S), end_us)
    return found + examine_mounting(_stored_paths(states), config)


def _standing(failure: str | None, frame_age_s: float | None) -> Diagnosis:
    found = []
    if failure is not None:
        advice = "Restart the service; if it fails again, report the reason with a recording."
        found.append(Finding("failed", "fault", f"The sensor is not tracked: {failure}.", {}, advice))
    if frame_age_s is not None and frame_age_s > SILENT_S:
        found.append(
            Finding(
                "silent",
                "fault",
                f"The newest tracked frame was received {frame_age_s:.0f} s ago.",
                {"frame_age_s": frame_age_s},
                "Look at the radar's power and network, and at what the sender hears from the service.",
            )
        )
    return Diagnosis(tuple(found))


def _misleading(found: Diagnosis) -> bool:
    return any(finding.code in NO_TRACKS_WITH for finding in found.findings)


def _without_tracks() -> Diagnosis:
    return Diagnosis(not_told=("the mounting: it needs sound tracks, so the faults above come first",))


def _stored_paths(states: Iterable[StateFrame]) -> Paths:
    parts = []
    for frame in states:
        if frame.frame % EVERY_FRAMES == 0:
            mask = frame.states.samples["status"] == TrackStatus.CONFIRMED
            samples = frame.states.samples[mask]
            parts.append((frame.states.number[mask], samples["x_m"], samples["y_m"], frame.epoch))
    return _paths(parts)


def _paths(parts: Iterable[tuple[np.ndarray, np.ndarray, np.ndarray, int]]) -> Paths:
    """Join samples that come in order of time; each is numbers, x, y and the epoch."""
    found = list(parts)
    if not found:
        return Paths(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))
    track_of = np.concatenate([part[0].astype(np.int64) * _EPOCHS + part[3] % _EPOCHS for part in found])
    order = np.argsort(track_of, kind="stable")
    x, y = (np.concatenate([part[i] for part in found]).astype(np.float64)[order] for i in (1, 2))
    return Paths(track_of[order], x, y)
