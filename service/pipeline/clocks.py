"""Watch a sensor's clock against the host's: how far off it is, its drift, its jitter, how often it was set.

A frame arrives late by its transport, never early; so over a span the largest "sensor time less receive time"
comes nearest to the offset of the two clocks. Nothing here changes a frame: times are the sensor's own.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

STEP_US = (
    1_000_000  # a change of the offset from one frame to the next that no transport makes: the clock was set
)
SPAN_US = 10_000_000  # one largest offset each
SPANS = 60  # ten minutes: at 1 ppm the drift shows 0.6 ms, at 100 ppm 60 ms
DRIFT_SPANS = 6  # a minute at least before a drift is told
_JITTER_SHARE = 16  # RFC 3550, 6.4.1: J += (|D| - J) / 16
_US_PER_S = 1_000_000


@dataclass(frozen=True, slots=True)
class ClockReport:
    """What is known of a sensor's clock; None where too little was seen."""

    ahead_s: float | None = None  # at the newest frame, transport included
    skew_s: float | None = None  # the least delayed frames of the last 10 to 20 s
    drift_ppm: float | None = None  # of the skew over up to ten minutes; positive: the sensor's clock is fast
    jitter_s: float | None = None  # unsteadiness of arrival against the sensor's times (RFC 3550)
    steps: int = 0  # how often the clock was set since the service started


@dataclass(slots=True)
class ClockWatch:
    """One sensor's clock; `observe` each frame as it arrives."""

    steps: int = 0
    _ahead_us: int | None = None
    _jitter_us: float = 0.0
    _span: int = 0  # number of the running span
    _largest: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=SPANS))  # (span, offset)

    def observe(self, time_us: int, received_us: int) -> None:
        """Take in one frame: the sensor's time and the host's at its arrival."""
        ahead_us, before_us = time_us - received_us, self._ahead_us
        self._ahead_us = ahead_us
        if before_us is not None and abs(ahead_us - before_us) > STEP_US:
            self.steps += 1
            self._largest.clear()
            self._jitter_us = 0.0
        elif before_us is not None:
            self._jitter_us += (abs(ahead_us - before_us) - self._jitter_us) / _JITTER_SHARE
        span = received_us // SPAN_US
        if self._largest and self._largest[-1][0] == span:
            if ahead_us > self._largest[-1][1]:
                self._largest[-1] = span, ahead_us
        else:
            self._largest.append((span, ahead_us))

    def report(self) -> ClockReport:
        """Return what is known now."""
        if self._ahead_us is None:
            return ClockReport()
        spans = np.array(list(self._largest), dtype=np.float64)  # the event loop may append meanwhile: a copy
        skew_us = float(spans[-2:, 1].max())
        drift = None
        if len(spans) >= DRIFT_SPANS:
            seconds = (spans[:, 0] - spans[0, 0]) * (SPAN_US / _US_PER_S)
            drift = round(float(np.polyfit(seconds, spans[:, 1] - spans[0, 1], 1)[0]), 1)  # us/s is ppm
        return ClockReport(
            ahead_s=self._ahead_us / _US_PER_S,
            skew_s=skew_us / _US_PER_S,
            drift_ppm=drift,
            jitter_s=self._jitter_us / _US_PER_S,
            steps=self.steps,
        )
