"""What the diagnosis of a stream counts as wrong; each bound with the values seen in sound recordings."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DiagnosisParameters:
    """Bounds of the findings. "Sound" are seven recorded scenes of 60 to 90 s, 70 to 165 points a frame."""

    frames_least: int = 100  # 5 s at 20 Hz; fewer tell nothing
    rate_low: float = 0.75  # of measured to registered rate; sound: 1.00
    rate_high: float = 1.33
    missing_share_most: float = 0.05  # of frame numbers; sound: up to 0.02
    gap_numbers_most: int = 10_000  # a larger step is a reboot or a wrapped counter
    silence_s: float = 2.0  # longer than the tracker coasts
    back_share_most: float = 0.01
    skew_s: float = 1.0  # of the sensor's clock; transport is part of it
    jitter_s: float = 0.5
    points_least: float = 5.0  # a frame; sound: 70 to 165, a third to two thirds of them standing clutter
    doppler_share_least: float = 0.9
    moving_mps: float = 2.0
    moving_points_least: int = 100
    pair_s: float = 0.25  # a car at 15 m/s moves 4 m: more than match_range_m, less than a gap
    pairs_most: int = 300
    near_from_m: float = 20.0
    near_to_m: float = 80.0  # where a car gives 4 to 8 points
    match_range_m: float = 0.75  # a resolution cell
    match_across_m: float = 1.5
    match_mps: float = 1.0
    sign_factor: float = 1.5  # sound: opposite to forward 0.08 to 0.59 (queues), so above 1.5 it is reversed
    vehicle_m: float = 4.0
    vehicle_mps: float = 1.5
    companions_least: float = 1.5  # further points of the same vehicle; sound: 4.5 to 7.2
    outside_share_most: float = 0.3  # of moving points; sound: 0.05 to 0.10
    # Mounting, from tracks:
    line_reach_m: float = 25.0  # of a track to either side of a count line
    line_samples_least: int = 8
    line_aspect_deg: float = 45.0  # between a line's normal and the sight to its middle
    line_cover: float = 0.6  # of the reach, on both sides
    crossings_least: int = 12  # sound: 46 to 65 a line and minute
    yaw_deg: float = 0.4  # sound: at most 0.15
    yaw_most_deg: float = 20.0  # further off, a track does not run along the road
    straight_mad_deg: float = 1.0  # median deviation of the tracks; straight roads: 0.2 to 0.8, a crossing: 2
    chord_m: float = 40.0
    chords_least: int = 20
    mirror_m: float = 1.0  # by how much the middle of the traffic must fit the line's middle better mirrored


DEFAULTS = DiagnosisParameters()
