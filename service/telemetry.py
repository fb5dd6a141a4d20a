"""What the service tells of itself: metrics in Prometheus' format, and log lines with keys."""

from __future__ import annotations

import logging
import sys
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import structlog
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.metrics_core import Metric

from service import __version__

Samples = list[tuple[str, str, dict[str, str], float]]  # family, sample, labels, value

_LEVELS = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}
_STAGE_BUCKETS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
_STEP_BUCKETS_S = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.5)

ERROR_CHARACTERS = 500  # of a failure's message
PLACES = 6  # innermost calls that are named


class Telemetry:
    """The metrics of one host, in a registry of its own. Sensors are labels, tracks never."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        sensor = ("sensor_id",)
        self.frames = Counter(
            "wayside_frames", "Frames by what became of them.", (*sensor, "fate"), registry=self.registry
        )
        self.missing = Counter(
            "wayside_frames_missing", "Frame numbers that never came.", sensor, registry=self.registry
        )
        self.points = Counter("wayside_points", "Points of folded frames.", sensor, registry=self.registry)
        self.clusters = Counter(
            "wayside_clusters", "Clusters found in folded frames.", sensor, registry=self.registry
        )
        self.tracks = Gauge(
            "wayside_tracks", "Tracks after the newest frame.", (*sensor, "status"), registry=self.registry
        )
        self.restarts = Counter(
            "wayside_tracker_restarts", "New epochs of the tracker.", sensor, registry=self.registry
        )
        self.process_restarts = Counter(
            "wayside_tracker_process_restarts",
            "Tracker processes that were started again.",
            ("process",),
            registry=self.registry,
        )
        self.failed = Gauge(
            "wayside_sensor_failed", "1 while a sensor is not tracked.", sensor, registry=self.registry
        )
        self.queue = Gauge(
            "wayside_queue_records", "Logged records not folded yet.", sensor, registry=self.registry
        )
        self.stage = Histogram(
            "wayside_stage_seconds",
            "Time since a frame was received until it was logged, folded, readable, stored.",
            ("stage",),
            registry=self.registry,
            buckets=_STAGE_BUCKETS_S,
        )
        self.fold = Histogram(
            "wayside_fold_seconds", "Work on one record.", registry=self.registry, buckets=_STEP_BUCKETS_S
        )
        self.flush = Histogram(
            "wayside_flush_seconds",
            "Work on one flush of rows.",
            registry=self.registry,
            buckets=_STAGE_BUCKETS_S,
        )
        self.flush_failures = Counter(
            "wayside_flush_failures", "Flushes that will be tried again.", registry=self.registry
        )
        self.clock_skew = Gauge(
            "wayside_sensor_clock_skew_seconds",
            "The sensor's clock less the host's, by its least delayed frames.",
            sensor,
            registry=self.registry,
        )
        self.clock_jitter = Gauge(
            "wayside_sensor_clock_jitter_seconds",
            "Unsteadiness of arrival against the sensor's times (RFC 3550).",
            sensor,
            registry=self.registry,
        )
        self._add_standing()
        self.build = Gauge("wayside_build_info", "1, with the version.", ("version",), registry=self.registry)
        self.build.labels(__version__).set(1)

    def _add_standing(self) -> None:
        """Add the gauges of ages, queues and sizes; `pipeline.health.show` sets them."""

        def gauge(name: str, about: str, *labels: str) -> Gauge:
            return Gauge(f"wayside_{name}", about, labels, registry=self.registry)

        self.lag = gauge("lag_seconds", "Wait of the oldest frame logged and not folded.", "sensor_id")
        self.unstored = gauge("unstored_frames", "Frames folded and not stored yet.", "sensor_id")
        self.waiting_bytes = gauge(
            "waiting_log_bytes", "In the log, of frames that are not folded.", "sensor_id"
        )
        self.frame_age = gauge("frame_age_seconds", "Since the newest folded frame came.", "sensor_id")
        self.stored_age = gauge("stored_age_seconds", "Since rows were stored last.", "sensor_id")
        self.log_bytes = gauge("log_bytes", "Size of the frame log.")
        self.log_files = gauge("log_files", "Files of the frame log.")
        self.log_oldest_age = gauge("log_oldest_age_seconds", "Since the oldest kept frame came.")
        self.log_waiting = gauge("log_waiting_records", "Records that wait for the disk.")
        self.log_damaged = gauge("log_damaged_records", "Records left out as damaged.")
        self.rows_bytes = gauge("rows_bytes", "Size of the embedded database.")
        self.rows_oldest_age = gauge("rows_oldest_age_seconds", "Age of the oldest row, 0: none.", "kind")
        self.disk_free = gauge("disk_free_ratio", "Free share of the disk that holds the log.")

    def show_clock(self, sensor_id: str, skew_s: float | None, jitter_s: float | None) -> None:
        """Set the gauges of a sensor's clock where it is known."""
        if skew_s is not None and jitter_s is not None:
            self.clock_skew.labels(sensor_id).set(skew_s)
            self.clock_jitter.labels(sensor_id).set(jitter_s)

    def samples(self) -> Samples:
        """Return what was counted here, in a form that another process can add to its own."""
        return [
            (family.name, sample.name, sample.labels, sample.value)
            for family in self.registry.collect()
            for sample in family.samples
            # Gauges without a label are of the whole host, which sets them itself.
            if not sample.name.endswith("_created") and (family.type != "gauge" or sample.labels)
        ]

    def text(self, elsewhere: Sequence[Samples] = ()) -> bytes:
        """Return every metric in Prometheus' text format; what other processes counted is added."""
        return generate_latest(cast("CollectorRegistry", _Added(self.registry, elsewhere)))


@dataclass(frozen=True, slots=True)
class _Added:
    """A registry with what was counted elsewhere: counts are summed, gauges replaced."""

    registry: CollectorRegistry
    elsewhere: Sequence[Samples]

    def collect(self) -> Iterator[Metric]:
        others: dict[str, list[tuple[str, dict[str, str], float]]] = {}
        for samples in self.elsewhere:
            for family_name, name, labels, value in samples:
                others.setdefault(family_name, []).append((name, labels, value))
        for family in self.registry.collect():
            values = {(s.name, *sorted(s.labels.items())): s.value for s in family.samples}
            labels_of = {(s.name, *sorted(s.labels.items())): s.labels for s in family.samples}
            for name, labels, value in others.get(family.name, ()):
                key = (name, *sorted(labels.items()))
                values[key] = value if family.type == "gauge" else values.get(key, 0.0) + value
                labels_of[key] = labels
            summed = Metric(family.name, family.documentation, family.type)
            for key, value in values.items():
                summed.add_sample(str(key[0]), labels_of[key], value)
            yield summed


def added(one: Samples, other: Samples) -> Samples:
    """Return the sums of counts of a process and of the one that it replaced; gauges are of the newer."""
    sums = {(family, name, *sorted(labels.items())): (labels, value) for family, name, labels, value in one}
    for family, name, labels, value in other:
        key = (family, name, *sorted(labels.items()))
        before = sums.get(key, (labels, 0.0))[1]
        sums[key] = labels, value if name == family else before + value
    return [(str(key[0]), str(key[1]), labels, value) for key, (labels, value) in sums.items()]


def in_short(_logger: object, _method: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
    """Say in two fields what failed and where; a trace, with the values in it, is no part of the log."""
    found = event.pop("exc_info", None)
    error = sys.exc_info()[1] if found is True else found[1] if isinstance(found, tuple) else found
    if isinstance(error, BaseException):
        event["error"] = f"{type(error).__name__}: {error}"[:ERROR_CHARACTERS]
        calls = traceback.extract_tb(error.__traceback__)[-PLACES:]
        event["where"] = [f"{Path(call.filename).name}:{call.lineno} {call.name}" for call in reversed(calls)]
    return event


def _print_logger(*_: object) -> structlog.PrintLogger:
    """Return a logger on what is standard error now: it may be another than at set-up."""
    return structlog.PrintLogger(sys.stderr)


def set_up_logging(
    level: Literal["debug", "info", "warning", "error"] = "info",
    layout: Literal["auto", "console", "json"] = "auto",
) -> None:
    """Write log lines to standard error: readable on a terminal, else one JSON object a line."""
    readable = layout == "console" or (layout == "auto" and sys.stderr.isatty())
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            *(
                [structlog.dev.ConsoleRenderer(exception_formatter=structlog.dev.plain_traceback)]
                if readable and level == "debug"
                else [in_short, structlog.dev.ConsoleRenderer()]
                if readable
                else [in_short, structlog.processors.JSONRenderer()]
            ),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(_LEVELS[level]),
        logger_factory=_print_logger,
        cache_logger_on_first_use=False,
    )
