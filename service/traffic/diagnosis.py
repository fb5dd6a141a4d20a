"""Tell what is wrong with a radar's stream of frames, in words that an installer can act on.

Everything is judged from the frames themselves, the configuration, and the times at which they were received;
what needs tracks is in `mounting`. Each finding has a code that programs may rely on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from service.formats.sensor import SensorConfig
from service.tracking.model import F64, I64, Bool, Frame
from service.traffic.diagnosis_parameters import DEFAULTS, DiagnosisParameters

Severity = Literal["fault", "hint"]
_US_PER_S = 1_000_000


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong: what, how it shows, and what to do."""

    code: str
    severity: Severity  # a hint needs a person's judgement
    sentence: str
    evidence: dict[str, float]
    advice: str


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """All that was found, and what could not be looked at."""

    findings: tuple[Finding, ...] = ()
    measured: dict[str, float] = field(default_factory=dict)
    not_told: tuple[str, ...] = ()

    def __add__(self, other: Diagnosis) -> Diagnosis:
        return Diagnosis(
            self.findings + other.findings, self.measured | other.measured, self.not_told + other.not_told
        )


@dataclass(frozen=True, slots=True)
class Stream:
    """K frames in the order of their arrival, decoded under a configuration, and their N points."""

    time_us: I64  # (K,)
    sequence: I64  # (K,), -1 where the sensor gives none
    received_us: I64 | None  # (K,), None for a file
    frame: I64  # (N,) index of each point's frame
    range_m: F64  # (N,)
    azimuth_rad: F64  # (N,), without the offset of the configuration
    velocity_mps: F64  # (N,), NaN where there is none

    @classmethod
    def of(cls, frames: Sequence[Frame], received_us: Sequence[int] | None = None) -> Stream:
        """Return the columns of the frames."""
        return cls(
            time_us=np.array([f.time_us for f in frames], dtype=np.int64),
            sequence=np.array([-1 if f.sequence is None else f.sequence for f in frames], dtype=np.int64),
            received_us=None if received_us is None else np.array(received_us, dtype=np.int64),
            frame=np.repeat(np.arange(len(frames)), [len(f) for f in frames]),
            range_m=_column(frames, "range_m"),
            azimuth_rad=_column(frames, "azimuth_rad"),
            velocity_mps=_column(frames, "radial_velocity_mps"),
        )


def _column(frames: Sequence[Frame], name: str) -> F64:
    empty = np.zeros(0, dtype=np.float32)
    return np.concatenate([empty, *(getattr(frame, name) for frame in frames)]).astype(np.float64)


def examine(stream: Stream, config: SensorConfig, parameters: DiagnosisParameters = DEFAULTS) -> Diagnosis:
    """Return what the frames show by themselves."""
    p = parameters
    if len(stream.time_us) < p.frames_least:
        return Diagnosis(not_told=(f"{len(stream.time_us)} frames are too few; want {p.frames_least}",))
    return _times(stream, config, p) + _clock(stream, p) + _points(stream, config, p)


def _times(stream: Stream, config: SensorConfig, p: DiagnosisParameters) -> Diagnosis:
    """Frame rate, gaps, and times that go back."""
    step_us = np.diff(stream.time_us)
    ahead = step_us[step_us > 0]
    if not len(ahead):
        return Diagnosis(not_told=("the frames all have one time",))
    rate_hz = float(_US_PER_S / np.median(ahead))
    step = np.diff(stream.sequence)[(stream.sequence[:-1] >= 0) & (stream.sequence[1:] >= 0)]
    missing = int((step[(step > 1) & (step < p.gap_numbers_most)] - 1).sum())
    missing_share = missing / (missing + len(stream.time_us))
    longest_s = float(ahead.max() / _US_PER_S)
    found = []
    if not p.rate_low < rate_hz / config.rate_hz < p.rate_high:
        found.append(_wrong_rate(rate_hz, config, missing_share))
    elif missing_share > p.missing_share_most or longest_s > p.silence_s:
        found.append(
            Finding(
                "gaps",
                "fault",
                f"{missing} frame numbers never came ({100 * missing_share:.1f} %), and the longest silence "
                f"lasted {longest_s:.1f} s.",
                {"missing": missing, "missing_share": missing_share, "longest_silence_s": longest_s},
                "Look at the network between radar and service, and at the radar's load.",
            )
        )
    back = int((step_us <= 0).sum())
    if back > p.back_share_most * len(step_us):
        found.append(
            Finding(
                "time_goes_back",
                "fault",
                f"{back} frames are not later than the frame before them; such frames are kept, not tracked.",
                {"frames": back, "share": back / len(step_us)},
                "Send frames in order, from one sender, and let the radar's clock be disciplined (NTP, PTP).",
            )
        )
    return Diagnosis(tuple(found), {"rate_hz": rate_hz, "missing_share": missing_share})


def _wrong_rate(rate_hz: float, config: SensorConfig, missing_share: float) -> Finding:
    half = " Every second frame number is missing." if missing_share > 0.4 else ""  # noqa: PLR2004 - about half
    return Finding(
        "frame_rate",
        "fault",
        f"By their times {rate_hz:.1f} frames a second come, the sensor is registered with "
        f"{config.rate_hz:g} a second.{half}",
        {"measured_hz": rate_hz, "registered_hz": config.rate_hz, "missing_share": missing_share},
        "Set rate_hz to what the radar really sends, or find where frames are thinned out.",
    )


def _clock(stream: Stream, p: DiagnosisParameters) -> Diagnosis:
    """Compare the sensor's clock with the host's."""
    if stream.received_us is None:
        return Diagnosis(not_told=("clock skew: a file does not say when its frames were received",))
    ahead_s = (stream.time_us - stream.received_us) / _US_PER_S
    skew_s = float(np.median(ahead_s))
    spread_s = float(np.subtract(*np.percentile(ahead_s, [95, 5])))
    found = []
    if abs(skew_s) > p.skew_s:
        found.append(
            Finding(
                "clock_skew",
                "fault",
                f"The sensor's clock is {abs(skew_s):.1f} s {_side(skew_s)} the host's.",
                {"skew_s": skew_s, "spread_s": spread_s},
                "Let the radar's clock follow a time server (NTP, PTP); counts are binned by its times.",
            )
        )
    elif spread_s > p.jitter_s:
        found.append(
            Finding(
                "late_delivery",
                "fault",
                f"Frames take very different times to arrive: {spread_s:.2f} s between the 5th and the 95th "
                "percentile.",
                {"skew_s": skew_s, "spread_s": spread_s},
                "Post each frame when it is made, or look at the network; live tracks are as late.",
            )
        )
    return Diagnosis(tuple(found), {"clock_ahead_s": skew_s})


def _side(skew_s: float) -> str:
    return "ahead of" if skew_s > 0 else "behind"


def _points(stream: Stream, config: SensorConfig, p: DiagnosisParameters) -> Diagnosis:
    """Doppler, number of points, region."""
    per_frame = len(stream.range_m) / len(stream.time_us)
    measured = {"points_per_frame": per_frame}
    if per_frame < p.points_least:
        return Diagnosis((_few_points(per_frame, None),), measured)
    known = np.isfinite(stream.velocity_mps)
    if known.mean() < p.doppler_share_least or not stream.velocity_mps[known].any():
        return Diagnosis((_no_doppler(float(known.mean())),), measured)
    moving = known & (np.abs(stream.velocity_mps) > p.moving_mps)
    measured["moving_per_frame"] = float(moving.sum() / len(stream.time_us))
    if moving.sum() < p.moving_points_least:
        return Diagnosis((), measured, ("Doppler sign, points of a vehicle, region: too little moves",))
    found = [_sign(stream, moving, p), _companions(stream, moving, p), _outside(stream, moving, config, p)]
    return Diagnosis(tuple(f for f in found if f is not None), measured)


def _few_points(per_frame: float, companions: float | None) -> Finding:
    evidence = {"points_per_frame": per_frame}
    if companions is not None:
        evidence["points_of_a_vehicle"] = companions + 1
    text = (
        f"A frame has {per_frame:.1f} points on average, less than a road without traffic gives."
        if companions is None
        else f"A vehicle nearer than 80 m gives {companions + 1:.1f} points a frame: too few."
    )
    return Finding(
        "too_few_points",
        "fault",
        text,
        evidence,
        "Lower the radar's detection threshold, look for a filter that drops points, or clean the radome.",
    )


def _no_doppler(share: float) -> Finding:
    return Finding(
        "no_doppler",
        "fault",
        f"{100 * share:.0f} % of the points have a radial velocity, and the tracker needs it on all."
        if share < 1
        else "The radial velocity of every point is 0.",
        {"share_with_doppler": share},
        "Send radial_velocity_mps with each point.",
    )


def _sign(stream: Stream, moving: Bool, p: DiagnosisParameters) -> Finding | None:
    """Move points by their Doppler, and by its opposite: one of both meets points of a later frame."""
    forward, backward, tried = 0, 0, 0
    for early, late, dt_s in _pairs(stream, moving, p):
        r, az, v = stream.range_m[early], stream.azimuth_rad[early], stream.velocity_mps[early]
        near = (np.abs(r[:, None] * (az[:, None] - stream.azimuth_rad[late])) < p.match_across_m) & (
            np.abs(v[:, None] - stream.velocity_mps[late]) < p.match_mps
        )
        for sign in (1, -1):
            hit = near & (np.abs((r + sign * v * dt_s)[:, None] - stream.range_m[late]) < p.match_range_m)
            count = int(hit.any(axis=1).sum())
            forward, backward = forward + count * (sign > 0), backward + count * (sign < 0)
        tried += len(early)
    if tried < p.moving_points_least or backward < p.sign_factor * forward:
        return None
    return Finding(
        "doppler_sign",
        "fault",
        "Points move against their Doppler: "
        f"{100 * backward / tried:.0f} % are found again where its opposite leads to, "
        f"{100 * forward / tried:.0f} % where it leads to.",
        {"share_opposite": backward / tried, "share_as_sent": forward / tried, "points": tried},
        "Change radial_velocity_positive of the sensor (receding or approaching).",
    )


def _pairs(stream: Stream, moving: Bool, p: DiagnosisParameters) -> list[tuple[I64, I64, float]]:
    """Return the moving points of frames a quarter of a second apart: two sets of indices, and the time."""
    count = len(stream.time_us)
    later = np.searchsorted(stream.time_us, stream.time_us + round(p.pair_s * _US_PER_S))
    every = max(1, count // p.pairs_most)
    near = moving & (stream.range_m > p.near_from_m) & (stream.range_m < p.near_to_m)
    edges = np.searchsorted(stream.frame, np.arange(count + 1))
    pairs = []
    for k in range(0, count, every):
        j = int(later[k])
        if j >= count or j <= k or stream.time_us[j] - stream.time_us[k] > 2 * p.pair_s * _US_PER_S:
            continue
        early = edges[k] + np.flatnonzero(near[edges[k] : edges[k + 1]])
        late = edges[j] + np.flatnonzero(moving[edges[j] : edges[j + 1]])
        dt_s = float(stream.time_us[j] - stream.time_us[k]) / _US_PER_S
        if len(early) and len(late):
            pairs.append((early, late, dt_s))
    return pairs


def _companions(stream: Stream, moving: Bool, p: DiagnosisParameters) -> Finding | None:
    """Count the further points of its vehicle beside each moving point."""
    counts: list[I64] = []
    for early, _, _ in _pairs(stream, moving, p):
        r, az, v = stream.range_m[early], stream.azimuth_rad[early], stream.velocity_mps[early]
        x, y = r * np.sin(az), r * np.cos(az)
        beside = np.hypot(x[:, None] - x, y[:, None] - y) < p.vehicle_m
        alike = np.abs(v[:, None] - v) < p.vehicle_mps
        counts.append((beside & alike).sum(axis=1) - 1)
    found = np.concatenate([np.zeros(0, dtype=np.int64), *counts])
    if len(found) < p.moving_points_least or found.mean() >= p.companions_least:
        return None
    return _few_points(len(stream.range_m) / len(stream.time_us), float(found.mean()))


def _outside(stream: Stream, moving: Bool, config: SensorConfig, p: DiagnosisParameters) -> Finding | None:
    """Look for traffic where the sensor's region does not reach."""
    region = config.region
    azimuth_deg = np.degrees(stream.azimuth_rad[moving]) + config.azimuth_offset_deg
    range_m = stream.range_m[moving]
    shares = {
        "share_nearer": float((range_m < region.range_min_m).mean()),
        "share_farther": float((range_m > region.range_max_m).mean()),
        "share_beside": float((np.abs(azimuth_deg) > region.azimuth_max_deg).mean()),
    }
    if sum(shares.values()) < p.outside_share_most:
        return None
    reach = {f"range_p{q}_m": float(np.percentile(range_m, q)) for q in (5, 95)}
    return Finding(
        "region",
        "fault",
        f"{100 * sum(shares.values()):.0f} % of the moving points lie outside the sensor's region "
        f"({region.range_min_m:g} to {region.range_max_m:g} m, {region.azimuth_max_deg:g} deg to each side).",
        shares | reach,
        "Set the region to where the road is seen, or azimuth_offset_deg if the radar was turned.",
    )
