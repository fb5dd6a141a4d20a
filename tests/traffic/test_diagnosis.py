"""Each fault put into a sound recording is named, and a sound recording has no finding."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from service.formats.sensor import CountLine, Region, SensorConfig
from service.simulation.scenario import scenario_named, simulate
from service.simulation.scene_files import site
from service.tracking.model import Frame
from service.traffic.diagnosis import Diagnosis, Stream, examine
from service.traffic.mounting import Paths, examine_mounting

Frames = list[Frame]


@pytest.fixture(scope="module")
def sound() -> tuple[SensorConfig, Frames]:
    scenario = scenario_named("two_way")
    config = SensorConfig.model_validate(site(scenario, 15.0))
    return config, [item.frame for item in simulate(scenario, seed=5, duration_s=15.0)]


def codes(found: Diagnosis) -> list[str]:
    return [finding.code for finding in found.findings]


def test_a_sound_recording_has_no_finding(sound):
    config, frames = sound

    found = examine(Stream.of(frames, [f.time_us + 30_000 for f in frames]), config)

    assert codes(found) == []
    assert found.measured["rate_hz"] == pytest.approx(20.0, rel=0.01)
    assert found.measured["clock_ahead_s"] == pytest.approx(-0.03)
    assert found.not_told == ()


def every_second(frames: Frames) -> Frames:
    return frames[::2]


def renumbered(frames: Frames) -> Frames:
    return [dataclasses.replace(f, sequence=i) for i, f in enumerate(frames[::2])]


def with_gaps(frames: Frames) -> Frames:
    return [frame for i, frame in enumerate(frames) if i % 10 != 3]


def with_a_silence(frames: Frames) -> Frames:
    return frames[:100] + frames[160:]


def shuffled(frames: Frames) -> Frames:
    return [frame for pair in zip(frames[1::2], frames[::2], strict=False) for frame in pair]


def without_doppler(frames: Frames) -> Frames:
    return [dataclasses.replace(f, radial_velocity_mps=f.radial_velocity_mps * np.nan) for f in frames]


def with_zero_doppler(frames: Frames) -> Frames:
    return [dataclasses.replace(f, radial_velocity_mps=f.radial_velocity_mps * 0) for f in frames]


def with_doppler_reversed(frames: Frames) -> Frames:
    return [dataclasses.replace(f, radial_velocity_mps=-f.radial_velocity_mps) for f in frames]


def thinned(share: float) -> Callable[[Frames], Frames]:
    def thin(frames: Frames) -> Frames:
        rng = np.random.default_rng(1)
        made = []
        for frame in frames:
            kept = rng.random(len(frame)) < share
            columns = ("range_m", "azimuth_rad", "radial_velocity_mps", "snr_db")
            made.append(dataclasses.replace(frame, **{c: getattr(frame, c)[kept] for c in columns}))
        return made

    return thin


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (every_second, "frame_rate"),
        (renumbered, "frame_rate"),
        (with_gaps, "gaps"),
        (with_a_silence, "gaps"),
        (shuffled, "time_goes_back"),
        (without_doppler, "no_doppler"),
        (with_zero_doppler, "no_doppler"),
        (with_doppler_reversed, "doppler_sign"),
        (thinned(0.2), "too_few_points"),
        (thinned(0.02), "too_few_points"),
    ],
)
def test_a_fault_of_the_frames_is_named(sound, change, wanted):
    config, frames = sound

    found = examine(Stream.of(change(frames)), config)

    assert wanted in codes(found)
    finding = next(f for f in found.findings if f.code == wanted)
    assert finding.sentence.endswith(".")
    assert finding.advice.endswith(".")
    assert finding.evidence


def test_half_the_rate_with_numbers_missing_is_told_as_that(sound):
    config, frames = sound

    (finding,) = examine(Stream.of(every_second(frames)), config).findings

    assert "10.0 frames a second" in finding.sentence
    assert "Every second frame number is missing" in finding.sentence


@pytest.mark.parametrize(("ahead_s", "word"), [(3600.0, "ahead of"), (-3600.0, "behind")])
def test_a_clock_that_is_off_is_named(sound, ahead_s, word):
    config, frames = sound
    received = [f.time_us - round(ahead_s * 1e6) for f in frames]

    (finding,) = examine(Stream.of(frames, received), config).findings

    assert finding.code == "clock_skew"
    assert word in finding.sentence
    assert finding.evidence["skew_s"] == pytest.approx(ahead_s)


def test_frames_that_arrive_in_bursts_are_named(sound):
    config, frames = sound
    received = [frames[min(i - i % 40 + 39, len(frames) - 1)].time_us for i in range(len(frames))]

    assert "late_delivery" in codes(examine(Stream.of(frames, received), config))


@pytest.mark.parametrize(
    ("region", "where"),
    [
        (Region(range_min_m=80.0, range_max_m=150.0), "share_nearer"),
        (Region(range_min_m=5.0, range_max_m=50.0), "share_farther"),
        (Region(azimuth_max_deg=2.0), "share_beside"),
    ],
)
def test_a_region_beside_the_road_is_named(sound, region, where):
    config, frames = sound

    (finding,) = examine(Stream.of(frames), config.model_copy(update={"region": region})).findings

    assert finding.code == "region"
    shares = {name: value for name, value in finding.evidence.items() if name.startswith("share")}
    assert max(shares, key=shares.get) == where


def test_few_frames_are_not_judged(sound):
    config, frames = sound

    found = examine(Stream.of(frames[:50]), config)

    assert found.findings == ()
    assert "50 frames are too few" in found.not_told[0]


# ------------------------------------------------------------- mounting

LINES = tuple(CountLine(line_id=f"C{y:.0f}", p0=(-10.0, y), p1=(6.0, y)) for y in (40.0, 80.0, 120.0))


def straight_road(turned_deg: float = 0.0, *, mirrored: bool = False, changing: bool = True) -> Paths:
    """Vehicles on four lanes between -9 and 5 m, one in five of which changes its lane."""
    rng = np.random.default_rng(3)
    track, xs, ys = [], [], []
    for k in range(60):
        y = np.arange(20.0, 140.0, 2.5)
        x = rng.choice([-7.25, -3.75, -0.25, 3.25]) + rng.normal(0, 0.2, len(y))
        if changing and k % 5 == 0:
            x = x + 3.5 * np.clip((y - 60) / 40, 0, 1) * (1 if x[0] < 0 else -1)
        track.append(np.full(len(y), k))
        xs.append(x)
        ys.append(y)
    x, y = np.concatenate(xs), np.concatenate(ys)
    turn = math.radians(turned_deg)
    x, y = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
    return Paths(np.concatenate(track), -x if mirrored else x, y)


@pytest.mark.parametrize("turned_deg", [-2.0, -1.0, -0.5, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("reference", ["lines", "heading"])
def test_the_yaw_is_found_from_lines_or_heading(turned_deg, reference):
    known = (
        {"count_lines": LINES} if reference == "lines" else {"heading_deg": 30.0, "travel_heading_deg": 210.0}
    )
    config = SensorConfig(azimuth_offset_deg=0.25, **known)

    (finding,) = examine_mounting(straight_road(turned_deg), config).findings

    assert finding.code == "yaw"
    assert finding.evidence["yaw_deg"] == pytest.approx(turned_deg, abs=0.1)
    assert finding.evidence["azimuth_offset_deg"] == pytest.approx(0.25 - turned_deg, abs=0.1)


def test_a_straight_mount_has_no_finding():
    found = examine_mounting(straight_road(), SensorConfig(count_lines=LINES))

    assert found.findings == ()
    assert abs(found.measured["yaw_deg"]) < 0.1


def test_without_a_reference_the_yaw_is_not_told():
    found = examine_mounting(straight_road(2.0), SensorConfig())

    assert found.findings == ()
    assert "count lines and travel_heading_deg" in found.not_told[0]


def test_left_and_right_exchanged_is_named_where_the_lines_tell():
    config = SensorConfig(count_lines=LINES)

    (finding,) = examine_mounting(straight_road(mirrored=True), config).findings

    assert finding.code == "azimuth_sign"
    assert finding.evidence["misfit_mirrored_m"] < 0.5
    assert finding.evidence["misfit_as_sent_m"] == pytest.approx(4.0, abs=0.5)


def test_lines_to_both_sides_alike_do_not_tell_left_from_right():
    lines = tuple(CountLine(line_id=f"C{y:.0f}", p0=(-10.0, y), p1=(10.0, y)) for y in (40.0, 80.0))
    config = SensorConfig(count_lines=lines)

    assert examine_mounting(straight_road(mirrored=True), config).findings == ()


def test_a_bend_is_no_yaw():
    """On an arc of 200 m radius the lines stand across the road where they are."""
    radius, angles = 200.0, np.radians(np.arange(5.0, 40.0, 0.5))
    parts = [(np.full(len(angles), k), radius + lane) for k, lane in enumerate([-3.5, 0.0, 3.5] * 6)]
    x = np.concatenate([radius - r * np.cos(angles) for _, r in parts])
    y = np.concatenate([r * np.sin(angles) for _, r in parts])
    lines = tuple(
        CountLine(
            line_id=f"A{a}",
            p0=(radius - 208 * math.cos(math.radians(a)), 208 * math.sin(math.radians(a))),
            p1=(radius - 192 * math.cos(math.radians(a)), 192 * math.sin(math.radians(a))),
        )
        for a in (15, 25)
    )
    paths = Paths(np.concatenate([k for k, _ in parts]), x, y)

    found = examine_mounting(paths, SensorConfig(count_lines=lines))

    assert found.findings == ()
    assert abs(found.measured["yaw_deg"]) < 0.1
