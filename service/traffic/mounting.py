"""Tell from tracks how the radar is mounted: which way it is turned, and whether left is right.

What can be known: azimuth, range and Doppler of a radar at the origin all turn with it, so tracks alone never
tell its yaw; they need something else that knows the direction of the road. That is, in this order,

1. the count lines, which an installer draws straight across the road: the angle between a line's normal and
   the tracks that cross it, measured within 25 m of the line, so that a bend does not matter;
2. `travel_heading_deg` (with `heading_deg` of the boresight) on a straight road: against the median direction
   of the tracks from their first to their last point.

The yaw is the median over tracks, which sheds lane changes; its standard error follows from their spread.
Mirrored azimuth is told where the count lines reach farther to one side than to the other, since traffic lies
in the middle of a line, or where the tracks cross it with the opposite slope.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from service.formats.sensor import CountLine, SensorConfig
from service.tracking.model import F64, I64
from service.traffic.diagnosis import Diagnosis, Finding
from service.traffic.diagnosis_parameters import DEFAULTS, DiagnosisParameters

_MAD_TO_STD = 1.4826  # of a normal distribution
_MEDIAN_LOSS = 1.2533  # standard error of a median against that of a mean


@dataclass(frozen=True, slots=True)
class Paths:
    """Positions of tracks in the plan frame, in order of track and time: (N,) each."""

    track: I64
    x_m: F64
    y_m: F64

    def turned(self, angle_rad: float) -> Paths:
        """Return the paths turned clockwise about the radar."""
        c, s = math.cos(angle_rad), math.sin(angle_rad)
        return Paths(self.track, self.x_m * c + self.y_m * s, self.y_m * c - self.x_m * s)

    def mirrored(self) -> Paths:
        """Return the paths with left and right exchanged."""
        return Paths(self.track, -self.x_m, self.y_m)


@dataclass(frozen=True, slots=True)
class Angle:
    """An angle between tracks and a reference, clockwise."""

    rad: float
    standard_error_rad: float
    tracks: int


def examine_mounting(
    paths: Paths, config: SensorConfig, parameters: DiagnosisParameters = DEFAULTS
) -> Diagnosis:
    """Return what tracks and the configuration together tell of the mounting."""
    p = parameters
    mirror = _mirror_finding(paths, config, p)
    if mirror is not None:
        return Diagnosis((mirror,), {}, ("yaw: left and right seem exchanged, which comes first",))
    angle, reference = turned_by(paths, config, p)
    if angle is None:
        return Diagnosis(not_told=(f"yaw: {reference}",))
    yaw_deg = math.degrees(angle.rad)
    measured = {
        "yaw_deg": yaw_deg,
        "yaw_standard_error_deg": math.degrees(angle.standard_error_rad),
        "yaw_tracks": float(angle.tracks),
    }
    if abs(yaw_deg) < max(p.yaw_deg, 3 * measured["yaw_standard_error_deg"]):
        return Diagnosis((), measured)
    wanted = config.azimuth_offset_deg - yaw_deg
    finding = Finding(
        "yaw",
        "fault",
        f"The tracks run {abs(yaw_deg):.2f} deg to the {'right' if yaw_deg > 0 else 'left'} of {reference}.",
        measured | {"azimuth_offset_deg": wanted},
        f"If the site file is right there, set azimuth_offset_deg to {wanted:.2f} "
        f"(now {config.azimuth_offset_deg:g}).",
    )
    return Diagnosis((finding,), measured)


def turned_by(paths: Paths, config: SensorConfig, p: DiagnosisParameters) -> tuple[Angle | None, str]:
    """Return by how much the tracks are turned clockwise against the best reference, and which that is.

    None: there is no reference, or too few tracks; the text says which.
    """
    angles = np.concatenate([np.zeros(0), *(_slopes(paths, line, p)[0] for line in _ahead(config, p))])
    sound = angles[np.abs(angles) < math.radians(p.yaw_most_deg)]
    if len(sound) >= p.crossings_least and len(sound) > len(angles) / 2:
        if _spread_deg(sound) > p.straight_mad_deg:
            return None, "the tracks cross the count lines in too many directions"
        return _median(sound), "the normals of the count lines"
    if config.travel_heading_deg is None:
        reason = "tracks" if config.count_lines else "count lines and travel_heading_deg"
        return None, f"needs more {reason} to compare the direction of the tracks with"
    chords = _chords(paths, p)
    along = math.radians(config.travel_heading_deg - config.heading_deg)
    off = (chords - along + math.pi / 2) % math.pi - math.pi / 2  # a road has two directions
    if len(off) < p.chords_least:
        return None, f"{len(off)} long tracks are too few; want {p.chords_least}"
    if _spread_deg(off) > p.straight_mad_deg:
        return None, "the road is not straight enough to compare it with travel_heading_deg"
    return _median(off), "travel_heading_deg"


def _spread_deg(angles: F64) -> float:
    return math.degrees(float(np.median(np.abs(angles - np.median(angles)))))


def _ahead(config: SensorConfig, p: DiagnosisParameters) -> list[CountLine]:
    """Return the count lines that vehicles cross towards or away from the radar.

    Of a vehicle seen side-on the radar sees other parts as it goes by, which turns its track by 2 to 3 deg.
    """
    found = []
    for line in config.count_lines:
        along = math.atan2(line.p1[0] - line.p0[0], line.p1[1] - line.p0[1])
        sight = math.atan2(line.p0[0] + line.p1[0], line.p0[1] + line.p1[1])
        if abs(math.sin(along - sight)) > math.cos(math.radians(p.line_aspect_deg)):
            found.append(line)
    return found


def _median(angles: F64) -> Angle:
    middle = float(np.median(angles))
    spread = _MAD_TO_STD * float(np.median(np.abs(angles - middle)))
    return Angle(middle, _MEDIAN_LOSS * spread / math.sqrt(len(angles)), len(angles))


def _runs(track: I64) -> list[slice]:
    """Return where each track's samples stand."""
    edges = np.flatnonzero(np.diff(track, prepend=-1, append=-1))
    return [slice(int(a), int(b)) for a, b in pairwise(edges)]


def _chords(paths: Paths, p: DiagnosisParameters) -> F64:
    """Return the direction of each long track from its first to its last point, clockwise from forward."""
    ends = [(paths.x_m[r][[0, -1]], paths.y_m[r][[0, -1]]) for r in _runs(paths.track)]
    return np.array(
        [
            math.atan2(x[1] - x[0], y[1] - y[0])
            for x, y in ends
            if math.hypot(x[1] - x[0], y[1] - y[0]) > p.chord_m
        ]
    )


def _slopes(paths: Paths, line: CountLine, p: DiagnosisParameters) -> tuple[F64, F64]:
    """Return of each track that crosses the line its angle to the normal and its place along the line.

    Angles are clockwise in (-pi/2, pi/2); places are metres from the line's first point.
    """
    p0, p1 = np.array(line.p0), np.array(line.p1)
    length = float(np.hypot(*(p1 - p0)))
    if length == 0:
        return np.zeros(0), np.zeros(0)
    along = (p1 - p0) / length
    normal = np.array([-along[1], along[0]])  # so that (along, normal) turn like (x, y)
    s = (paths.x_m - p0[0]) * normal[0] + (paths.y_m - p0[1]) * normal[1]
    q = (paths.x_m - p0[0]) * along[0] + (paths.y_m - p0[1]) * along[1]
    near = np.abs(s) < p.line_reach_m
    found = []
    cover = p.line_cover * p.line_reach_m
    for run in _runs(paths.track):
        here = near[run]
        if here.sum() < p.line_samples_least:
            continue
        s_here, q_here = s[run][here], q[run][here]
        if s_here.min() > -cover or s_here.max() < cover:
            continue
        slope, place = np.polyfit(s_here, q_here, 1)
        if -length / 2 < place < 1.5 * length:  # what passes far beside the line is another road
            found.append((math.atan(slope), place))
    table = np.array(found).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def _mirror_finding(paths: Paths, config: SensorConfig, p: DiagnosisParameters) -> Finding | None:
    """Compare how traffic lies on the count lines as sent, and with left and right exchanged."""
    as_sent = _misfits(paths, _ahead(config, p), p)
    exchanged = _misfits(paths.mirrored(), _ahead(config, p), p)
    if not exchanged or len(exchanged) < len(as_sent):
        return None
    sent_m = float(np.mean(as_sent)) if as_sent else math.inf
    exchanged_m = float(np.mean(exchanged))
    if len(exchanged) == len(as_sent) and sent_m - exchanged_m < p.mirror_m:
        return None
    return Finding(
        "azimuth_sign",
        "fault",
        "Left and right seem exchanged: mirrored, the traffic lies on the middle of the count lines "
        f"to {exchanged_m:.1f} m; as sent, "
        + (f"it is {sent_m:.1f} m off." if as_sent else "it does not cross them."),
        {"misfit_mirrored_m": exchanged_m} | ({"misfit_as_sent_m": sent_m} if as_sent else {}),
        "Change azimuth_positive of the sensor (right or left), unless the count lines are drawn wrong.",
    )


def _misfits(paths: Paths, lines: Sequence[CountLine], p: DiagnosisParameters) -> list[float]:
    """Return, with the yaw taken out, how far the middle of the traffic is from the middle of each line.

    Lines that too few tracks cross are left out. What is left of a slope against the normal counts as the
    metres that it makes over the reach.
    """
    slopes = np.concatenate([np.zeros(0), *(_slopes(paths, line, p)[0] for line in lines)])
    turned = paths.turned(-float(np.median(slopes))) if len(slopes) else paths
    found = []
    for line in lines:
        angles, places = _slopes(turned, line, p)
        if len(places) < p.crossings_least:
            continue
        low, high = np.percentile(places, [5, 95])
        length = math.hypot(line.p1[0] - line.p0[0], line.p1[1] - line.p0[1])
        sideways = abs(math.tan(float(np.median(angles)))) * p.line_reach_m
        found.append(abs(float(low + high) / 2 - length / 2) + sideways)
    return found
