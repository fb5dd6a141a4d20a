from __future__ import annotations

import numpy as np
import pytest

from service.pipeline.clocks import ClockWatch

PERIOD_US = 50_000


def watch(seconds, sensor_us, delay_us):
    """Observe frames at 20 Hz: `sensor_us` makes the sensor's time, `delay_us` is the transport's."""
    seen = ClockWatch()
    for k in range(int(seconds * 20)):
        true_us = 1_764_000_000_000_000 + k * PERIOD_US
        seen.observe(int(sensor_us(true_us, k)), int(true_us + delay_us(k)))
    return seen.report()


def test_nothing_is_told_before_the_first_frame():
    report = ClockWatch().report()

    assert (report.ahead_s, report.skew_s, report.drift_ppm, report.jitter_s, report.steps) == (
        None, None, None, None, 0,
    )  # fmt: skip


def test_the_skew_is_that_of_the_least_delayed_frames():
    delays = np.random.default_rng(1).exponential(20_000, 4000) + 2_000

    report = watch(100, lambda true_us, _: true_us + 300_000, lambda k: delays[k])

    assert report.skew_s == pytest.approx(0.298, abs=0.001)  # 200 frames: the least delay is near 2 ms
    assert report.jitter_s == pytest.approx(0.02, rel=0.6)  # mean |difference| of two exponentials: its scale
    assert report.drift_ppm == pytest.approx(0, abs=20)
    assert report.steps == 0


def test_a_fast_clock_shows_as_drift():
    report = watch(300, lambda true_us, k: true_us + k * PERIOD_US * 100e-6, lambda k: 1000 + k % 7)

    assert report.drift_ppm == pytest.approx(100, abs=2)
    assert report.steps == 0


def test_a_clock_that_starts_in_1970_and_is_then_set_is_a_step_and_no_drift():
    report = watch(100, lambda true_us, k: k * PERIOD_US if k < 1000 else true_us, lambda _: 3000)

    assert report.steps == 1
    assert report.skew_s == pytest.approx(-0.003)
    assert report.drift_ppm is None
